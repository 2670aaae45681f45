"""What came out of finished runs."""

import json
from pathlib import Path

import click

from porse.commands import EXISTING
from porse.outdated import warn_of_another_run
from porse.printing import echo
from porse.report.markdown import results_table
from porse.report.results import read_results
from porse.report.trends import read_finished, trends, trends_table


@click.command("results")
@click.argument("run", default=".", type=EXISTING)
@click.option(
    "--json", "as_json", is_flag=True, help="Print all figures and the rows of the iterations, as a JSON object."
)
def show_results(run: Path, as_json: bool) -> None:
    """Print score and MTS by iteration, and final success, of the finished run in the folder RUN, as Markdown.

    Where params.yaml is no longer that of the run, a line on standard error says so.
    """
    warn_of_another_run(run)
    found = read_results(run)
    if not as_json:
        echo(results_table(found.iterations, found.figures))
        return
    params = found.params
    named = {"task": params.task, "method": params.method, "ablation": params.ablation, "seed": params.seed}
    echo(json.dumps({**named, **found.figures, "iterations": found.iterations}, indent=2))


@click.command("trends")
@click.argument("runs", nargs=-1, type=EXISTING)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of objects.")
def show_trends(runs: tuple[Path, ...], as_json: bool) -> None:
    """Print beta and alpha of the winners by iteration, over the finished runs in the folders RUNS, `.` by default."""
    folders = runs or (Path(),)
    for folder in folders:
        warn_of_another_run(folder)
    found = trends(map(read_finished, folders))
    echo(json.dumps(found, indent=2) if as_json else trends_table(found))
