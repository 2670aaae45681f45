"""DoorOpenOutward: push the panels of a closed door open, away from the hands."""

from typing import ClassVar

from porse.tasks import objects, shadow
from porse.tasks.doors import NEAR_HANDS, OUTWARD, DoorTask, handles
from porse.tasks.free_hands import Handle


class DoorOpenOutward(DoorTask):
    """Push the panels of a closed door open, away from the hands."""

    NAME: ClassVar[str] = "DoorOpenOutward"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands open a closed double door that opens away from them only: pushing the panels is enough"
    )
    STARTS: ClassVar[str] = "both panels are shut, with the handles 0.067 m apart along y"
    ENDS: ClassVar[str] = "as soon as the distances of one hand's five fingertips from its handle sum to 1.5 m or more"
    FITNESS: ClassVar[str] = "the share of episodes in which the handles once were more than 0.5 m apart along y"
    RIGHT: ClassVar[shadow.BasePose] = NEAR_HANDS[0]
    LEFT: ClassVar[shadow.BasePose] = NEAR_HANDS[1]
    EULER: ClassVar[objects.Vector] = OUTWARD
    HANDLES: ClassVar[tuple[Handle, ...]] = handles(-0.04)
    OPENS: ClassVar[bool] = True
    GOAL_LIFT: ClassVar[float] = 5.0
