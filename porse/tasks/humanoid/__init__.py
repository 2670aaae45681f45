"""Humanoid: a capsule figure runs as fast as it can along +x."""

from porse.tasks.humanoid.task import Humanoid

__all__ = ["Humanoid"]
