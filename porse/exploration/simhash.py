"""Cells by hashes of states (SimHash; Tang et al., 2017, "#Exploration").

phi(s) = sign(A s), A of independent standard normal entries: states in similar directions share a code. Codes are few
enough for a table with one exact count for each.
"""

import torch
from torch import Tensor

_MOST_BITS = 20
"""A table of 2^20 counts is 8 MiB in every checkpoint."""


def hash_codes(states: Tensor, projection: Tensor) -> Tensor:
    """Returns the code of each state, int64: bit i is set where row i of A s is not negative.

    Args:
        states: (num_envs, width).
        projection: A, (bits, width) float64.

    Returns:
        (num_envs,), each in 0 .. 2^bits - 1; -1 where a value is not finite.
    """
    # In float64 a sign is decided by rounding about never, so a code does not depend on the order of the sums.
    signs = states.double() @ projection.T >= 0.0
    codes = (signs.long() << torch.arange(len(projection))).sum(dim=1)
    return torch.where(states.isfinite().all(dim=1), codes, -1)


class SimHash:
    """The hash of one training.

    Args:
        width: numbers in a state.
        bits: bits of a code, 1 to 20.
        seed: names the draw of A.

    Attributes:
        projection: A, (bits, width) float64.
        cells: how many codes there are.

    Raises:
        ValueError: `bits` is out of range.
    """

    def __init__(self, width: int, bits: int, seed: int) -> None:
        if not 1 <= bits <= _MOST_BITS:
            raise ValueError(f"expected 1 to {_MOST_BITS} bits of a hash, found {bits}; change their number")
        generator = torch.Generator().manual_seed(seed)
        # Drawn on the processor: the same numbers on all devices.
        self.projection = torch.randn((bits, width), generator=generator, dtype=torch.float64, device="cpu")
        self.cells: int = 2**bits

    def locate(self, states: Tensor) -> Tensor:
        """Returns the cell of each state of (num_envs, width): (num_envs,) int64, -1 where a value is not finite."""
        return hash_codes(states, self.projection)
