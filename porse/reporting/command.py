"""The command `porse report`."""

from pathlib import Path

import click

from porse.errors import PorseError
from porse.report.page import no_film, page_of, render
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
@click.option("--film/--no-film", "films", default=True, help="Show the winner in motion; drawing it takes seconds.")
def report(run: Path, out: Path, films: bool) -> None:
    """Write one HTML page about the finished run in the folder RUN, `.` by default; it opens without a network."""
    results = read_results(run)
    film = winner_film(results.params, run) if films else no_film("the page was written with --no-film.")
    text = render(page_of(results, film))
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PorseError(
            f"expected to write the page to {out}, found: {error.strerror}; choose another --out"
        ) from error
    click.echo(f"{out}: {len(text.encode('utf-8')) / 1024:.0f} KiB; open it in a browser")
