"""The bins of several progress variables, and joint cells: one integer for one bin of each variable."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from porse.exploration.ranges import Range, first_range, grow

_CODES = 2**63
"""How many joint cells an int64 can tell apart."""


@dataclass(frozen=True)
class Growth:
    """One variable's range has doubled, perhaps several times.

    Attributes:
        variable: which one.
        image: (bins,) int64, the new bin of each old bin.
    """

    variable: int
    image: Tensor


class ProgressBins:
    """The ranges of a candidate's progress variables, which begin with the first step and grow to hold every later one.

    Args:
        rises: for each progress variable, whether it rises as the task is done; a falling one is turned round.
        bins: bins of each variable.

    Raises:
        ValueError: the joint cells are too many for an int64.
    """

    def __init__(self, rises: Sequence[bool], bins: int) -> None:
        if bins ** len(rises) > _CODES:
            raise ValueError(
                f"expected at most 2^63 joint cells, found {bins} bins for each of {len(rises)} progress variables;"
                " lower the number of cells"
            )
        self.bins = bins
        self.variables = len(rises)
        self.ranges: list[Range] = []
        self._signs = torch.tensor([1.0 if up else -1.0 for up in rises], dtype=torch.float64)

    def turn(self, progress: Tensor) -> Tensor:
        """Returns (num_envs, variables) as float64, all of them rising."""
        return progress.double() * self._signs

    def include(self, turned: Tensor) -> list[Growth]:
        """Grows the ranges until every row of (num_envs, variables), all finite, is inside.

        Returns:
            What grew, in the order in which counts must be merged; at the very first step nothing does.
        """
        lows, highs = turned.amin(dim=0).tolist(), turned.amax(dim=0).tolist()
        if not self.ranges:
            self.ranges = [first_range(low, high, self.bins) for low, high in zip(lows, highs, strict=True)]
        growths = []
        for variable, extremes in enumerate(zip(lows, highs, strict=True)):
            for value in extremes:
                old = self.ranges[variable]
                if not old.low <= value < old.high:
                    self.ranges[variable], image = grow(old, value)
                    growths.append(Growth(variable, torch.tensor(image)))
        return growths

    def indices(self, turned: Tensor) -> Tensor:
        """Returns the bin of each value of (num_envs, variables), int64; values must lie inside the ranges."""
        return torch.stack([held.index(turned[:, variable]) for variable, held in enumerate(self.ranges)], dim=1)

    def encode(self, indices: Tensor) -> Tensor:
        """Returns the joint cell (rows,) of each row of bins (rows, variables); the last variable counts least."""
        cells = torch.zeros(len(indices), dtype=torch.int64)
        for column in indices.unbind(dim=1):
            cells = cells * self.bins + column
        return cells

    def decode(self, cells: Tensor) -> Tensor:
        """Returns the bins (rows, variables) of each joint cell (rows,)."""
        columns = []
        for _ in range(self.variables):
            columns.append(cells % self.bins)
            cells = cells // self.bins
        return torch.stack(columns[::-1], dim=1)

    def state(self) -> Tensor:
        """Returns the ranges as (variables, 2) float64, low and width of each; (0, 2) before the first step."""
        edges = [[held.low, held.width] for held in self.ranges]
        return torch.tensor(edges, dtype=torch.float64).reshape(-1, 2)

    def load_state(self, state: Tensor) -> None:
        """Goes on from `state()` of another object with the same variables."""
        self.ranges = [Range(low, width, self.bins) for low, width in state.tolist()]
