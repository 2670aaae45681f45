"""Many finished runs beside each other, in the form of the paper's tables and figures: numbers, no text."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from porse.comparison.sources import Done, Sources
from porse.errors import PorseError
from porse.report import paper
from porse.report.charts import Chart, Edge, Line, Point
from porse.report.figures import method_label, spread
from porse.report.trends import Finished, read_finished, trends, winners_fitness
from porse.suite.compare import mean_interval, paired
from porse.suite.status import rows

FIGURES: Mapping[str, str] = {
    "mts": "Maximum training success (MTS)",
    "hns_lineage": "Human normalised score, by lineage",
    "hns_budget": "Human normalised score, by budget",
    "success": "Final success",
    "score": "Score",
}
"""What is compared: columns of a suite's status, and their names."""

Group = tuple[str, str]
"""A task, and the label of what was run on it."""


@dataclass(frozen=True)
class Cell:
    """One figure of the runs of a task and a label that differ by their seeds alone.

    Attributes:
        task, label, figure: whose it is; the figure is one of `FIGURES`.
        seeds: of how many runs; those in which it is undefined count nowhere.
        mean, deviation: over them; the deviation is that of a sample, None for one.
        low, high: ends of the interval of the mean over seeds, 95 % in name; of one run, of its episodes where it has an
            interval by itself, else None.
        difference, difference_low, difference_high: mean difference to the baseline, seed by seed, and its interval.
        paper: what the paper has in its place, None for nothing.
    """

    task: str
    label: str
    figure: str
    seeds: int
    mean: float
    deviation: float | None
    low: float | None
    high: float | None
    difference: float | None
    difference_low: float | None
    difference_high: float | None
    paper: paper.Value | None


@dataclass(frozen=True)
class Comparison:
    """All that a comparison shows.

    Attributes:
        tasks, labels: in the order in which they were given.
        baseline: the label that others are compared with, empty for none.
        cells: one for each figure, task and label that has runs in which it is defined.
        weights: rows of `trends`, with the label and the paper's value (table 18).
        budget: epochs spent and allowed, and environment steps, by task and label (tables 19 and 21); means over the seeds.
        by_iteration, by_epoch: charts for each task, MTS so far by iteration (figure 5) and fitness by epoch (figure 6).
        left_out: sentences about what is not shown.
    """

    tasks: Sequence[str]
    labels: Sequence[str]
    baseline: str
    cells: Sequence[Cell]
    weights: Sequence[Mapping[str, Any]]
    budget: Sequence[Mapping[str, Any]]
    by_iteration: Sequence[Chart]
    by_epoch: Sequence[Chart]
    left_out: Sequence[str]

    def cell(self, figure: str, task: str, label: str) -> Cell | None:
        """Returns the cell of a figure, a task and a label; None where there is none."""
        names = (figure, task, label)
        return next((cell for cell in self.cells if (cell.figure, cell.task, cell.label) == names), None)


def comparison(sources: Sources, baseline: str) -> Comparison:
    """Returns finished runs beside each other.

    Args:
        sources: the runs.
        baseline: the label that others are compared with, empty for none.

    Raises:
        PorseError: no run has that label.
        TableError: a table of a run is missing or is not as declared.
    """
    entries = rows([run.status for run in sources.runs])
    groups: dict[Group, list[int]] = {}
    for place, row in enumerate(entries):
        groups.setdefault((row["task"], label_of(row)), []).append(place)
    labels = list(dict.fromkeys(label for _, label in groups))
    if baseline and baseline not in labels:
        raise PorseError(f"expected a baseline among {', '.join(labels)}, found {baseline!r}; name one of them")
    cells = []
    for figure in FIGURES:
        for (task, label), places in groups.items():
            # The baseline differs from itself by nothing.
            base = [entries[place] for place in groups.get((task, baseline), []) if label != baseline]
            cell = _cell(figure, (task, label), [entries[place] for place in places], base)
            cells += [cell] if cell else []
    finished = {place: read_finished(run.folder, run.status.entry.variant) for place, run in enumerate(sources.runs)}
    tasks = list(dict.fromkeys(task for task, _ in groups))
    return Comparison(
        tasks,
        labels,
        baseline,
        cells,
        _weights(list(finished.values())),
        [_budget(group, [sources.runs[place] for place in places]) for group, places in groups.items()],
        [
            _chart(task, groups, finished, lambda run: mts_so_far(run.iterations), "iteration", "MTS so far")
            for task in tasks
        ],
        [_chart(task, groups, finished, winners_fitness, "epoch of the winners", "fitness") for task in tasks],
        sources.left_out,
    )


def label_of(row: Mapping[str, Any]) -> str:
    """Returns what a run is called in a table: its method, with its ablation and its variant where it has them."""
    label = method_label(row["method"], row["ablation"])
    return f"{label} ({row['variant']})" if row["variant"] else label


def _cell(
    figure: str, group: Group, own: Sequence[Mapping[str, Any]], base: Sequence[Mapping[str, Any]]
) -> Cell | None:
    values = {row["seed"]: row[figure] for row in own if row[figure] is not None}
    if not values:
        return None
    others = {row["seed"]: row[figure] for row in base if row[figure] is not None}
    mean, low, high = mean_interval(list(values.values()))
    if len(values) == 1 and figure == "success":
        low, high = own[0]["success_low"], own[0]["success_high"]
    against = paired([values[seed] - others[seed] for seed in sorted(values) if seed in others])
    return Cell(
        *group,
        figure,
        len(values),
        mean,
        spread(figure, list(values.values()))[f"{figure}_std"],
        low,
        high,
        against["difference"],
        against["low"],
        against["high"],
        _published(figure, own[0]),
    )


def _published(figure: str, row: Mapping[str, Any]) -> paper.Value | None:
    """Returns the paper's value of a figure, a mean over its seeds. It has none of a variant's, and none of the budget's length."""
    if row["variant"]:
        return None
    name = (row["task"], row["method"], row["ablation"])
    if figure == "mts":
        return paper.find_mts(*name)
    score = paper.find_score(*name) if figure == "hns_lineage" else None
    value = paper.find_mts(*name)
    return None if score is None or value is None else paper.Value(value.table, score, None)


def _weights(runs: Sequence[Finished]) -> list[dict[str, Any]]:
    published = paper.winners_weights()
    return [
        {
            **row,
            "label": label_of(row),
            "paper": published.get((row["task"], row["iteration"], row["varied"]))
            if (row["method"], row["ablation"], row["variant"]) == ("porse", "none", "")
            else None,
        }
        for row in trends(runs)
    ]


def _budget(group: Group, runs: Sequence[Done]) -> dict[str, Any]:
    names = ("epochs_spent", "epochs_allowed", "environment_steps")
    figures = [run.status.figures or {} for run in runs]
    means = {name: math.fsum(each[name] for each in figures) / len(figures) for name in names}
    return {"task": group[0], "label": group[1], "runs": len(runs), **means}


def mts_so_far(rows: Sequence[Mapping[str, Any]]) -> list[tuple[int, float]]:
    """Returns each iteration with the highest MTS up to it.

    Args:
        rows: of a run's iterations, in their order.
    """
    best = accumulate((float(row["mts"]) for row in rows), max)
    return [(int(row["iteration"]), mts) for row, mts in zip(rows, best, strict=True)]


def _chart(
    task: str,
    groups: Mapping[Group, Sequence[int]],
    finished: Mapping[int, Finished],
    series: Any,
    x_label: str,
    y_label: str,
) -> Chart:
    """Returns the chart of a task: a line for each label, the mean over its runs, in a band from the least to the greatest."""
    lines = []
    for (own, label), places in groups.items():
        if own == task:
            at: dict[int, list[float]] = {}
            for place in places:
                for x, y in series(finished[place]):
                    at.setdefault(x, []).append(y)
            lines.append(line_over(label, at, len(places)))
    return Chart(task, x_label, y_label, lines)


def line_over(label: str, at: Mapping[int, Sequence[float]], runs: int) -> Line:
    """Returns the mean over runs at each x, in a band from the least to the greatest; without one for a single run.

    Args:
        label: its name.
        at: the values at each x.
        runs: how many there are.
    """
    points: list[Point] = [(x, math.fsum(values) / len(values)) for x, values in sorted(at.items())]
    band: list[Edge] = [(x, min(values), max(values)) for x, values in sorted(at.items())]
    return Line(label, points, band=band if runs > 1 else ())
