"""Visit counts over the affordance state space, and the bonus for rare cells.

bonus = lambda / sqrt(N(cell)), with N counted before it is read, so N >= 1 (eq. 3). The space has at most `cells`
cells: D progress variables get floor(cells ** (1 / D)) bins each. Counts are shared by all environments of a candidate.
An update costs the same at the first step and at the millionth; growth of a range costs one pass over the cells and
happens a few dozen times at most.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from porse.exploration.bins import Growth
from porse.exploration.counts import ProgressCounts


def bins_per_variable(cells: int, variables: int) -> int:
    """Returns the largest B with B ** variables <= cells."""
    bins = 1
    while (bins + 1) ** variables <= cells:
        bins += 1
    return bins


class VisitCounts(ProgressCounts):
    """Counts the visits of one candidate's cells, and pays the bonus.

    Args:
        rises: for each progress variable, whether it rises as the task is done; a falling one is turned round.
        cells: most cells of the space (C of the paper).
        scale: lambda of eq. 3.
    """

    def __init__(self, rises: Sequence[bool], cells: int, scale: float) -> None:
        super().__init__(rises, bins_per_variable(cells, len(rises)), scale)
        self.counts = torch.zeros(self.space.bins ** len(rises), dtype=torch.int64)

    def _count(self, indices: Tensor) -> Tensor:
        """Returns the visits of each state's cell."""
        cells = self.space.encode(indices)
        self.counts += torch.bincount(cells, minlength=len(self.counts))
        return self.counts[cells]

    def _merge(self, growth: Growth) -> None:
        """Merges the counts of cells that are one cell after a range has grown."""
        shape = (self.space.bins,) * self.space.variables
        merged = torch.zeros(shape, dtype=torch.int64)
        merged.index_add_(growth.variable, growth.image, self.counts.reshape(shape))
        self.counts = merged.reshape(-1)

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs."""
        return {"counts": self.counts.clone(), "ranges": self.space.state()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()` of another object with the same variables."""
        self.counts = state["counts"].clone()
        self.space.load_state(state["ranges"])
