"""Visit counts over hashed states, and the bonus for rare hashes (SimHash; Tang et al., 2017, "#Exploration").

bonus = scale / sqrt(N(phi(s))), with N counted before it is read. phi(s) = sign(A s), A of independent standard normal
entries: states in similar directions share a code. Codes are few enough for a table with one exact count for each.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from porse.exploration.bonus import pay_finite, rarity

_MOST_BITS = 20
"""A table of 2^20 counts is 8 MiB in every checkpoint."""


def hash_codes(states: Tensor, projection: Tensor) -> Tensor:
    """Returns the code of each state, int64: bit i is set where row i of A s is not negative.

    Args:
        states: (num_envs, width), finite.
        projection: A, (bits, width) float64.

    Returns:
        (num_envs,), each in 0 .. 2^bits - 1.
    """
    # In float64 a sign is decided by rounding about never, so a code does not depend on the order of the sums.
    signs = states.double() @ projection.T >= 0.0
    return (signs.long() << torch.arange(len(projection))).sum(dim=1)


class SimHashCounts:
    """Counts the visits of hashed states, and pays the bonus.

    Args:
        width: numbers in a state.
        bits: bits of a code, 1 to 20.
        scale: the bonus of a first visit.
        seed: names the draw of A.

    Raises:
        ValueError: `bits` is out of range.
    """

    def __init__(self, width: int, bits: int, scale: float, seed: int) -> None:
        if not 1 <= bits <= _MOST_BITS:
            raise ValueError(f"expected 1 to {_MOST_BITS} bits of a hash, found {bits}; change their number")
        generator = torch.Generator().manual_seed(seed)
        self.projection = torch.randn((bits, width), generator=generator, dtype=torch.float64)
        self._scale = scale
        self.counts = torch.zeros(2**bits, dtype=torch.int64)

    def bonus(self, states: Tensor) -> Tensor:
        """Counts one step of all environments and returns their bonus.

        Args:
            states: (num_envs, width), the states after the step. An environment with a value that is not finite is not
                counted.

        Returns:
            (num_envs,) float32, in (0, scale]; 0 where a value is not finite.
        """
        return pay_finite(states, self._pay)

    def _pay(self, states: Tensor) -> Tensor:
        codes = hash_codes(states, self.projection)
        self.counts += torch.bincount(codes, minlength=len(self.counts))
        return rarity(self.counts[codes], self._scale)

    def state(self) -> dict[str, Tensor]:
        """Returns the counts; A follows from the seed."""
        return {"counts": self.counts.clone()}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Goes on from `state()` of another object made with the same arguments."""
        self.counts = state["counts"].clone()
