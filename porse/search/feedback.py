"""V(theta): what the next prompts are told about a training (as in Eureka: sampled series with their extremes).

Sums of floats are `math.fsum`: rounded once, they are the same in every version of Python.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from porse.tables import Row

SHOWN = ("fitness", "component/", "progress/")
"""Series that prompts show: fitness, reward components, progress variables."""


@dataclass(frozen=True)
class Series:
    """One series of one candidate over all its epochs."""

    name: str
    epochs: tuple[int, ...]
    values: tuple[float, ...]

    def last(self, window: int) -> "Series":
        """Returns the series over its last `window` epochs."""
        return Series(self.name, self.epochs[-window:], self.values[-window:])

    def sampled(self, points: int) -> "Series":
        """Returns at most `points` evenly spaced epochs of the series, its last one among them."""
        count = len(self.epochs)
        if count <= points:
            return self
        chosen = [((index + 1) * count) // points - 1 for index in range(points)]
        return Series(self.name, tuple(self.epochs[i] for i in chosen), tuple(self.values[i] for i in chosen))


def shown_series(curves: Sequence[Row], candidate_id: str) -> list[Series]:
    """Returns the series of a candidate that prompts show, fitness first, then by name."""
    values: dict[str, list[tuple[int, float]]] = {}
    for row in curves:
        if row["candidate_id"] == candidate_id and row["series"].startswith(SHOWN):
            values.setdefault(row["series"], []).append((row["epoch"], row["value"]))
    return [
        Series(name, tuple(epoch for epoch, _ in sorted(points)), tuple(value for _, value in sorted(points)))
        for name, points in sorted(values.items(), key=lambda item: (item[0] != "fitness", item[0]))
    ]


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
        for series in shown_series(curves, candidate_id)
        for epoch, value in zip(series.sampled(points).epochs, series.sampled(points).values, strict=True)
    ]
