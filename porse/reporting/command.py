"""The command `porse report`."""

from pathlib import Path

import click

from porse.errors import PorseError
from porse.report.page import page_of, render
from porse.report.results import read_results
from porse.reporting.film import winner_film


@click.command()
@click.argument("run", default=Path(), required=False, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--out",
    default="report.html",
    show_default=True,
    type=click.Path(dir_okay=False, path_type=Path),
    help="The page to write.",
)
def report(run: Path, out: Path) -> None:
    """Write one HTML page about the finished run in the folder RUN, `.` by default; it opens without a network."""
    results = read_results(run)
    text = render(page_of(results, winner_film(results.params, run)))
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PorseError(
            f"expected to write the page to {out}, found: {error.strerror}; choose another --out"
        ) from error
    click.echo(f"{out}: {len(text.encode('utf-8')) / 1024:.0f} KiB; open it in a browser")
