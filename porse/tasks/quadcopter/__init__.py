"""Quadcopter: four tilting rotors on a small chassis reach and hover near a fixed position."""

from porse.tasks.quadcopter.task import Quadcopter

__all__ = ["Quadcopter"]
