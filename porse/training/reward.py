"""What a policy is paid for: the total reward of eq. 6, and the series that are written down about it.

During a rollout functions are only evaluated. At its end the whole epoch is counted, scaled, mixed and paid at once, so
that one scale holds in it.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from porse.functions.verdict import CodeError
from porse.tasks.base import Task
from porse.training.bonus import Bonus, part
from porse.training.goal import Goal
from porse.training.scale import Scale


class CandidateFailed(Exception):
    """A candidate's own function broke its training. Not a program's error: it becomes a row with this reason."""


@dataclass(frozen=True)
class Payment:
    """One epoch's reward.

    Attributes:
        total: (steps, num_envs) float32, what PPO is given.
        series: name -> what is written down about the epoch, in a fixed order.
    """

    total: Tensor
    series: dict[str, float]


class Reward:
    """R_total = beta R_e + (scale - beta) R_g / size of R_g, and for PPO divided by its own size (eq. 6).

    Args:
        goal: the goal reward R_g.
        bonus: the exploration bonus R_e.
        beta: weight of the bonus.
        scale: sum of the two weights.
        goal_size: brings R_g to the size that the bonus is relative to.
        total_size: brings R_total to the size that PPO is given.
    """

    def __init__(
        self, goal: Goal, bonus: Bonus, beta: float, scale: float, goal_size: Scale, total_size: Scale
    ) -> None:
        self._goal, self._bonus = goal, bonus
        self._beta, self._scale = beta, scale
        self._goal_size, self._total_size = goal_size, total_size
        self._begin()

    def _begin(self) -> None:
        self._names: tuple[str, ...] = ()
        self._components: list[str] = []
        self._values: list[Tensor] = []
        self._seen: list[Tensor] = []

    def see(self, task: Task) -> None:
        """Evaluates the functions for the state that `task` is in.

        Raises:
            CandidateFailed: a function raised.
        """
        variables = task.present()
        try:
            goal, components = self._goal(task, variables)
            seen, progress = self._bonus.see(variables)
        except CodeError as error:
            raise CandidateFailed(f"its function raised in training: {error}") from error
        if not self._names:
            self._components = sorted(components)
            shown = [*(f"component/{name}" for name in self._components), *(f"progress/{name}" for name in progress)]
            self._names = ("goal", *shown)
        values = [goal, *(components[name] for name in self._components), *progress.values()]
        # A copy: what a function returns may be the simulation's own memory.
        self._values.append(torch.stack(values).float())
        self._seen.append(seen)

    def pay(self, epoch: int, ends: Tensor) -> Payment:
        """Returns the payment for the states that were seen since the last one, a whole epoch.

        Args:
            epoch: which one, from 1.
            ends: (steps, num_envs) bool, whether the episode ended in this step.

        Raises:
            CandidateFailed: a value of the functions or the total reward is not finite.
        """
        names, values, seen = self._names, torch.stack(self._values), torch.stack(self._seen)
        self._begin()
        _check_values(names, values)
        goal = values[:, 0]
        bonuses = self._bonus.pay(epoch, seen, ends)
        goal_part = (self._scale - self._beta) * self._goal_size.apply(goal, ends)
        bonus_part = self._beta * bonuses.amount.double()
        mixed = goal_part + bonus_part
        # As PPO takes it: in single precision, a number that is finite in double need not be.
        total = self._total_size.apply(mixed, ends).float()
        if not bool(total.isfinite().all()):
            raise CandidateFailed(
                f"its total reward was not finite in {_share_not_finite(total)} of the epoch's states"
            )
        means = dict(zip(names, values.mean(dim=(0, 2)).tolist(), strict=True))
        series = {"goal": means.pop("goal"), "bonus": float(bonuses.amount.mean())}
        series |= {"goal_size": deviation(goal_part), "bonus_size": deviation(bonus_part)}
        series["bonus_share"] = series["bonus_size"] / (deviation(mixed) or 1.0)
        return Payment(total, {**series, **bonuses.series, **means, "reward": float(mixed.mean())})

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs: the bonus's counts, and the running sizes."""
        parts = {"bonus": self._bonus.state(), "goal": self._goal_size.state(), "total": self._total_size.state()}
        return {f"{name}.{key}": value for name, state in parts.items() for key, value in state.items()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`.

        Raises:
            ValueError: it is of another kind of training.
        """
        self._bonus.load_state(part(state, "bonus"))
        self._goal_size.load_state(part(state, "goal"))
        self._total_size.load_state(part(state, "total"))


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
        _check_names([name for name, value in means.items() if not math.isfinite(value)])
        return means


def deviation(values: Tensor) -> float:
    """Returns the standard deviation of all values, in double precision."""
    apart = values.double() - values.double().mean()
    return math.sqrt(float((apart * apart).mean()))


def _check_values(names: Sequence[str], values: Tensor) -> None:
    """Raises CandidateFailed where values (steps, names, num_envs), the goal's first, are not finite."""
    # One that is not finite leaves no finite sum; the other way round it need not be.
    if math.isfinite(float(values.sum())):
        return
    finite = values.isfinite()
    guilty = [name for name, fine in zip(names, finite.all(dim=2).all(dim=0).tolist(), strict=True) if not fine]
    if "goal" in guilty:
        parts = [name.removeprefix("component/") for name in guilty if name.startswith("component/")]
        share = _share_not_finite(values[:, 0])
        raise CandidateFailed(
            f"its reward was not finite in {share} of the epoch's states (components: {', '.join(parts) or 'none'})"
        )
    _check_names(guilty)


def _check_names(guilty: Sequence[str]) -> None:
    if guilty:
        raise CandidateFailed(f"its series {', '.join(guilty)} held NaN or infinity in an epoch; guard what makes it")


def _share_not_finite(values: Tensor) -> str:
    return f"{1.0 - values.isfinite().float().mean().item():.1%}"
