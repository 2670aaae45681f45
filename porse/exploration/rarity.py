"""How rare a visited cell is: what a bonus is made of."""

import torch
from torch import Tensor

from porse.exploration.counts import Visits


def literal(visits: Visits) -> Tensor:
    """Returns 1 / sqrt(N), N being the visits of a state's cell (eq. 3): (steps, num_envs) float32, 0 if not counted.

    It fades as counts grow.
    """
    return _inverse_root(visits.own.double())


def relative(visits: Visits) -> Tensor:
    """Returns sqrt(mean visits of the visited cells / N): (steps, num_envs) float32, 0 if not counted.

    It is 1 for a cell of average rarity, however many states were counted.
    """
    return _inverse_root(visits.own / visits.mean)


def _inverse_root(numbers: Tensor) -> Tensor:
    # rsqrt, not sqrt: PyTorch's square root differs between CPU vendors.
    return torch.where(numbers > 0.0, torch.rsqrt(numbers.float()), 0.0)
