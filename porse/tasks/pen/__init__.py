"""Pen: two hands pull the cap off a pen."""

from porse.tasks.pen.task import Pen

__all__ = ["Pen"]
