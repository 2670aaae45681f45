"""Visit counts over the sum of bins, and the bonus for rare sums (LLMCount; ProgressCounts, arXiv 2410.09187).

bonus = lambda / sqrt(N(cell)), with N counted before it is read. A state's cell is the sum of its D variables' bins: with
B bins for each there are D (B - 1) + 1 cells. When a variable's range grows, the sums cannot be merged: states of equal
sum may part. So every joint cell that was visited is remembered with its number of visits, the growth is applied to those,
and the sums are counted anew; old counts stay exactly right.

A step reads the dense counts and appends its joint cells to a buffer. The buffer is folded into the sorted table of joint
cells when it holds many steps and is no shorter than the table, so that a visit's share of the cost stays the same however
many came before it.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from porse.exploration.bins import Growth
from porse.exploration.counts import ProgressCounts

_BUFFERED_STEPS = 256
"""Steps in the buffer at least, before it is folded into the table."""


def bins_per_summand(cells: int, variables: int) -> int:
    """Returns the largest B with variables * (B - 1) + 1 <= cells."""
    return (cells - 1) // variables + 1


class SumCounts(ProgressCounts):
    """Counts the visits of one candidate's sums of bins, and pays the bonus.

    Args:
        rises: for each progress variable, whether it rises as the task is done; a falling one is turned round.
        cells: most cells of the space.
        scale: lambda, the bonus of a first visit.

    Raises:
        ValueError: the joint cells are too many for an int64.
    """

    def __init__(self, rises: Sequence[bool], cells: int, scale: float) -> None:
        super().__init__(rises, bins_per_summand(cells, len(rises)), scale)
        self.counts = torch.zeros(len(rises) * (self.space.bins - 1) + 1, dtype=torch.int64)
        self._joint = torch.zeros(0, dtype=torch.int64)
        self._visits = torch.zeros(0, dtype=torch.int64)
        self._buffer: list[Tensor] = []
        self._buffered = 0

    def _count(self, indices: Tensor) -> Tensor:
        """Returns the visits of each state's sum of bins."""
        self._buffer.append(self.space.encode(indices))
        self._buffered += len(indices)
        if len(self._buffer) >= _BUFFERED_STEPS and self._buffered >= len(self._joint):
            self._fold()
        sums = indices.sum(dim=1)
        self.counts += torch.bincount(sums, minlength=len(self.counts))
        return self.counts[sums]

    def _fold(self) -> None:
        """Folds the buffer into the table of joint cells."""
        visits = torch.cat([self._visits, torch.ones(self._buffered, dtype=torch.int64)])
        self._set_table(torch.cat([self._joint, *self._buffer]), visits)
        self._buffer, self._buffered = [], 0

    def _merge(self, growth: Growth) -> None:
        """Applies a growth to the joint cells, and counts the sums anew."""
        self._fold()
        indices = self.space.decode(self._joint)
        indices[:, growth.variable] = growth.image[indices[:, growth.variable]]
        self._set_table(self.space.encode(indices), self._visits)
        self._count_sums()

    def _set_table(self, joint: Tensor, visits: Tensor) -> None:
        """Makes the table of joint cells, which may repeat, with their visits: cells rising, each one once."""
        self._joint, place = torch.unique(joint, sorted=True, return_inverse=True)
        self._visits = torch.zeros_like(self._joint).index_add_(0, place, visits)

    def _count_sums(self) -> None:
        """Counts the sums from the table of joint cells."""
        sums = self.space.decode(self._joint).sum(dim=1)
        self.counts = torch.zeros_like(self.counts).index_add_(0, sums, self._visits)

    def state(self) -> dict[str, Tensor]:
        """Returns all that a continuation needs: joint cells, rising, with their visits, and the ranges."""
        self._fold()
        return {"joint": self._joint.clone(), "visits": self._visits.clone(), "ranges": self.space.state()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()` of another object with the same variables."""
        self._joint, self._visits = state["joint"].clone(), state["visits"].clone()
        self._buffer, self._buffered = [], 0
        self.space.load_state(state["ranges"])
        self._count_sums()
