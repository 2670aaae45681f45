"""BottleCap: one hand cradles a bottle, and the other pulls its cap off."""

from porse.tasks.bottle_cap.task import BottleCap

__all__ = ["BottleCap"]
