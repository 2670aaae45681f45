"""Fusion of policies: theta_f = alpha theta_best + (1 - alpha) theta_random, over actor and critic (section 3.3)."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

Policy = Mapping[str, NDArray[np.generic]]
"""A policy's arrays by dotted name."""

INHERITED = ".obs_normalizer."
"""Part of the names of the running observation statistics, which are theta_best's: averaging them means nothing."""


def fuse(best: Policy, random: Policy, alpha: float) -> dict[str, NDArray[np.generic]]:
    """Returns the fused policy, in the arrays' own precision.

    Raises:
        ValueError: the policies have other names or shapes than each other.
    """
    if {name: array.shape for name, array in best.items()} != {name: array.shape for name, array in random.items()}:
        raise ValueError("expected two policies of one network, found other names or shapes")
    return {name: _fuse_array(name, best[name], random[name], alpha) for name in sorted(best)}


def _fuse_array(name: str, best: NDArray[np.generic], random: NDArray[np.generic], alpha: float) -> NDArray[np.generic]:
    if INHERITED in name:
        return best.copy()
    share = np.float32(alpha)
    return share * best.astype(np.float32) + (np.float32(1.0) - share) * random.astype(np.float32)
