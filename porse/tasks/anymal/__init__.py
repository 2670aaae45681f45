"""Anymal: a quadruped follows commanded forward, sideways and turning velocities."""

from porse.tasks.anymal.task import Anymal

__all__ = ["Anymal"]
