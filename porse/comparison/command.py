"""The command `porse report`."""

from collections.abc import Callable, Sequence
from pathlib import Path

import click

from porse.comparison.film import winner_film
from porse.outdated import warn_of_another_run
from porse.paths import check_target
from porse.printing import echo, print_line
from porse.renderer import import_without_drawing
from porse.report.page import no_film, page_of, render
from porse.report.results import read_results

FORMS = (".html", ".md", ".tex", ".csv")
"""How a comparison can be written; a run is a page."""


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path))
@click.option("--compare", "compares", is_flag=True, help="Compare runs in folders and suites' files.")
@click.option(
    "--baseline", default="", help="With --compare: the method that others are compared with, as tables name it."
)
@click.option(
    "--out",
    default="report.html",
    show_default=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="The page to write; with --compare also .md, .tex or .csv.",
)
@click.option("--film/--no-film", "films", default=True, help="Show the winner in motion; drawing it takes seconds.")
def report(runs: tuple[Path, ...], compares: bool, baseline: str, out: Path, films: bool) -> None:
    """Write one HTML page about the finished run in the folder RUNS, `.` by default; it opens without a network.

    With --compare, put several runs and suites beside each other, in the form of the paper's tables and figures.
    """
    check_target(out, FORMS if compares else FORMS[:1])
    text = _compared(runs or (Path(),), baseline, out) if compares else _page(runs, baseline, films)
    out.write_text(text, encoding="utf-8")
    then = "; open it in a browser" if out.suffix == ".html" else ""
    echo(f"{out}: {len(text.encode('utf-8')) / 1024:.0f} KiB{then}")


def _page(runs: tuple[Path, ...], baseline: str, films: bool) -> str:
    if len(runs) > 1 or baseline or any(run.is_file() for run in runs):
        raise click.UsageError(
            "expected one folder of a run, found more, a file or --baseline; use --compare for several runs and suites"
        )
    run = runs[0] if runs else Path()
    warn_of_another_run(run)
    results = read_results(run)
    if films:
        film = winner_film(results.params, run)
        if not film.gif:
            print_line("warning: ", f"the page has no film: {film.words}", hang=0, err=True)
    else:
        import_without_drawing()
        film = no_film("the page was written with --no-film.")
    return render(page_of(results, film))


def _compared(runs: tuple[Path, ...], baseline: str, out: Path) -> str:
    # Imported here: SciPy takes a second to import.
    from porse.comparison.compare import Comparison, comparison
    from porse.comparison.forms import csv_of, latex_of, markdown_of
    from porse.comparison.page import html_of
    from porse.comparison.sources import read_sources

    forms: Sequence[Callable[[Comparison], str]] = (html_of, markdown_of, latex_of, csv_of)
    for run in filter(Path.is_dir, runs):
        warn_of_another_run(run)
    form = dict(zip(FORMS, forms, strict=True))[out.suffix.lower()]
    return form(comparison(read_sources(runs), baseline))
