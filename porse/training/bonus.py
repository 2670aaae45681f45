"""The exploration bonus R_e: what is counted, and the counts that pay."""

from collections.abc import Mapping
from typing import Any, Protocol

import torch
from torch import Tensor

from porse.code.compile import MappingFunction
from porse.exploration import SimHashCounts, SumCounts, VisitCounts


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


class MappingBonus:
    """Counts the cells of a generated mapping.

    Args:
        mapping: the candidate's mapping M.
        visits: the counts over the outputs of `mapping`.
    """

    def __init__(self, mapping: MappingFunction, visits: VisitCounts | SumCounts) -> None:
        self._mapping, self._visits = mapping, visits
        self.state, self.load_state = visits.state, visits.load_state

    def pay(self, variables: Mapping[str, Any]) -> tuple[Tensor, Mapping[str, Tensor]]:
        """Returns the bonus for one step, and the progress variables."""
        progress, _, names = self._mapping(variables)
        return self._visits.bonus(torch.stack(list(progress), dim=1)), dict(zip(names, progress, strict=True))


class SimHashBonus:
    """Counts the SimHashes of the whole observation, which knows nothing of the task's goal."""

    def __init__(self, counts: SimHashCounts) -> None:
        self._counts = counts
        self.state, self.load_state = counts.state, counts.load_state

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
