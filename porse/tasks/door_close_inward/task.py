"""DoorCloseInward: push two open panels, which stand toward the hands, shut.

As in the original, the panels start at 1.57 rad/s into their stops, which give back little of it: left alone, they stay
open.
"""

from typing import ClassVar

from porse.tasks import objects, shadow
from porse.tasks.doors import INWARD, WIDE_HANDS, DoorTask, handles
from porse.tasks.free_hands import Handle


class DoorCloseInward(DoorTask):
    """Push two open panels, which stand toward the hands, shut."""

    NAME: ClassVar[str] = "DoorCloseInward"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands close a double door whose panels stand open toward them: both hands reach for the "
        "handles and push the panels shut; pushing is enough"
    )
    STARTS: ClassVar[str] = "both panels stand wide open, at 1.57 rad, toward the hands"
    ENDS: ClassVar[str] = "as soon as the distances of one hand's five fingertips from its handle sum to 1.5 m or more"
    FITNESS: ClassVar[str] = "the share of episodes in which the handles once were less than 0.5 m apart along y"
    RIGHT: ClassVar[shadow.BasePose] = WIDE_HANDS[0]
    LEFT: ClassVar[shadow.BasePose] = WIDE_HANDS[1]
    EULER: ClassVar[objects.Vector] = INWARD
    HANDLES: ClassVar[tuple[Handle, ...]] = handles(0.04)
    OPENS: ClassVar[bool] = False
    START_JOINTS: ClassVar[dict[str, tuple[float, float]]] = {
        "link_1_hinge": (1.57, 1.57),
        "link_2_hinge": (1.57, 1.57),
    }
    PER_ENV_STATISTIC: ClassVar[bool] = True
