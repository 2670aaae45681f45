"""What a policy is paid for: the total reward of eq. 6, and the series that are written down about it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from porse.functions.verdict import CodeError
from porse.tasks.base import Task
from porse.training.bonus import Bonus
from porse.training.goal import Goal


class CandidateFailed(Exception):
    """A candidate's own function broke its training. Not a program's error: it becomes a row with this reason."""


@dataclass(frozen=True)
class Payment:
    """One step's reward.

    Attributes:
        total: (num_envs,), what PPO is given.
        series: name -> (num_envs,), what is written down, in a fixed order.
    """

    total: Tensor
    series: dict[str, Tensor]


class Reward:
    """R_total = beta R_e + (scale - beta) R_g (eq. 6).

    Args:
        goal: the goal reward R_g.
        bonus: the exploration bonus R_e.
        beta: weight of the bonus.
        scale: sum of the two weights.
    """

    def __init__(self, goal: Goal, bonus: Bonus, beta: float, scale: float) -> None:
        self._goal, self._bonus = goal, bonus
        self._beta, self._scale = beta, scale

    def pay(self, task: Task) -> Payment:
        """Returns the payment of all environments for the state that `task` is in.

        Raises:
            CandidateFailed: a function raised, or the total reward is not finite.
        """
        variables: Mapping[str, Any] = task.variables()
        try:
            goal, components = self._goal(task, variables)
            bonus, progress = self._bonus.pay(variables)
        except CodeError as error:
            raise CandidateFailed(f"its function raised in training: {error}") from error
        # As PPO takes it: in single precision, a number that is finite in double need not be.
        total = (self._beta * bonus + (self._scale - self._beta) * goal).float()
        if not bool(torch.isfinite(total).all()):
            raise CandidateFailed(_not_finite(total, goal, components))
        series = {"goal": goal, "bonus": bonus}
        series |= {f"component/{name}": value for name, value in sorted(components.items())}
        series |= {f"progress/{name}": value for name, value in progress.items()}
        return Payment(total, series)

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs: the bonus's counts."""
        return self._bonus.state()

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        self._bonus.load_state(state)


class EpochMeans:
    """Means of the series over the environments and steps of one epoch."""

    def __init__(self) -> None:
        self._names: Sequence[str] = ()
        self._sums: Tensor | None = None
        self._steps = 0

    def add(self, series: Mapping[str, Tensor]) -> None:
        """Adds one step: name -> (num_envs,); the names must not change within an epoch."""
        means = torch.stack([value.float() for value in series.values()]).mean(dim=1)
        self._names = tuple(series)
        self._sums = means if self._sums is None else self._sums + means
        self._steps += 1

    def take(self) -> dict[str, float]:
        """Returns the means so far and starts a new epoch.

        Raises:
            CandidateFailed: one is not finite, and so were values of the function that it is a series of.
        """
        if self._sums is None:
            return {}
        means = dict(zip(self._names, (self._sums / self._steps).tolist(), strict=True))
        self._sums, self._steps = None, 0
        wrong = [name for name, value in means.items() if not math.isfinite(value)]
        if wrong:
            raise CandidateFailed(
                f"its series {', '.join(wrong)} held NaN or infinity in an epoch; guard what makes it"
            )
        return means


def _not_finite(total: Tensor, goal: Tensor, components: Mapping[str, Tensor]) -> str:
    what = "reward" if not bool(torch.isfinite(goal).all()) else "total reward"
    share = 1.0 - torch.isfinite(total).float().mean().item()
    guilty = [name for name, value in sorted(components.items()) if not bool(torch.isfinite(value).all())]
    return f"its {what} was not finite in {share:.1%} of the environments (components: {', '.join(guilty) or 'none'})"
