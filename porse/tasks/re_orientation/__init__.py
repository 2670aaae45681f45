"""ReOrientation: each of two fixed hands turns its cube to a goal orientation, again and again."""

from porse.tasks.re_orientation.task import ReOrientation

__all__ = ["ReOrientation"]
