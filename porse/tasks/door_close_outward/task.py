"""DoorCloseOutward: catch the handles of two panels that stand open away from the hands, and pull them shut.

As in the original, the panels start at 1.57 rad/s into their stops, which give back little of it: left alone, they stay
open.
"""

from porse.tasks.hands.doors import NEAR_HANDS, OUTWARD, OUTWARD_HANDLES, ClosingTask
from porse.tasks.hands.handles import hand_lost


class DoorCloseOutward(ClosingTask):
    """Catch the handles of two panels that stand open away from the hands, and pull them shut."""

    NAME = "DoorCloseOutward"
    DESCRIPTION = (
        "two shadow hands close a double door whose panels stand open away from them: both hands must catch "
        "the handles and pull the panels shut"
    )
    STARTS = "both panels stand wide open, at 1.57 rad, away from the hands"
    LOST = 3.0
    ENDS = hand_lost(LOST)
    RIGHT, LEFT = NEAR_HANDS
    EULER = OUTWARD
    HANDLES = OUTWARD_HANDLES
    CONSTANT = 6.0
