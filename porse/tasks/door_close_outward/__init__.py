"""DoorCloseOutward: catch the handles of two panels that stand open away from the hands, and pull them shut."""

from porse.tasks.door_close_outward.task import DoorCloseOutward

__all__ = ["DoorCloseOutward"]
