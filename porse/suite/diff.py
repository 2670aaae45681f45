"""What a suite's results are now and what they were before an entry ran again, as `dvc metrics diff` has it for one run."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from porse.report.results import read_figures
from porse.suite.folders import folders_of
from porse.suite.plan import Suite
from porse.suite.status import Status, aligned, rows

FIGURES = ("score", "mts", "hns_lineage", "success", "evaluation_score_mean", "epochs_spent", "valid_share")
"""What is compared, as `porse suite status --json` names it."""

_DIGITS = 3


def suite_diff(suite: Suite, statuses: Sequence[Status], root: Path) -> list[dict[str, Any]]:
    """Returns what differs between the results that entries had before and those that they have now.

    Args:
        suite: the suite.
        statuses: of its entries, now.
        root: the project's root.

    Returns:
        One row for each entry and figure that differ: `before`, `now`, and `change`, now - before. A figure is None
        where an entry has no result, or had none; an entry without an earlier result has no row.

    Raises:
        TableError: a table of an earlier result is missing or is not as declared.
    """
    folders = folders_of(suite.name, root)
    earlier = []
    for status in statuses:
        folder = folders.earlier(status.entry.name)
        figures = read_figures(folder) if (folder / "done.json").is_file() else None
        earlier.append(replace(status, state="done", reason=None, figures=figures))
    found: list[dict[str, Any]] = []
    for before, now in zip(rows(earlier), rows(statuses), strict=True):
        found += [] if before["mts"] is None else _differences(before, now)
    return found


def _differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "entry": now["entry"],
            "figure": figure,
            "before": before[figure],
            "now": now[figure],
            "change": None if None in (before[figure], now[figure]) else now[figure] - before[figure],
        }
        for figure in FIGURES
        if before[figure] != now[figure]
    ]


def diff_text(differences: Sequence[Mapping[str, Any]]) -> str:
    """Returns the rows of `suite_diff` as a table for people."""
    if not differences:
        return "nothing differs from earlier results, or no entry has run again"
    cells = [
        (row["entry"], row["figure"], *(_cell(row[name]) for name in ("before", "now", "change")))
        for row in differences
    ]
    return aligned([("entry", "figure", "before", "now", "change"), *cells])


def _cell(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.{_DIGITS}f}"
