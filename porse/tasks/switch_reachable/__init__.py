"""SwitchReachable: Switch with a success that can be reached. Not one of the paper's tasks."""

from porse.tasks.switch_reachable.task import SwitchReachable

__all__ = ["SwitchReachable"]
