"""How far a suite is and what came out of it: rows, a summary over seeds, and both as text."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from porse.report.figures import human_normalised_score, spread
from porse.report.results import read_figures
from porse.suite.folders import Folders, folders_of, is_locked
from porse.suite.plan import Entry, Suite
from porse.suite.resolve import Resolved, code_id, resolve, tracked_files
from porse.suite.run import failure, is_done

_FIGURES = (
    "score", "mts", "hns_lineage", "hns_budget", "success", "success_low", "success_high",
    "evaluation_score_mean", "evaluation_score_std", "evaluation_mts_mean", "evaluation_mts_std", "evaluation_failed",
    "epochs_spent", "epochs_allowed", "valid_share",
)  # fmt: skip
_NAMES = ("task", "method", "ablation", "variant")
"""What entries that differ by their seed alone have in common."""

State = Literal["done", "failed", "running", "partial", "outdated", "waiting"]


@dataclass(frozen=True)
class Status:
    """One entry of a suite.

    Attributes:
        state: `partial` began and was interrupted; `outdated` was done with other parameters or other code.
        figures: the run's (`porse.report.figures.run_figures`) where it is done, else None.
        reason: why it failed, else None.
    """

    entry: Entry
    state: State
    figures: Mapping[str, Any] | None
    reason: str | None


def suite_status(suite: Suite, root: Path, where: str) -> list[Status]:
    """Returns the status of every entry, in order.

    Args:
        suite: the suite.
        root: the project's root.
        where: names the suite's file in errors.

    Raises:
        ParamsError: the parameters of an entry are wrong.
        TableError: a table of a result is missing or is not as declared.
        PorseError: `root` is no Git repository.
    """
    folders = folders_of(suite.name, root)
    running = is_locked(folders.lock)
    code = code_id(root, tracked_files(root))
    return [_status(folders, resolved, running) for resolved in resolve(suite, root, code, where)]


def _status(folders: Folders, resolved: Resolved, running: bool) -> Status:
    name = resolved.entry.name
    if is_done(folders, resolved):
        return Status(resolved.entry, "done", read_figures(folders.result(name)), None)
    reason = failure(folders, name)
    current = folders.begun(name)
    state: State = "waiting"
    if reason is not None:
        state = "failed"
    elif running and current is not None:
        state = "running"
    elif current == {"entry": name, **resolved.ids}:
        state = "partial"
    elif (folders.result(name) / "done.json").exists():
        state = "outdated"
    return Status(resolved.entry, state, None, reason)


def rows(statuses: Sequence[Status]) -> list[dict[str, Any]]:
    """Returns one row for each entry, in order; figures are None where there are none.

    `hns_lineage` and `hns_budget` are measured against the suite's own entries of the methods `human` and `sparse`, and of
    `human-budget` and `sparse-budget`, with the same task, variant and seed (eq. 8), and where one of the two is not done,
    against the references of `params.yaml`.
    """
    measured = {
        (status.entry.method, status.entry.task, status.entry.variant, status.entry.seed): status.figures["mts"]
        for status in statuses
        if status.figures is not None and status.entry.ablation == "none"
    }
    return [_row(status, measured) for status in statuses]


def _row(status: Status, measured: Mapping[tuple[str, str, str, int], float]) -> dict[str, Any]:
    entry, figures = status.entry, status.figures
    row = {
        "entry": entry.name,
        "task": entry.task,
        "method": entry.method,
        "ablation": entry.ablation,
        "variant": entry.variant,
        "seed": entry.seed,
        "state": status.state,
        "reason": status.reason,
    }
    if figures is None:
        return row | dict.fromkeys(_FIGURES)
    found = {name: figures[name] for name in _FIGURES}
    for length, end in (("lineage", ""), ("budget", "-budget")):
        human, sparse = (
            measured.get((f"{method}{end}", entry.task, entry.variant, entry.seed)) for method in ("human", "sparse")
        )
        if human is not None and sparse is not None:
            found[f"hns_{length}"] = human_normalised_score(figures["mts"], human, sparse)
    return row | found


def summary(entries: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Returns, for each task, method, ablation and variant with something done, mean and deviation of score and MTS.

    Args:
        entries: rows of `rows`.

    Returns:
        Rows in the order of the entries. The deviation is that of a sample (n - 1), None for fewer than two seeds.
    """
    groups: dict[tuple[str, ...], list[Mapping[str, Any]]] = {}
    for row in entries:
        if row["mts"] is not None:
            groups.setdefault(tuple(row[name] for name in _NAMES), []).append(row)
    return [
        dict(zip(_NAMES, group, strict=True))
        | {
            "seeds": len(done),
            **spread("score", [row["score"] for row in done]),
            **spread("mts", [row["mts"] for row in done]),
        }
        for group, done in groups.items()
    ]


def status_text(entries: Sequence[Mapping[str, Any]]) -> str:
    """Returns the rows and their summary as two tables for people, with the reasons of failures between them."""
    titles = ("entry", "state", "score", "MTS", "HNS", "HNS (budget)", "success", "evaluation", "epochs", "valid")
    parts = [aligned([titles, *(_cells(row) for row in entries)])]
    reasons = [f"{row['entry']} failed: {row['reason']}" for row in entries if row["reason"] is not None]
    if reasons:
        parts.append("\n".join(reasons))
    groups = summary(entries)
    if groups:
        named = [name for name in _NAMES if name != "variant" or any(row["variant"] for row in groups)]
        parts.append(aligned([(*named, "seeds", "score", "MTS"), *(_group_cells(row, named) for row in groups)]))
    return "\n\n".join(parts)


def _group_cells(group: Mapping[str, Any], named: Sequence[str]) -> tuple[str, ...]:
    cells = [group[name] or "-" for name in named]
    figures = (_spread(group[f"{figure}_mean"], group[f"{figure}_std"]) for figure in ("score", "mts"))
    return (*cells, str(group["seeds"]), *figures)


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    if row["mts"] is None:
        return (row["entry"], row["state"], *["-"] * 8)
    return (
        row["entry"],
        row["state"],
        f"{row['score']:.3f}",
        f"{row['mts']:.3f}",
        *("undefined" if row[name] is None else f"{row[name]:.2f}" for name in ("hns_lineage", "hns_budget")),
        f"{row['success']:.3f} ({row['success_low']:.3f} to {row['success_high']:.3f})",
        _evaluation(row),
        f"{row['epochs_spent']}/{row['epochs_allowed']}",
        "-" if row["valid_share"] is None else f"{row['valid_share']:.2f}",
    )


def _evaluation(row: Mapping[str, Any]) -> str:
    """Returns the score that the lineage reached with further seeds, and how many of these failed."""
    failed = f", {row['evaluation_failed']} failed" if row["evaluation_failed"] else ""
    return _spread(row["evaluation_score_mean"], row["evaluation_score_std"]) + failed


def _spread(mean: float | None, std: float | None) -> str:
    if mean is None:
        return "-"
    return f"{mean:.3f}" if std is None else f"{mean:.3f} +- {std:.3f}"


def aligned(lines: Sequence[Sequence[str]]) -> str:
    """Returns lines of cells as a table whose columns line up."""
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines
    )
