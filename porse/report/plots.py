"""What `dvc plots` draws beside the fitness of the winners: tables of numbers, over rows of a run."""

import math
import statistics
from collections.abc import Sequence

from porse.tables import Row

Rows = list[list[str | int | float]]
"""The titles, then a line for each epoch, or for each of something in it."""

_PART = "component/"


def spread_rows(curves: Sequence[Row]) -> Rows:
    """Returns the lowest, the median and the highest fitness over the candidates of each epoch, iteration after iteration.

    The epoch counts on over the iterations. A fitness that is not a finite number counts nowhere.
    """
    by_epoch: dict[tuple[int, int], list[float]] = {}
    for row in curves:
        if row["series"] == "fitness" and math.isfinite(row["value"]):
            by_epoch.setdefault((row["iteration"], row["epoch"]), []).append(row["value"])
    last: dict[int, int] = {}
    for iteration, epoch in sorted(by_epoch):
        last[iteration] = epoch
    found: Rows = [["epoch", "iteration", "candidates", "lowest", "median", "highest"]]
    for (iteration, epoch), values in sorted(by_epoch.items()):
        before = sum(epochs for other, epochs in last.items() if other < iteration)
        ends = (min(values), statistics.median(values), max(values))
        found.append([before + epoch, iteration, len(values), *ends])
    return found


def bonus_rows(curves: Sequence[Row], lineage: Sequence[Row]) -> Rows:
    """Returns share and size of the bonus, and the size of the goal, for each epoch of a lineage of candidates."""
    names = ("bonus_share", "bonus_size", "goal_size")
    found: Rows = [["epoch", *names, "candidate"]]
    for link in lineage:
        series = {name: _series(curves, link, name) for name in names}
        # A run without the one has none of the others.
        for epoch in sorted(set.intersection(*map(set, series.values()))):
            found.append([len(found), *(series[name][epoch] for name in names), link["candidate_id"]])
    return found


def component_rows(curves: Sequence[Row], lineage: Sequence[Row]) -> Rows:
    """Returns the mean of each component of the reward for each epoch of a lineage of candidates, one line for each."""
    found: Rows = [["epoch", "component", "mean", "candidate"]]
    before = 0
    for link in lineage:
        epochs = sorted(_series(curves, link, "fitness"))
        names = sorted({row["series"] for row in curves if _is_of(row, link) and row["series"].startswith(_PART)})
        for name in names:
            values = _series(curves, link, name)
            found += [
                [before + number, name.removeprefix(_PART), values[epoch], link["candidate_id"]]
                for number, epoch in enumerate(epochs, 1)
                if epoch in values
            ]
        before += len(epochs)
    return found


def _series(curves: Sequence[Row], link: Row, name: str) -> dict[int, float]:
    return {row["epoch"]: row["value"] for row in curves if row["series"] == name and _is_of(row, link)}


def _is_of(row: Row, link: Row) -> bool:
    return (row["iteration"], row["candidate_id"]) == (link["iteration"], link["candidate_id"])
