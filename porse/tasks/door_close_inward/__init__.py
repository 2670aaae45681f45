"""DoorCloseInward: push two open panels, which stand toward the hands, shut."""

from porse.tasks.door_close_inward.task import DoorCloseInward

__all__ = ["DoorCloseInward"]
