"""`porse suite`: runs many configurations from one file, and shows what came out of them."""

import csv
import io
import json
from pathlib import Path

import click

from porse.errors import PorseError
from porse.printing import echo
from porse.report.trends import GROUPED, read_finished, trends, trends_table, winners_fitness
from porse.suite.diff import diff_text, suite_diff
from porse.suite.folders import folders_of
from porse.suite.plan import load_suite
from porse.suite.run import run_suite
from porse.suite.status import Status, rows, status_text, suite_status, summary

FILE = click.argument("file", type=click.Path(dir_okay=False, path_type=Path))


@click.group()
def suite() -> None:
    """Many runs from one file, to compare methods, ablations, tasks and seeds."""


@suite.command()
@FILE
def run(file: Path) -> None:
    """Run every entry of FILE that is not done, each in a clone of the project. A failed entry does not stop the others."""
    failed = run_suite(load_suite(file), Path.cwd(), str(file), echo)
    if failed:
        raise PorseError(
            f"expected every entry of {file} to get to its end, found {len(failed)} that failed: {', '.join(failed)}; "
            "fix what their logs report, and run the suite again"
        )


@suite.command()
@FILE
@click.option(
    "--diff", is_flag=True, help="Print what differs from the results that entries had before they ran again."
)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object; with --diff a list of objects.")
def status(file: Path, diff: bool, as_json: bool) -> None:
    """Print how far FILE's suite is: a row for each entry, and mean and deviation over seeds."""
    loaded = load_suite(file)
    statuses = suite_status(loaded, Path.cwd(), str(file))
    if diff:
        differences = suite_diff(loaded, statuses, Path.cwd())
        echo(json.dumps(differences, indent=2) if as_json else diff_text(differences))
        return
    entries = rows(statuses)
    if as_json:
        echo(json.dumps({"suite": loaded.name, "entries": entries, "summary": summary(entries)}, indent=2))
    else:
        echo(status_text(entries))
        echo(f"\nlogs and results: {folders_of(loaded.name, Path()).suite}")


@suite.command()
@FILE
@click.option("--baseline", help="The variant that the others are compared with; needed.")
@click.option(
    "--figure",
    "names",
    multiple=True,
    default=("score",),
    show_default=True,
    help="A figure, as `porse results --json` names it, or a series of the curves; may be given several times.",
)
@click.option("--csv", "target", type=click.Path(dir_okay=False, path_type=Path), help="Write the rows to this file.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def compare(file: Path, baseline: str | None, names: tuple[str, ...], target: Path | None, as_json: bool) -> None:
    """Print the variants of FILE's suite against one of them, seed by seed: mean differences with bootstrap intervals.

    The intervals are 95 % in name: with three seeds they cover about 70 %, with five about 84 %.
    """
    # Imported here: SciPy takes a second to import.
    from porse.suite.compare import Figure, compared, compared_text, write_csv

    loaded = load_suite(file)
    rows = compared(loaded, folders_of(loaded.name, Path.cwd()), baseline, [Figure(name) for name in names])
    if target is not None:
        write_csv(rows, target)
    echo(json.dumps(rows, indent=2) if as_json else compared_text(rows))


@suite.command("trends")
@FILE
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_trends(file: Path, as_json: bool) -> None:
    """Print beta and alpha of the winners by iteration, over the seeds of FILE's finished runs (table 18)."""
    found = trends(read_finished(folder, status.entry.variant) for status, folder in _done(file))
    echo(json.dumps(found, indent=2) if as_json else trends_table(found))


@suite.command()
@FILE
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects instead of CSV.")
def curves(file: Path, as_json: bool) -> None:
    """Print the winners' fitness by epoch of FILE's finished runs as CSV, one line for each epoch (figure 6)."""
    head = (*GROUPED, "seed", "epoch", "fitness")
    lines = []
    for status, folder in _done(file):
        names = [getattr(status.entry, name) for name in (*GROUPED, "seed")]
        lines += [(*names, epoch, value) for epoch, value in winners_fitness(read_finished(folder))]
    if as_json:
        echo(json.dumps([dict(zip(head, line, strict=True)) for line in lines], indent=2))
        return
    table = io.StringIO()
    csv.writer(table, lineterminator="\n").writerows([head, *lines])
    echo(table.getvalue(), nl=False)


def _done(file: Path) -> list[tuple[Status, Path]]:
    """Returns the finished entries of a suite, each with the folder of what came out of it."""
    loaded = load_suite(file)
    folders = folders_of(loaded.name, Path.cwd())
    statuses = suite_status(loaded, Path.cwd(), str(file))
    return [(status, folders.result(status.entry.name)) for status in statuses if status.state == "done"]
