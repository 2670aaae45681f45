"""Variants of a suite against one of them, seed by seed: mean differences with bootstrap intervals."""

import csv
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from porse import tables
from porse.errors import PorseError
from porse.report.figures import spread
from porse.report.results import read_figures, read_winner
from porse.suite.folders import Folders
from porse.suite.plan import Entry, Suite
from porse.suite.status import aligned

COLUMNS = (
    "task", "method", "ablation", "variant", "figure", "seeds", "mean", "deviation", "difference", "low", "high",
)  # fmt: skip
"""`difference` is the mean over seeds of the variant's figure less the baseline's, `low` and `high` its interval."""

_RESAMPLES = 10_000
_LAST_EPOCHS = 10
"""A series of the curves counts by its mean over so many last epochs."""


@dataclass(frozen=True)
class Figure:
    """One figure of a run.

    Attributes:
        name: one of `porse.report.figures.run_figures`, as `score` or `success`, or a series of the curves, as
            `progress/opening`, of the run's winner in the iteration that it won.
    """

    name: str

    def of(self, result: Path) -> float:
        """Returns the figure of the run whose results are in the folder `result`.

        Raises:
            PorseError: the run has no such figure.
            TableError: a table of the run is missing or is not as declared.
        """
        figures = read_figures(result)
        if figures.get(self.name) is not None:
            return float(figures[self.name])
        winner = read_winner(result)
        curves = tables.read(result / "results" / "curves.parquet", tables.CURVES)
        rows = [row for row in curves if all(row[name] == winner[name] for name in ("iteration", "candidate_id"))]
        series = sorted((row["epoch"], row["value"]) for row in rows if row["series"] == self.name)
        if not series:
            names = ", ".join(sorted({row["series"] for row in rows}))
            raise PorseError(
                f"expected {self.name} to be a figure or a series of the curves of the run in {result}, found neither; its "
                f"figures are {', '.join(name for name in figures if figures[name] is not None)}, its series {names}"
            )
        last = [value for _, value in series[-_LAST_EPOCHS:]]
        return math.fsum(last) / len(last)


def compared(
    suite: Suite, folders: Folders, baseline: str | None, figures: Sequence[Figure]
) -> list[dict[str, object]]:
    """Returns a row of `COLUMNS` for each figure of each group of entries that differ by their seed alone.

    Args:
        suite: the suite.
        folders: where its results are; entries that are not done are left out.
        baseline: the variant that others are compared with, where both are done; None where nobody named one.
        figures: what is compared.

    Raises:
        PorseError: there are no variants, none has the baseline's name, or a run has no such figure.
    """
    variants = sorted({entry.variant for entry in suite.entries})
    if variants == [""]:
        raise PorseError(
            f"expected variants in the suite {suite.name}, found none; add `variants`, a name with its parameters for each, as "
            "suites/beta-sweep.yaml does, or compare methods with `porse report --compare`"
        )
    if baseline not in variants:
        found = "found no --baseline" if baseline is None else f"found {baseline!r}"
        raise PorseError(
            f"expected a variant of the suite {suite.name} that the others are compared with, {found}; its variants are "
            f"{', '.join(map(repr, variants))}"
        )
    groups: dict[tuple[str, str, str, str], list[Entry]] = {}
    for entry in suite.entries:
        if (folders.result(entry.name) / "done.json").exists():
            groups.setdefault((entry.task, entry.method, entry.ablation, entry.variant), []).append(entry)
    rows: list[dict[str, object]] = []
    for group, entries in groups.items():
        others = {entry.seed: entry for entry in groups.get((*group[:3], baseline), [])}
        for figure in figures:
            values = {entry.seed: figure.of(folders.result(entry.name)) for entry in entries}
            base = {seed: figure.of(folders.result(others[seed].name)) for seed in values if seed in others}
            differences = [values[seed] - base[seed] for seed in sorted(base)]
            row: dict[str, object] = dict(zip(COLUMNS[:4], group, strict=True))
            row |= {"figure": figure.name, "seeds": len(values)}
            measured = spread(figure.name, list(values.values()))
            row |= {"mean": measured[f"{figure.name}_mean"], "deviation": measured[f"{figure.name}_std"]}
            rows.append({**row, **paired(differences)})
    return rows


def paired(differences: Sequence[float]) -> dict[str, float | None]:
    """Returns the mean of paired differences and its interval, see `mean_interval`; all None where there are no pairs."""
    if not differences:
        return {"difference": None, "low": None, "high": None}
    return dict(zip(("difference", "low", "high"), mean_interval(differences), strict=True))


def mean_interval(values: Sequence[float]) -> tuple[float, float | None, float | None]:
    """Returns the mean of values, at least one, and the ends of its interval, 95 % in name (BCa bootstrap, SciPy).

    Of three values it covers about 70 %, of five about 84 %. The ends are None for fewer than two values; they are the mean
    itself where all values are equal.
    """
    mean = math.fsum(values) / len(values)
    if len(values) < 2:
        return mean, None, None
    if min(values) == max(values):
        return mean, mean, mean
    with warnings.catch_warnings():
        # With few values the acceleration may be undefined; the interval is then NaN, and the percentile one stands in.
        warnings.simplefilter("ignore")
        interval = _interval(values, "BCa")
        if not all(map(math.isfinite, interval)):
            interval = _interval(values, "percentile")
    return mean, *interval


def _interval(values: Sequence[float], method: str) -> tuple[float, float]:
    generator = np.random.default_rng(0)
    found: Any = bootstrap((np.array(values),), np.mean, n_resamples=_RESAMPLES, method=method, rng=generator)
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def write_csv(rows: Iterable[Mapping[str, object]], path: Path) -> None:
    """Writes rows of `compared` to a CSV file, numbers with four digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        for row in rows:
            writer.writerow({name: _cell(row[name]) for name in COLUMNS})


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def compared_text(rows: Iterable[Mapping[str, object]]) -> str:
    """Returns rows of `compared` as a table for people."""
    return aligned([COLUMNS, *(tuple(_cell(row[name]) or "-" for name in COLUMNS) for row in rows)])
