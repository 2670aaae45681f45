"""DoorOpenInward: grasp the handles of a closed door and pull its panels open toward the hands."""

from porse.tasks.hands.doors import INWARD, INWARD_HANDLES, OpeningTask


class DoorOpenInward(OpeningTask):
    """Grasp the handles of a closed door and pull its panels open toward the hands."""

    NAME = "DoorOpenInward"
    DESCRIPTION = (
        "two shadow hands open a closed double door that opens toward them only: both hands must grasp the "
        "handles and pull the panels open"
    )
    EULER = INWARD
    HANDLES = INWARD_HANDLES
