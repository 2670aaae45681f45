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
    RIGHT: ClassVar[shadow.BasePose] = NEAR_HANDS[0]
    LEFT: ClassVar[shadow.BasePose] = NEAR_HANDS[1]
    EULER: ClassVar[objects.Vector] = OUTWARD
    HANDLES: ClassVar[tuple[Handle, ...]] = handles(-0.04)
    OPENS: ClassVar[bool] = True
    GOAL_LIFT: ClassVar[float] = 5.0
