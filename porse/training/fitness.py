"""The fitness of an epoch, from that of its steps."""

import math

import torch
from torch import Tensor

from porse.tasks.base import Task


class EpochFitness:
    """Takes a task's fitness after every step of an epoch: their mean, or the last where it is over episodes.

    A statistic over episodes looks back by itself; what it is at the epoch's end has every episode of the epoch in it.
    """

    def __init__(self) -> None:
        self._values: list[Tensor] = []

    def add(self, task: Task) -> None:
        """Adds the step that `task` has just done, before episodes that ended in it are reset."""
        if task.OVER_EPISODES:
            self._values.clear()
        self._values.append(task.mean_fitness())

    def take(self) -> float:
        """Returns the fitness of the steps so far, at least one, and starts a new epoch."""
        values, self._values = torch.stack(self._values).tolist(), []
        # math.fsum refuses infinities of both signs. A fitness that is not finite fails the candidate, with its reason.
        return math.fsum(values) / len(values) if all(map(math.isfinite, values)) else math.nan
