"""Visit counts over the affordance state space, and the bonus for rare cells.

bonus = lambda / sqrt(N(cell)), with N counted before it is read, so N >= 1 (eq. 3). The space has at most `cells`
cells: D progress variables get floor(cells ** (1 / D)) bins each. Counts are shared by all environments of a candidate.
An update costs the same at the first step and at the millionth; growth of a range costs one pass over the cells and
happens a few dozen times at most.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from porse.exploration.ranges import Range, first_range, grow


def bins_per_variable(cells: int, variables: int) -> int:
    """Returns the largest B with B ** variables <= cells."""
    bins = 1
    while (bins + 1) ** variables <= cells:
        bins += 1
    return bins


class VisitCounts:
    """Counts the visits of one candidate's cells, and pays the bonus.

    Args:
        rises: for each progress variable, whether it rises as the task is done; a falling one is turned round.
        cells: most cells of the space (C of the paper).
        scale: lambda of eq. 3.
    """

    def __init__(self, rises: Sequence[bool], cells: int, scale: float) -> None:
        self._signs = torch.tensor([1.0 if up else -1.0 for up in rises], dtype=torch.float64)
        self._scale = scale
        self._bins = bins_per_variable(cells, len(rises))
        self._ranges: list[Range] = []
        self.counts = torch.zeros(self._bins ** len(rises), dtype=torch.int64)

    def bonus(self, progress: Tensor) -> Tensor:
        """Counts one step of all environments and returns their bonus.

        Args:
            progress: (num_envs, variables), the progress variables after the step. An environment with a value that is
                not finite is not counted.

        Returns:
            (num_envs,) float32, in (0, lambda]; 0 where a value is not finite.
        """
        turned = progress.double() * self._signs
        finite = torch.isfinite(turned).all(dim=1)
        if not bool(finite.all()):
            bonus = torch.zeros(len(progress))
            if bool(finite.any()):
                bonus[finite] = self.bonus(progress[finite])
            return bonus
        cells = self._cells(turned)
        self.counts += torch.bincount(cells, minlength=len(self.counts))
        # rsqrt, not sqrt: PyTorch's square root differs between CPU vendors.
        return self._scale * torch.rsqrt(self.counts[cells].float())

    def _cells(self, turned: Tensor) -> Tensor:
        """Returns the cell of each row of (num_envs, variables), after growing the ranges to hold them."""
        lows, highs = turned.amin(dim=0).tolist(), turned.amax(dim=0).tolist()
        if not self._ranges:
            self._ranges = [first_range(low, high, self._bins) for low, high in zip(lows, highs, strict=True)]
        for variable, (low, high) in enumerate(zip(lows, highs, strict=True)):
            self._include(variable, low)
            self._include(variable, high)
        cells = torch.zeros(len(turned), dtype=torch.int64)
        for variable, bins in enumerate(self._ranges):
            cells = cells * self._bins + bins.index(turned[:, variable])
        return cells

    def _include(self, variable: int, value: float) -> None:
        """Grows one variable's range until `value` is inside, and merges the counts likewise."""
        old = self._ranges[variable]
        if old.low <= value < old.high:
            return
        new, image = grow(old, value)
        shape = (self._bins,) * len(self._ranges)
        merged = torch.zeros(shape, dtype=torch.int64)
        merged.index_add_(variable, torch.tensor(image), self.counts.reshape(shape))
        self._ranges[variable] = new
        self.counts = merged.reshape(-1)

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""
        edges = [[bins.low, bins.width] for bins in self._ranges]
        return {"counts": self.counts.clone(), "ranges": torch.tensor(edges, dtype=torch.float64).reshape(-1, 2)}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()` of another object with the same variables."""
        self.counts = state["counts"].clone()
        self._ranges = [Range(low, width, self._bins) for low, width in state["ranges"].tolist()]
