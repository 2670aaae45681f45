"""Scissors: two hands open a pair of scissors that lies on a table."""

from porse.tasks.scissors.task import Scissors

__all__ = ["Scissors"]
