"""DoorOpenInward: grasp the handles of a closed door and pull its panels open toward the hands."""

from porse.tasks.door_open_inward.task import DoorOpenInward

__all__ = ["DoorOpenInward"]
