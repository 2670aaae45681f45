"""Switch: each hand presses a rocker switch. It cannot be solved, as shipped."""

from porse.tasks.switch.task import Switch

__all__ = ["Switch"]
