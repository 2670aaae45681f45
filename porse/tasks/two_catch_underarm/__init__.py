"""TwoCatchUnderarm: each hand holds an egg, and both are thrown to the other hand at once."""

from porse.tasks.two_catch_underarm.task import TwoCatchUnderarm

__all__ = ["TwoCatchUnderarm"]
