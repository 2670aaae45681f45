"""What all counters share: the bonus of a visit, and rows that are not finite."""

from collections.abc import Callable

import torch
from torch import Tensor


def rarity(visits: Tensor, scale: float) -> Tensor:
    """Returns scale / sqrt(visits) as float32, for visits >= 1 (eq. 3)."""
    # rsqrt, not sqrt: PyTorch's square root differs between CPU vendors.
    return scale * torch.rsqrt(visits.float())


def pay_finite(rows: Tensor, pay: Callable[[Tensor], Tensor]) -> Tensor:
    """Returns `pay` of the rows of (num_envs, width) that are finite throughout, (num_envs,); 0 for the others.

    `pay` sees finite rows only, so what is not finite is not counted. Without any finite row it is not called.
    """
    finite = torch.isfinite(rows).all(dim=1)
    if bool(finite.all()):
        return pay(rows)
    bonus = torch.zeros(len(rows))
    if bool(finite.any()):
        bonus[finite] = pay(rows[finite])
    return bonus
