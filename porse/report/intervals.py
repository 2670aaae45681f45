"""Means with their intervals, one below the other, as numbers: where they go. A macro of `pages/charts.jinja` draws them."""

from collections.abc import Sequence
from dataclasses import dataclass

from porse.report.charts import Tick, spread_apart, ticks

WIDTH, SIDE = 480, 24
"""Width of a drawing in units of its view box, and of its margins."""
ROW, TOP, BOTTOM = 34, 4, 26
"""Height of a row, whose name stands above its value, and of the margins."""
MOST_TICKS = 6


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
        return round(SIDE + (x - least) / (greatest - least) * (WIDTH - 2 * SIDE), 1)

    def maybe(x: float | None) -> float | None:
        return None if x is None else across(x)

    return Intervals(
        title,
        TOP + ROW * len(shown) + BOTTOM,
        # Their words stand beside each other: not too many.
        [Tick(across(x), f"{x:g}") for x in places[:: -(-len(places) // MOST_TICKS)]],
        [
            Place(
                each, TOP + ROW * (row + 0.7), across(each.value), maybe(each.low), maybe(each.high), maybe(each.other)
            )
            for row, each in enumerate(shown)
        ],
    )
