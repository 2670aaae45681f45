"""What a policy is paid for: the total reward of eq. 6, and the series that are written down about it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from porse.code.compile import MappingFunction, RewardFunction
from porse.code.verdict import CodeError
from porse.exploration import VisitCounts


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


class Reward(Protocol):
    """Pays the policy for the state after a step."""

    def pay(self, variables: Mapping[str, Any]) -> Payment:
        """Returns the payment for one step of all environments; raises CandidateFailed."""
        ...

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""
        ...

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        ...


class CandidateReward:
    """R_total = beta R_e + (scale - beta) R_g (eq. 6), with R_e from the mapping's visit counts.

    Args:
        goal: the candidate's goal reward R_g.
        mapping: the candidate's mapping M.
        visits: the counts over the outputs of `mapping`.
        beta: weight of the bonus.
        scale: sum of the two weights.
    """

    def __init__(
        self, goal: RewardFunction, mapping: MappingFunction, visits: VisitCounts, beta: float, scale: float
    ) -> None:
        self._goal, self._mapping, self._visits = goal, mapping, visits
        self._beta, self._scale = beta, scale

    def pay(self, variables: Mapping[str, Any]) -> Payment:
        """Returns the payment for one step of all environments.

        Raises:
            CandidateFailed: a function raised, or the goal reward is not finite.
        """
        try:
            goal, components = self._goal(variables)
            progress, _, names = self._mapping(variables)
        except CodeError as error:
            raise CandidateFailed(f"its function raised in training: {error}") from error
        if not bool(torch.isfinite(goal).all()):
            raise CandidateFailed(_not_finite(goal, components))
        bonus = self._visits.bonus(torch.stack(list(progress), dim=1))
        series = {"goal": goal, "bonus": bonus}
        series |= {f"component/{name}": value for name, value in sorted(components.items())}
        series |= {f"progress/{name}": value for name, value in zip(names, progress, strict=True)}
        return Payment(self._beta * bonus + (self._scale - self._beta) * goal, series)

    def state(self) -> dict[str, Tensor]:
        """Returns the counts and their ranges."""
        return self._visits.state()

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        self._visits.load_state(state)


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
        """Returns the means so far and starts a new epoch."""
        if self._sums is None:
            return {}
        means = dict(zip(self._names, (self._sums / self._steps).tolist(), strict=True))
        self._sums, self._steps = None, 0
        return means


def _not_finite(goal: Tensor, components: Mapping[str, Tensor]) -> str:
    share = 1.0 - torch.isfinite(goal).float().mean().item()
    guilty = [name for name, value in sorted(components.items()) if not bool(torch.isfinite(value).all())]
    return f"its reward was not finite in {share:.1%} of the environments (components: {', '.join(guilty) or 'none'})"
