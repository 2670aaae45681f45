"""DoorOpenOutward: push the panels of a closed door open, away from the hands."""

from porse.tasks.door_open_outward.task import DoorOpenOutward

__all__ = ["DoorOpenOutward"]
