"""The exploration bonus R_e: what is counted, and the counts that pay."""

from collections.abc import Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

from porse.exploration import ProgressCounts, SimHashCounts
from porse.functions.run.execute import MappingFunction


class Bonus(Protocol):
    """Pays the policy for states that were seldom visited."""

    def pay(self, variables: Mapping[str, Any]) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Returns the bonus (num_envs,) for one step, and the progress variables by name. Raises CodeError."""
        ...

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""
        ...

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        ...


class _CountBonus:
    """What bonuses that count have in common: what they remember is their counts."""

    def __init__(self, counts: ProgressCounts | SimHashCounts) -> None:
        self._counts = counts

    def state(self) -> dict[str, Tensor]:
        """Returns the counts."""
        return self._counts.state()

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        self._counts.load_state(state)


class MappingBonus(_CountBonus):
    """Counts the cells of a generated mapping.

    Args:
        mapping: the candidate's mapping M.
        visits: the counts over the outputs of `mapping`.
    """

    def __init__(self, mapping: MappingFunction, visits: ProgressCounts) -> None:
        super().__init__(visits)
        self._mapping = mapping

    def pay(self, variables: Mapping[str, Any]) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Returns the bonus for one step, and the progress variables."""
        progress, _, names = self._mapping(variables)
        return self._counts.bonus(torch.stack(list(progress), dim=1)), dict(zip(names, progress, strict=True))


class SimHashBonus(_CountBonus):
    """Counts the SimHashes of the whole observation, which knows nothing of the task's goal."""

    def pay(self, variables: Mapping[str, Any]) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Returns the bonus for one step; there are no progress variables."""
        return self._counts.bonus(variables["obs_buf"]), {}


class NoBonus:
    """Pays nothing and remembers nothing."""

    def pay(self, variables: Mapping[str, Any]) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Returns zeros."""
        return torch.zeros(variables["num_envs"]), {}

    def state(self) -> dict[str, Tensor]:
        """Returns nothing."""
        return {}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Does nothing."""
        del state
