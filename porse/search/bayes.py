"""Short-cut Bayesian optimisation of the fusion ratio alpha (ROSKA; Huang et al., 2025, arXiv 2412.13492).

A few short trainings score a few alphas. A Gaussian process through those scores then says where on a grid of [0, 1] the
next one is expected to improve most on the best so far. Kernel and noise are fixed: nothing is fitted by iteration, so
the proposal is a closed form of the scores.
"""

import math
from collections.abc import Sequence

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern

from porse.config import ProbeParams

_STEPS = 100
GRID = tuple(index / _STEPS for index in range(_STEPS + 1))
"""All alphas that can be proposed: 0, 0.01, ..., 1."""

_DECIMALS = 9
"""Decimals of an expected improvement. LAPACK's last bits differ between CPUs; they must not choose among equals."""


def initial_alphas(count: int) -> list[float]:
    """Returns `count` points of the grid, spread evenly from 0 to 1.

    Raises:
        ValueError: `count` is not in 2..101.
    """
    if not 2 <= count <= len(GRID):
        raise ValueError(f"expected 2 to {len(GRID)} initial alphas, found {count}; change their number")
    return [GRID[round(index * _STEPS / (count - 1))] for index in range(count)]


def next_alpha(tried: Sequence[float], scores: Sequence[float], params: ProbeParams) -> float:
    """Returns the untried grid point of highest expected improvement, the smallest one where several are equal.

    Args:
        tried: the alphas so far, at least one.
        scores: their scores, higher is better. All must be finite; a training that failed needs a score too.
        params: the Gaussian process and its acquisition.

    Raises:
        ValueError: the scores do not match the alphas or are not finite, or the whole grid has been tried.
    """
    untried = [alpha for alpha in GRID if alpha not in tried]
    if not untried:
        raise ValueError(f"expected fewer alphas than the grid has, found all {len(GRID)} tried; lower their number")
    gains = [round(gain, _DECIMALS) for gain in expected_improvement(tried, scores, untried, params)]
    return untried[gains.index(max(gains))]


def best_alpha(tried: Sequence[float], scores: Sequence[float]) -> float:
    """Returns the alpha of the highest score, the largest one where several are equal: it keeps most of the policy.

    Raises:
        ValueError: the scores do not match the alphas or are not finite.
    """
    _check(tried, scores)
    return max(zip(tried, scores, strict=True), key=lambda pair: (pair[1], pair[0]))[0]


def expected_improvement(
    tried: Sequence[float], scores: Sequence[float], alphas: Sequence[float], params: ProbeParams
) -> list[float]:
    """Returns E[max(0, f(alpha) - best - xi)] for each of `alphas`, in standard deviations of the scores.

    Raises:
        ValueError: the scores do not match the alphas or are not finite.
    """
    _check(tried, scores)
    standard = _standardised(scores)
    process = GaussianProcessRegressor(Matern(params.length, nu=2.5), alpha=params.noise, optimizer=None)
    process.fit(np.array(tried)[:, None], np.array(standard))
    means, deviations = process.predict(np.array(alphas)[:, None], return_std=True)
    target = max(standard) + params.xi
    return [
        _mean_excess(mean - target, deviation)
        for mean, deviation in zip(means.tolist(), deviations.tolist(), strict=True)
    ]


def _mean_excess(mean: float, deviation: float) -> float:
    """Returns E[max(0, x)] for x normal: mean Phi(z) + deviation phi(z), z = mean / deviation."""
    if deviation == 0.0:
        return max(0.0, mean)
    z = mean / deviation
    below = 0.5 * math.erfc(-z / math.sqrt(2.0))
    density = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    return mean * below + deviation * density


def _standardised(scores: Sequence[float]) -> list[float]:
    """Returns the scores with mean 0 and standard deviation 1, or zeros where all are equal."""
    low, spread = min(scores), max(scores) - min(scores)
    # Asked here, not of the deviation: the mean of equal numbers may be off by a last bit.
    if spread == 0.0:
        return [0.0] * len(scores)
    # Scaled to [0, 1] first: the squares of very small differences would vanish.
    scaled = [(score - low) / spread for score in scores]
    mean = math.fsum(scaled) / len(scaled)
    deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in scaled) / len(scaled))
    return [(value - mean) / deviation for value in scaled]


def _check(tried: Sequence[float], scores: Sequence[float]) -> None:
    if not tried or len(tried) != len(scores) or not all(map(math.isfinite, scores)):
        raise ValueError(
            f"expected a finite score for each alpha tried, found the alphas {list(tried)} and the scores {list(scores)};"
            " give a training that failed the worst score of the others"
        )
