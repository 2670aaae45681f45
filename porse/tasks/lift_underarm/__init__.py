"""LiftUnderarm: two hands lift a pot by its handles."""

from porse.tasks.lift_underarm.task import LiftUnderarm

__all__ = ["LiftUnderarm"]
