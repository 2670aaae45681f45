"""What the runs of suites reached, as two tables that Git tracks: `python -m porse.comparison.evidence SUITE... docs/results`.

`runs.csv` has a row for each run, `winners.csv` one for each iteration of each run. Suites take hours, so the tables grow: a run
that is finished here replaces its row, and all others stay as they are. The page of results is made from these tables alone
(`porse.comparison.results_page`).

The column `curves` is a SHA-256 of all that was measured in a run. Where a run that stands in the table is computed again, the
command says whether it has the same bits.
"""

import csv
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from porse import tables
from porse.config import ROOT, load_params, presets_root
from porse.errors import PorseError
from porse.printing import echo
from porse.report.answer import author_of
from porse.report.results import read_figures
from porse.suite.folders import folders_of
from porse.suite.plan import Entry, load_suite
from porse.suite.status import suite_status

Line = Mapping[str, str]
"""A row of a table, as it stands in the file."""

RUNS, WINNERS = "runs.csv", "winners.csv"
RUN_COLUMNS = (
    "suite", "entry", "task", "method", "ablation", "variant", "seed", "author", "score", "mts", "success", "success_low",
    "success_high", "evaluation_score_mean", "evaluation_score_std", "evaluation_mts_mean", "evaluation_seeds", "epochs_spent",
    "epochs_allowed", "environment_steps", "functions", "valid_functions", "curves",
)  # fmt: skip
"""`author` is `model`, `grammar`, `files` or `nobody`, `curves` a hash; the others are figures of `porse.report.figures`.

A figure that is undefined is an empty cell, as is the MTS with further seeds of runs from before it was kept.
"""
WINNER_COLUMNS = ("suite", "entry", "iteration", "score", "mts", "beta", "alpha")


@dataclass(frozen=True)
class Evidence:
    """The two tables."""

    runs: Sequence[Line]
    winners: Sequence[Line]


def read_evidence(folder: Path) -> Evidence:
    """Returns the tables in a folder; both are empty where it has none.

    Raises:
        PorseError: a table has other columns.
    """
    return Evidence(_read(folder / RUNS, RUN_COLUMNS), _read(folder / WINNERS, WINNER_COLUMNS))


def write_evidence(found: Evidence, folder: Path) -> None:
    """Writes the tables to a folder."""
    for path, columns, lines in (
        (folder / RUNS, RUN_COLUMNS, found.runs),
        (folder / WINNERS, WINNER_COLUMNS, found.winners),
    ):
        with path.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, columns, lineterminator="\n")
            writer.writeheader()
            writer.writerows(lines)


def evidence_of(suite: str, entry: Entry, folder: Path) -> Evidence:
    """Returns the rows of one finished run.

    Args:
        suite: the name of its suite.
        entry: what it is there.
        folder: of its `params.yaml` and `results/`.

    Raises:
        ParamsError: there are no parameters, or they are wrong.
        TableError: a table is missing or is not as declared.
    """
    figures = read_figures(folder)
    named = {"suite": suite, "entry": entry.name}
    what = {name: str(getattr(entry, name)) for name in ("task", "method", "ablation", "variant", "seed")}
    measured = {name: _text(figures[name]) for name in RUN_COLUMNS if name in figures}
    curves = hashlib.sha256((folder / "results" / "curves.parquet").read_bytes()).hexdigest()
    run = {
        **named,
        **what,
        "author": author_of(load_params(folder / "params.yaml", presets_root(folder))),
        **measured,
        "curves": curves[:16],
    }
    iterations = tables.read(folder / "results" / "iterations.parquet", tables.ITERATIONS)
    winners = [named | {name: _text(row[name]) for name in WINNER_COLUMNS[2:]} for row in iterations]
    return Evidence([run], winners)


def merged(old: Evidence, new: Evidence, order: Sequence[tuple[str, str]]) -> Evidence:
    """Returns both, where a run of `new` stands in place of its rows in `old`.

    Args:
        old: rows that stay unless `new` has the same run.
        new: rows of runs that are finished here.
        order: suite and entry of runs, in which the rows stand; those of others come first, as they were.
    """
    replaced = {_key(line) for line in new.runs}
    places = {key: place for place, key in enumerate(order)}

    def joined(before: Sequence[Line], after: Sequence[Line]) -> list[Line]:
        lines = [*(line for line in before if _key(line) not in replaced), *after]
        return sorted(lines, key=lambda line: places.get(_key(line), -1))

    return Evidence(joined(old.runs, new.runs), joined(old.winners, new.winners))


def changed(old: Evidence, new: Evidence) -> tuple[list[str], list[str]]:
    """Returns the entries of `new` that also stand in `old`: those with the same bits, and those with others."""
    before = {_key(line): line["curves"] for line in old.runs}
    again = [line for line in new.runs if _key(line) in before]
    same, other = (
        [line["entry"] for line in again if (before[_key(line)] == line["curves"]) is kept] for kept in (True, False)
    )
    return same, other


def _key(line: Line) -> tuple[str, str]:
    return line["suite"], line["entry"]


def _read(path: Path, columns: Sequence[str]) -> list[Line]:
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        lines: list[Line] = list(reader)
    if tuple(reader.fieldnames or ()) != tuple(columns):
        raise PorseError(
            f"expected the columns {', '.join(columns)} in {path}, found {', '.join(reader.fieldnames or ())}; remove the file, "
            "and collect the suites again"
        )
    return lines


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _finished(paths: Iterable[Path]) -> tuple[Evidence, list[tuple[str, str]]]:
    runs: list[Line] = []
    winners: list[Line] = []
    order = []
    for path in paths:
        suite = load_suite(path)
        for status in suite_status(suite, ROOT, str(path)):
            order.append((suite.name, status.entry.name))
            if status.state == "done":
                found = evidence_of(suite.name, status.entry, folders_of(suite.name, ROOT).result(status.entry.name))
                runs += found.runs
                winners += found.winners
    return Evidence(runs, winners), order


@click.command()
@click.argument("suites", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(suites: tuple[Path, ...], folder: Path) -> None:
    """Write what the finished runs of SUITES reached to the tables in FOLDER; rows of other runs stay."""
    old, (new, order) = read_evidence(folder), _finished(suites)
    same, other = changed(old, new)
    write_evidence(merged(old, new, order), folder)
    echo(
        f"{len(new.runs)} runs: {len(new.runs) - len(same) - len(other)} new, {len(same)} with the same bits as before"
    )
    for entry in other:
        echo(f"{entry} has other bits than before")


if __name__ == "__main__":
    main()
