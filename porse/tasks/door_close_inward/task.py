"""DoorCloseInward: push two open panels, which stand toward the hands, shut.

As in the original, the panels start at 1.57 rad/s into their stops, which give back little of it: left alone, they stay
open.
"""

from porse.tasks.hands.doors import INWARD, INWARD_HANDLES, WIDE_HANDS, ClosingTask


class DoorCloseInward(ClosingTask):
    """Push two open panels, which stand toward the hands, shut."""

    NAME = "DoorCloseInward"
    DESCRIPTION = (
        "two shadow hands close a double door whose panels stand open toward them: both hands reach for the "
        "handles and push the panels shut; pushing is enough"
    )
    STARTS = "both panels stand wide open, at 1.57 rad, toward the hands"
    RIGHT, LEFT = WIDE_HANDS
    EULER = INWARD
    HANDLES = INWARD_HANDLES
    PER_ENV_STATISTIC = True
