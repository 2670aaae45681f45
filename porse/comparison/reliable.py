"""What many runs say together: interquartile mean and probability of improvement, with bootstrap intervals.

These are the statistics that Agarwal et al., "Deep reinforcement learning at the edge of the statistical precipice" (2021),
recommend for few seeds. Resampling is stratified: seeds are drawn within each task. docs/decisions.md says why SciPy computes them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, mannwhitneyu, trim_mean

Strata = Sequence[Sequence[float]]
"""The values of one method: for each task those of its seeds."""

_RESAMPLES = 10_000
_QUARTER = 0.25


@dataclass(frozen=True)
class Estimate:
    """A statistic, and the ends of its 95 % interval; they are None for a task with fewer than two seeds."""

    value: float
    low: float | None
    high: float | None


def interquartile_mean(values: Strata) -> Estimate:
    """Returns the mean of the middle half of all values; a quarter at each end, rounded down, counts nowhere."""

    def statistic(*samples: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        joined = np.concatenate(samples, axis=axis)
        return np.asarray(trim_mean(joined, _QUARTER, axis=axis))

    return _estimate(values, statistic)


def probability_of_improvement(own: Strata, other: Strata) -> Estimate:
    """Returns how often a run of one method is better than one of another on the same task, a tie as a half; mean over tasks.

    Args:
        own: values of the method.
        other: values of the other one, for the same tasks in the same order.
    """

    def statistic(*samples: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        shares = [
            mannwhitneyu(mine, theirs, axis=axis).statistic / (mine.shape[axis] * theirs.shape[axis])
            for mine, theirs in zip(samples[: len(own)], samples[len(own) :], strict=True)
        ]
        return np.asarray(np.mean(shares, axis=0))

    return _estimate([*own, *other], statistic)


def _estimate(strata: Strata, statistic: Callable[..., NDArray[np.float64]]) -> Estimate:
    samples = [np.asarray(values, dtype=np.float64) for values in strata]
    value = float(statistic(*samples))
    if min(map(len, samples)) < 2:
        return Estimate(value, None, None)
    generator = np.random.default_rng(0)
    found = bootstrap(
        samples, statistic, n_resamples=_RESAMPLES, method="percentile", vectorized=True, rng=generator, batch=1000
    ).confidence_interval
    return Estimate(value, float(found.low), float(found.high))
