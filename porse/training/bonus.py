"""The exploration bonus R_e: what is counted, for how long, and what a count pays."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from porse.exploration import Counts, ProgressSpace, SimHash, Visits
from porse.functions.run.execute import Function
from porse.training.scale import Scale

Seen = tuple[Tensor, Mapping[str, Tensor]]
"""What is counted of one step, (num_envs, ...), in memory of its own, and the progress variables by name, (num_envs,) each."""


@dataclass(frozen=True)
class Bonuses:
    """The bonus of one epoch.

    Attributes:
        amount: R_e, (steps, num_envs).
        series: what is written down about the epoch.
    """

    amount: Tensor
    series: dict[str, float]


class Bonus(Protocol):
    """Pays the policy for states that were seldom visited."""

    def see(self, variables: Mapping[str, Any]) -> Seen:
        """Returns what is counted of one step. Raises CodeError."""
        ...

    def pay(self, epoch: int, seen: Tensor, ends: Tensor) -> Bonuses:
        """Counts an epoch and returns its bonus.

        Args:
            epoch: which one, from 1.
            seen: (steps, num_envs, ...), what `see` returned.
            ends: (steps, num_envs) bool, whether the episode ended in this step.
        """
        ...

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""
        ...

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        ...


@dataclass(frozen=True)
class Price:
    """What a visit pays.

    Attributes:
        rarity: visits -> how rare each one's cell is, (steps, num_envs).
        size: brings the rarities to a size.
        factor: what the result is multiplied by.
    """

    rarity: Callable[[Visits], Tensor]
    size: Scale
    factor: float

    def of(self, visits: Visits, ends: Tensor) -> Tensor:
        """Returns the bonus of an epoch's visits, (steps, num_envs)."""
        return self.factor * self.size.apply(self.rarity(visits), ends)


class Ledger:
    """Counts the cells of epochs and prices them, for as long as counts live.

    Args:
        counts: the counts, none so far.
        price: what a visit pays.
        life_epochs: counts begin anew after so many epochs; 0: they live as long as the training.
    """

    def __init__(self, counts: Counts, price: Price, life_epochs: int) -> None:
        self._counts, self._price, self._life_epochs = counts, price, life_epochs

    def begins_anew(self, epoch: int) -> bool:
        """Returns whether counts that were there before `epoch` are forgotten with it; forgets them."""
        anew = self._life_epochs > 0 and (epoch - 1) % self._life_epochs == 0
        if anew:
            self._counts.forget()
            self._price.size.forget()
        return anew

    def pay(self, cells: Tensor, ends: Tensor) -> Bonuses:
        """Returns the bonus for (steps, num_envs) cells; -1 is not counted and earns nothing."""
        visits = self._counts.count(cells, ends)
        series = {"cells_visited": self._counts.share_visited, "new_cells": float(visits.new_cells)}
        return Bonuses(self._price.of(visits, ends), series)

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""
        size = {f"size.{name}": value for name, value in self._price.size.state().items()}
        return self._counts.state() | size

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        self._counts.load_state(state)
        self._price.size.load_state(part(state, "size"))


class MappingBonus:
    """Counts the cells of a generated mapping.

    Args:
        mapping: the candidate's mapping M.
        space: the cells of its outputs.
        ledger: counts and prices them.
    """

    def __init__(self, mapping: Function, space: ProgressSpace, ledger: Ledger) -> None:
        self._mapping, self.space, self.ledger = mapping, space, ledger

    def see(self, variables: Mapping[str, Any]) -> Seen:
        """Returns the progress variables, (variables, num_envs), and each by name."""
        progress = self._mapping(variables)
        return torch.stack(progress), dict(zip(self._mapping.names, progress, strict=True))

    def pay(self, epoch: int, seen: Tensor, ends: Tensor) -> Bonuses:
        """Returns the bonus; bins are fixed by the first epoch of the counts."""
        if self.ledger.begins_anew(epoch):
            self.space.forget()
        return self.ledger.pay(self.space.locate(seen.transpose(1, 2)), ends)

    def state(self) -> dict[str, Tensor]:
        """Returns the bins and the counts."""
        return self.space.state() | self.ledger.state()

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        self.space.load_state(state)
        self.ledger.load_state(state)


class SimHashBonus:
    """Counts the SimHashes of the whole observation, which knows nothing of the task's goal.

    Args:
        hashes: the hash.
        ledger: counts and prices its codes.
    """

    def __init__(self, hashes: SimHash, ledger: Ledger) -> None:
        self.hashes, self.ledger = hashes, ledger

    def see(self, variables: Mapping[str, Any]) -> Seen:
        """Returns the codes, (num_envs,); there are no progress variables."""
        return self.hashes.locate(variables["obs_buf"]), {}

    def pay(self, epoch: int, seen: Tensor, ends: Tensor) -> Bonuses:
        """Returns the bonus."""
        self.ledger.begins_anew(epoch)
        return self.ledger.pay(seen, ends)

    def state(self) -> dict[str, Tensor]:
        """Returns the counts; the hash follows from its seed."""
        return self.ledger.state()

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()`."""
        self.ledger.load_state(state)


class NoBonus:
    """Pays nothing and remembers nothing."""

    def see(self, variables: Mapping[str, Any]) -> Seen:
        """Returns nothing for every environment."""
        return torch.zeros((variables["num_envs"], 0)), {}

    def pay(self, epoch: int, seen: Tensor, ends: Tensor) -> Bonuses:
        """Returns zeros, and no series."""
        del epoch, seen
        return Bonuses(torch.zeros(ends.shape), {})

    def state(self) -> dict[str, Tensor]:
        """Returns nothing."""
        return {}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Does nothing."""
        del state


def part(state: Mapping[str, Tensor], name: str) -> dict[str, Tensor]:
    """Returns the entries of a state below `name.`, without that prefix."""
    prefix = f"{name}."
    return {key.removeprefix(prefix): value for key, value in state.items() if key.startswith(prefix)}
