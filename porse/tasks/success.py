"""The base of tasks that are solved or not: success latches in an episode, and the statistic is kept over episodes."""

from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor

from porse.tasks.base import Task


class SuccessTask(Task):
    """A task whose fitness is the share of episodes that were solved.

    After each step an environment counts as its episode's outcome where the episode just ended, and otherwise as
    before: as the last mean over all environments, or, with `PER_ENV_STATISTIC`, as its own last outcome. The
    statistic is the mean of that. An episode with a head start is cut short, and has no outcome: that it was not
    solved says nothing.

    Attributes:
        PER_ENV_STATISTIC: which of the two.
        successes: outcome of the running episodes, 0 or 1, `(num_envs,)`.
        outcomes: what each environment counts as now, `(num_envs,)`.
    """

    OVER_EPISODES: ClassVar[bool] = True
    PER_ENV_STATISTIC: ClassVar[bool] = False

    successes: Tensor
    outcomes: Tensor

    @abstractmethod
    def succeeded(self) -> Tensor:
        """Returns where the task is solved now, bool `(num_envs,)`."""

    def _prepare(self) -> None:
        self.successes = torch.zeros(self.num_envs)
        self.outcomes = torch.zeros(self.num_envs)

    def _start(self, ids: Tensor) -> None:
        self.successes[ids] = 0.0

    def _count(self) -> None:
        """Lets a success of this step latch."""
        self.successes = torch.where(self.succeeded(), 1.0, self.successes)

    def _record(self) -> None:
        self._count()
        finished = self._finished()
        self.outcomes = torch.where(finished, self.successes, self.outcomes)
        if not self.PER_ENV_STATISTIC:
            self.outcomes = self.outcomes.mean().repeat(self.num_envs)

    def _finished(self) -> Tensor:
        """Returns which environments have an outcome in this step, bool `(num_envs,)`: a whole episode has ended."""
        return (self.terminated() | self.timed_out()) & (self.head_start == 0)

    def episode_outcome(self, mean_sparse_reward: Tensor) -> Tensor:
        """Returns what the running episodes have come to, `(num_envs,)`."""
        del mean_sparse_reward
        return self.successes.clone()

    def fitness(self) -> float:
        """Returns the mean outcome of the episodes."""
        return float(SuccessTask.mean_fitness(self))

    def mean_fitness(self) -> Tensor:
        """Returns the same as a tensor."""
        return self.outcomes.mean()

    def sparse_reward(self) -> Tensor:
        """Returns 1 where the task is solved now, else 0."""
        return self.succeeded().float()
