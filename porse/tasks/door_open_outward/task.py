"""DoorOpenOutward: push the panels of a closed door open, away from the hands."""

from porse.tasks.hands.doors import OUTWARD, OUTWARD_HANDLES, OpeningTask


class DoorOpenOutward(OpeningTask):
    """Push the panels of a closed door open, away from the hands."""

    NAME = "DoorOpenOutward"
    DESCRIPTION = (
        "two shadow hands open a closed double door that opens away from them only: pushing the panels is enough"
    )
    EULER = OUTWARD
    HANDLES = OUTWARD_HANDLES
    GOAL_LIFT = 5.0
