"""Means with their intervals, one below the other, as numbers: where they go. A macro of `pages/charts.jinja` draws them."""

from collections.abc import Sequence
from dataclasses import dataclass

from porse.report.charts import Tick, spread_apart, ticks

WIDTH, WORDS, RIGHT = 480, 170, 16
"""Width of a drawing in units of its view box, of the words at its left, and of its right margin."""
ROW, TOP, BOTTOM = 22, 8, 26
"""Height of a row, and of the margins."""
MOST_TICKS = 5


@dataclass(frozen=True)
class Interval:
    """A value with its name, the ends of its interval (None for none), and a value from elsewhere to compare it with."""

    name: str
    value: float
    low: float | None
    high: float | None
    other: float | None


@dataclass(frozen=True)
class Place:
    """An interval in its place; what is None is not drawn."""

    interval: Interval
    down: float
    value: float
    low: float | None
    high: float | None
    other: float | None


@dataclass(frozen=True)
class Intervals:
    """The whole drawing."""

    title: str
    height: int
    ticks: Sequence[Tick]
    places: Sequence[Place]


def intervals(title: str, shown: Sequence[Interval], within: Sequence[float] = ()) -> Intervals:
    """Returns the drawing of intervals, at least one; the axis reaches from one end of `within` to the other, or further."""
    numbers = [x for each in shown for x in (each.value, each.low, each.high, each.other) if x is not None]
    least, greatest = spread_apart([*numbers, *within])
    places = ticks(least, greatest)

    def across(x: float) -> float:
        return round(WORDS + (x - least) / (greatest - least) * (WIDTH - WORDS - RIGHT), 1)

    def maybe(x: float | None) -> float | None:
        return None if x is None else across(x)

    return Intervals(
        title,
        TOP + ROW * len(shown) + BOTTOM,
        # Their words stand beside each other: not too many.
        [Tick(across(x), f"{x:g}") for x in places[:: -(-len(places) // MOST_TICKS)]],
        [
            Place(
                each, TOP + ROW * (row + 0.5), across(each.value), maybe(each.low), maybe(each.high), maybe(each.other)
            )
            for row, each in enumerate(shown)
        ],
    )
