"""DoorOpenInward: grasp the handles of a closed door and pull its panels open toward the hands."""

from typing import ClassVar

from porse.tasks import objects, shadow
from porse.tasks.doors import INWARD, NEAR_HANDS, DoorTask, handles
from porse.tasks.free_hands import Handle


class DoorOpenInward(DoorTask):
    """Grasp the handles of a closed door and pull its panels open toward the hands."""

    NAME: ClassVar[str] = "DoorOpenInward"
    DESCRIPTION: ClassVar[str] = (
        "two shadow hands open a closed double door that opens toward them only: both hands must grasp the "
        "handles and pull the panels open"
    )
    RIGHT: ClassVar[shadow.BasePose] = NEAR_HANDS[0]
    LEFT: ClassVar[shadow.BasePose] = NEAR_HANDS[1]
    EULER: ClassVar[objects.Vector] = INWARD
    HANDLES: ClassVar[tuple[Handle, ...]] = handles(0.04)
    OPENS: ClassVar[bool] = True
