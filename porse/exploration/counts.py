"""Visit counts over cells: exact, one step of all environments after the other, at a cost that never grows."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Visits:
    """What one epoch's states were worth when they were visited.

    Attributes:
        own: (steps, num_envs) int64, visits of the state's cell, those of its own step included; 0: not counted.
        mean: (steps, num_envs) float64, mean visits of the cells visited until then, its own step included; 0 where
            none was.
        new_cells: cells that were never visited before this epoch.
    """

    own: Tensor
    mean: Tensor
    new_cells: int


class Counts:
    """Counts visits of cells: for all environments together, or for each one's running episode.

    Args:
        cells: how many there are.
        num_envs: number of environments.
        each_episode: whether every environment counts for itself, and anew in every episode.

    Attributes:
        table: visits by cell, (cells,) int64; (num_envs, cells) where each episode counts.
    """

    def __init__(self, cells: int, num_envs: int, each_episode: bool) -> None:
        self._cells, self._each_episode = cells, each_episode
        self._counters = torch.arange(num_envs) if each_episode else torch.zeros(num_envs, dtype=torch.int64)
        self.table = torch.zeros((num_envs, cells) if each_episode else (cells,), dtype=torch.int64)
        self.forget()

    def forget(self) -> None:
        """Makes every cell one that was never visited."""
        self.table.zero_()
        self._visited = torch.zeros(self._cells, dtype=torch.bool)
        self._sum_up()

    @property
    def share_visited(self) -> float:
        """The share of the cells that were ever visited, 0 to 1."""
        return int(self._visited.sum()) / self._cells

    def count(self, cells: Tensor, ends: Tensor) -> Visits:
        """Counts one epoch, step by step.

        Args:
            cells: (steps, num_envs) int64, the cells of the states after each step; -1: not to be counted.
            ends: (steps, num_envs) bool, whether the episode ended in this state.
        """
        flat = self.table.view(-1)
        counted = cells >= 0
        places = self._counters * self._cells + cells.clamp_min(0)
        own, before = torch.zeros_like(cells), torch.zeros_like(cells)
        for place, weight, first, last, end in zip(places, counted.long(), before, own, ends, strict=True):
            # A third of what an index takes.
            torch.index_select(flat, 0, place, out=first)
            flat.index_add_(0, place, weight)
            torch.index_select(flat, 0, place, out=last)
            if self._each_episode:
                self.table[end] = 0
        # Of n environments that meet in a new cell, which then has n visits, each brings an n-th of it.
        brought = torch.where(counted & (before == 0), own.double().reciprocal(), 0.0)
        total, distinct = self._add_up(self._total, counted.double(), ends), self._add_up(self._distinct, brought, ends)
        self._sum_up()
        known = int(self._visited.sum())
        self._visited[cells[counted]] = True
        mean = (total / distinct.clamp_min(1.0)).expand(cells.shape)
        return Visits(torch.where(counted, own, 0), mean, int(self._visited.sum()) - known)

    def _add_up(self, so_far: Tensor, gains: Tensor, ends: Tensor) -> Tensor:
        """Returns whole numbers added up step by step, each counter's by itself, (steps, counters); an end sets them to 0."""
        if not self._each_episode:
            # As integers: a GPU adds floats up in no fixed order.
            return so_far + gains.sum(dim=1, keepdim=True).round().long().cumsum(dim=0)
        sums = []
        for gain, end in zip(gains, ends, strict=True):
            sums.append(so_far + gain)
            so_far = torch.where(end, 0.0, sums[-1])
        return torch.stack(sums)

    def _sum_up(self) -> None:
        """Adds up visits and visited cells of each counter, (counters,) float64, from the table."""
        table = self.table.view(-1, self._cells)
        self._total = table.sum(dim=1).double()
        self._distinct = (table > 0).sum(dim=1).double()

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""
        return {"counts": self.table.clone(), "visited": self._visited.clone()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()` of another object made with the same arguments.

        Raises:
            ValueError: it is of other cells or environments.
        """
        if state["counts"].shape != self.table.shape or state["visited"].shape != self._visited.shape:
            raise ValueError(f"its counts are {tuple(state['counts'].shape)} numbers, not {tuple(self.table.shape)}")
        self.table, self._visited = state["counts"].clone(), state["visited"].clone()
        self._sum_up()
