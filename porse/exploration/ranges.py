"""Bins over a range that grows: exact merging, so that old counts stay right.

A range is `bins` equal bins of a width that is a power of two, starting at a multiple of that width. It grows by
doubling the width and merging neighbouring bins in pairs. Widths and edges being multiples of powers of two, doubling is
exact in floating point: a value's new bin is always the merged image of its old one.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

_SMALLEST_WIDTH = 2.0**-20
"""Width of a bin when all first values are equal, times the value's own power of two where that is above one."""


@dataclass(frozen=True)
class Range:
    """`bins` bins of `width`, from `low` upwards."""

    low: float
    width: float
    bins: int

    @property
    def high(self) -> float:
        """The upper edge, which belongs to the last bin's neighbour above."""
        return self.low + self.width * self.bins

    def index(self, values: Tensor) -> Tensor:
        """Returns the bin of each value (any shape, float64), int64; values must lie inside."""
        bins = torch.floor((values - self.low) / self.width)
        # The difference may round a value just below an edge onto it: -1e-20 - (-1) is 1. The edges themselves are exact.
        return (bins - (values < self.low + bins * self.width).double()).long()


def first_range(low: float, high: float, bins: int) -> Range:
    """Returns the smallest range of `bins` bins, on the grid of powers of two, that starts by covering [low, high]."""
    floor = _SMALLEST_WIDTH * _power_of_two_above(max(1.0, abs(low), abs(high)))
    width = _power_of_two_above(max((high - low) / bins, floor))
    start = Range(math.floor(low / width) * width, width, bins)
    return start if high < start.high else grow(start, high)[0]


def grow(old: Range, value: float) -> tuple[Range, list[int]]:
    """Returns the range doubled toward `value` until it is inside, and the new bin of each old bin.

    Growing upward keeps the lower edge and merges bins (0, 1), (2, 3), ...; growing downward keeps the upper edge and
    merges (last, last - 1), ...
    """
    new, image = old, list(range(old.bins))
    while not new.low <= value < new.high:
        upward = value >= new.high
        last = new.bins - 1
        image = [bin_ // 2 if upward else last - (last - bin_) // 2 for bin_ in image]
        low = new.low if upward else new.low - new.width * new.bins
        new = Range(low, 2.0 * new.width, new.bins)
    return new, image


def _power_of_two_above(number: float) -> float:
    """Returns the smallest power of two that is at least `number` (> 0)."""
    mantissa, exponent = math.frexp(number)
    return math.ldexp(1.0, exponent - 1 if mantissa == 0.5 else exponent)
