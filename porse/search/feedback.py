"""V(theta): what the next prompts are told about a training (as in Eureka: sampled series with their extremes).

Sums of floats are `math.fsum`: rounded once, they are the same in every version of Python.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from porse.tables import Row

TOLD = ("fitness", "episode_length", "component/", "progress/")
"""Series that the feedback on a winner holds, by their names or how those begin, in the order that prompts show them in."""

WEIGHED = ("fitness", "goal_size", "bonus_size", "bonus_share", "cells_visited", "new_cells", "component/", "progress/")
"""Series of the record that weights of goal reward and bonus are chosen by."""

STAGED = ("fitness", "component/", "progress/")
"""Series of the record that a share of the previous winner is chosen by."""


@dataclass(frozen=True)
class Series:
    """One series of one candidate over the epochs that have a value."""

    name: str
    epochs: tuple[int, ...]
    values: tuple[float, ...]

    def last(self, window: int) -> "Series":
        """Returns the series over its last `window` epochs."""
        return Series(self.name, self.epochs[-window:], self.values[-window:])

    def sampled(self, points: int) -> "Series":
        """Returns at most `points` evenly spaced epochs of the series, its first and its last one among them.

        Args:
            points: 2 or more.
        """
        count = len(self.epochs)
        if count <= points:
            return self
        chosen = [index * (count - 1) // (points - 1) for index in range(points)]
        return Series(self.name, tuple(self.epochs[i] for i in chosen), tuple(self.values[i] for i in chosen))


def shown_of(names: Iterable[str], shown: Sequence[str]) -> list[str]:
    """Returns those of the names that begin as an entry of `shown` says, in the order of the entries, then by name."""
    places = {name: next((i for i, entry in enumerate(shown) if name.startswith(entry)), None) for name in names}
    found = [(place, name) for name, place in places.items() if place is not None]
    return [name for _, name in sorted(found)]


def shown_series(curves: Sequence[Row], candidate_id: str, shown: Sequence[str]) -> list[Series]:
    """Returns the series of a candidate that `shown` names, in its order."""
    return series_of([row for row in curves if row["candidate_id"] == candidate_id], shown)


def series_of(rows: Sequence[Row], shown: Sequence[str]) -> list[Series]:
    """Returns the series that `shown` names, in its order, from rows of the curves or the feedback of one candidate."""
    points: dict[str, list[tuple[int, float]]] = {}
    for row in rows:
        points.setdefault(row["series"], []).append((row["epoch"], row["value"]))
    found = []
    for name in shown_of(points, shown):
        epochs, values = zip(*sorted(points[name]), strict=True)
        found.append(Series(name, epochs, values))
    return found


def feedback_rows(curves: Sequence[Row], candidate_id: str, points: int) -> list[Row]:
    """Returns the rows of the feedback table for one candidate."""
    return [
        {
            "series": series.name,
            "epoch": epoch,
            "value": value,
            "maximum": max(series.values),
            "mean": math.fsum(series.values) / len(series.values),
            "minimum": min(series.values),
        }
        for series in shown_series(curves, candidate_id, TOLD)
        for epoch, value in zip(series.sampled(points).epochs, series.sampled(points).values, strict=True)
    ]
