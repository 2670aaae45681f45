"""CatchUnderarm: as Over, but the hands move as wholes and stand farther apart."""

from porse.tasks.catch_underarm.task import CatchUnderarm

__all__ = ["CatchUnderarm"]
