"""CatchOver2Underarm: an upright hand throws an egg overarm to a hand that lies palm up."""

from porse.tasks.catch_over2underarm.task import CatchOver2Underarm

__all__ = ["CatchOver2Underarm"]
