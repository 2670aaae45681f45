"""Kettle (PourWater): one hand tilts a kettle over a bucket that the other hand holds."""

from porse.tasks.kettle.task import Kettle

__all__ = ["Kettle"]
