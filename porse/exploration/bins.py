"""The affordance state space: bins of the progress variables that outliers cannot spoil, and one cell for their bins.

A variable x has bins uniform in asinh((x - m) / s): as good as even within s of the centre m, ever wider beyond, and the
two at the ends catch the rest. m is the median and s a quarter of the 95 % quantile of |x - m|, both of the first epoch
that is counted, so that one value of a thousand times the size moves them by one rank at most. The bins reach to 1 000 s,
250 times as far as those 95 %, and stay as they are: a state's cell never changes.
"""

import functools
from collections.abc import Mapping, Sequence
from decimal import Decimal, localcontext
from typing import Literal

import torch
from torch import Tensor

Discretiser = Literal["grid", "sum"]

_REACH = 1000
"""The outermost bins end here, in units of s; what lies beyond belongs to them."""
_QUANTILE = 95
"""Which percentile of |x - m| is 4 s."""
_LEAST_UNIT = 2.0**-10
"""Least s, times |m| where that is above 1: what varies by less in the first epoch, a variable that is constant there
above all, is noise, and bins of its size would put all later states into the two at the ends."""
_DIGITS = 50


def bins_per_variable(cells: int, variables: int) -> int:
    """Returns the largest B with B ** variables <= cells."""
    bins = 1
    while (bins + 1) ** variables <= cells:
        bins += 1
    return bins


def bins_per_summand(cells: int, variables: int) -> int:
    """Returns the largest B with variables * (B - 1) + 1 <= cells."""
    return (cells - 1) // variables + 1


@functools.cache
def unit_edges(bins: int) -> tuple[float, ...]:
    """Returns the `bins` - 1 edges between bins for m = 0 and s = 1, rising: sinh at even steps from -1 000 to 1 000.

    By decimal arithmetic, whose digits depend on no mathematics library, and symmetric to the last bit.
    """
    with localcontext(prec=_DIGITS):
        reach = Decimal(_REACH)
        # exp(asinh(reach) / bins), one half step of asinh; edges lie whole steps apart, and symmetric about 0.
        half = ((reach + (reach * reach + 1).sqrt()).ln() / bins).exp()
        power = half if bins % 2 else half * half
        positive = []
        for _ in range((bins - 1) // 2):
            positive.append(float((power - 1 / power) / 2))
            power *= half * half
    middle = () if bins % 2 else (0.0,)
    return (*(-edge for edge in reversed(positive)), *middle, *positive)


def centre_and_unit(values: Tensor) -> tuple[float, float]:
    """Returns m and s of a variable's values (samples,), all finite and at least one: both are exact to the last bit."""
    centre = float(values.sort().values[(len(values) - 1) // 2])
    spread = (values - centre).abs().sort().values[-(-len(values) * _QUANTILE // 100) - 1]
    return centre, max(float(spread) / 4.0, _LEAST_UNIT * max(1.0, abs(centre)))


class ProgressSpace:
    """The cells of a candidate's progress variables, fixed by the first values.

    Args:
        rises: for each progress variable, whether it rises as the task is done; a falling one is turned round.
        cells: most cells of the space (C of the paper).
        discretiser: how the cell follows from the bins: a `grid` has one for each combination, floor(C^(1/D)) bins for
            each of D variables; `sum` adds the bins' numbers (LLMCount; ProgressCounts, arXiv 2410.09187).

    Attributes:
        bins: bins of each variable.
        cells: how many cells there are, at most those that were asked for.
    """

    def __init__(self, rises: Sequence[bool], cells: int, discretiser: Discretiser) -> None:
        variables = len(rises)
        if discretiser == "sum":
            self.bins = bins_per_summand(cells, variables)
            self.cells = variables * (self.bins - 1) + 1
            self._weights = [1] * variables
        else:
            self.bins = bins_per_variable(cells, variables)
            self.cells = self.bins**variables
            self._weights = [self.bins**place for place in reversed(range(variables))]
        self._signs = [1.0 if up else -1.0 for up in rises]
        self._unit_edges = torch.tensor(unit_edges(self.bins), dtype=torch.float64)
        self.forget()

    def forget(self) -> None:
        """Makes the next values the first."""
        self._fits = torch.full((len(self._signs), 2), torch.nan, dtype=torch.float64)

    @property
    def is_fitted(self) -> bool:
        """Whether there were values that fix the bins."""
        return not bool(self._fits.isnan().any())

    def locate(self, progress: Tensor) -> Tensor:
        """Returns the cell of each state; where no bins are fixed yet, these states fix them.

        Args:
            progress: (steps, num_envs, variables) float32, the progress variables.

        Returns:
            (steps, num_envs) int64, from 0; -1 where a value is not finite.
        """
        columns = zip(progress.unbind(dim=-1), self._signs, strict=True)
        turned = [values.double().contiguous() * sign for values, sign in columns]
        # In double precision no sum of a few float32 overflows, so it is finite where all are.
        finite = torch.stack(turned).sum(dim=0).isfinite()
        if not self.is_fitted and bool(finite.any()):
            fits = [centre_and_unit(values[finite]) for values in turned]
            self._fits = torch.tensor(fits, dtype=torch.float64)
        cells = torch.zeros(finite.shape, dtype=torch.int64)
        for values, (centre, unit), weight in zip(turned, self._fits.tolist(), self._weights, strict=True):
            edges = self._unit_edges * unit + centre
            # A value on an edge lies in the bin above it.
            cells += weight * torch.bucketize(values, edges, right=True)
        return torch.where(finite, cells, -1)

    def state(self) -> dict[str, Tensor]:
        """Returns m and s of each variable, (variables, 2) float64; NaN before the first values."""
        return {"bins": self._fits.clone()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()` of another space with the same arguments.

        Raises:
            ValueError: it is of another number of variables.
        """
        if state["bins"].shape != self._fits.shape:
            raise ValueError(f"its bins are of {len(state['bins'])} progress variables, not of {len(self._fits)}")
        self._fits = state["bins"].clone()
