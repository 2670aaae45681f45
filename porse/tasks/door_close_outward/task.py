"""DoorCloseOutward: catch the handles of two panels that stand open away from the hands, and pull them shut.

As in the original, the panels start at 1.57 rad/s into their stops, which give back little of it: left alone, they stay
open.
"""

from typing import ClassVar

from porse.tasks import objects, shadow
from porse.tasks.doors import NEAR_HANDS, OUTWARD, DoorTask, handles
from porse.tasks.free_hands import Handle


class DoorCloseOutward(DoorTask):
    """Catch the handles of two panels that stand open away from the hands, and pull them shut."""

    NAME: ClassVar[str] = "DoorCloseOutward"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands close a double door whose panels stand open away from them: both hands must catch "
        "the handles and pull the panels shut"
    )
    STARTS: ClassVar[str] = "both panels stand wide open, at 1.57 rad, away from the hands"
    ENDS: ClassVar[str] = "as soon as the distances of one hand's five fingertips from its handle sum to 3 m or more"
    FITNESS: ClassVar[str] = "the share of episodes in which the handles once were less than 0.5 m apart along y"
    RIGHT: ClassVar[shadow.BasePose] = NEAR_HANDS[0]
    LEFT: ClassVar[shadow.BasePose] = NEAR_HANDS[1]
    EULER: ClassVar[objects.Vector] = OUTWARD
    HANDLES: ClassVar[tuple[Handle, ...]] = handles(-0.04)
    OPENS: ClassVar[bool] = False
    START_JOINTS: ClassVar[dict[str, tuple[float, float]]] = {
        "link_1_hinge": (1.57, 1.57),
        "link_2_hinge": (1.57, 1.57),
    }
    CONSTANT: ClassVar[float] = 6.0
    LOST: ClassVar[float] = 3.0
