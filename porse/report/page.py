"""A finished run as one HTML page that needs nothing else: no script, no network, no other file.

What comes from a model is hostile text. The templates escape everything, code is escaped token by token
(`porse.report.source`), and the page itself forbids whatever is not a style sheet of its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from porse.errors import PorseError
from porse.report.answer import (
    Fact,
    answers,
    asked,
    budget,
    figure,
    repliers,
    weights,
    weights_chart,
    winners_chart,
)
from porse.report.charts import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, WIDTH, Chart, draw
from porse.report.detail import Attempt, Function, charts, dropped, functions, population_chart, series_of
from porse.report.population import Member, anchor, members
from porse.report.results import Results, read_results
from porse.report.source import style_sheet, visible
from porse.tables import Row

MOST_BYTES = 8 * 2**20
"""Of a page."""


@dataclass(frozen=True)
class Candidate:
    """A candidate as the page shows it: its place in the tree, its functions, its charts."""

    member: Member
    functions: Sequence[Function]
    charts: Sequence[Chart]


@dataclass(frozen=True)
class Chapter:
    """An iteration as the page shows it.

    Attributes:
        row: its row of the iterations table.
        candidates: its candidates, as the tree orders them.
        chart: their fitness.
        dropped: the replies of slots in which no function passed.
    """

    row: Row
    candidates: Sequence[Candidate]
    chart: Chart
    dropped: Sequence[Sequence[Attempt]]


@dataclass(frozen=True)
class Page:
    """All that the page shows, in its order."""

    title: str
    asked: Sequence[Fact]
    answers: Sequence[Fact]
    winners: Sequence[Row]
    winners_chart: Chart
    rungs: Sequence[str]
    chapters: Sequence[Chapter]
    weights: Sequence[Mapping[str, Any]]
    weights_chart: Chart
    iterations: Sequence[Row]
    replies: Mapping[str, Any]
    repliers: Sequence[Mapping[str, Any]]
    budget: Sequence[Fact]
    environment: Mapping[str, str]


def page_of(results: Results) -> Page:
    """Returns all that the page shows of a run."""
    params, run = results.params, results.run
    rungs = [str(rung.rung) for rung in params.rungs]
    series = series_of(run.curves)
    chapters = []
    for index, row in enumerate(results.iterations):
        n = row["iteration"]
        before = run.incumbents[index - 1] if index else None
        candidates = [
            Candidate(
                member,
                functions(run, member.row, before),
                charts(series.get((n, member.row["candidate_id"]), {})),
            )
            for member in members(run, n, row["winner_id"], rungs)
        ]
        chapters.append(Chapter(row, candidates, population_chart(series, n, row["winner_id"]), dropped(run, n)))
    return Page(
        f"{params.task}: {params.method}, seed {params.seed}",
        asked(params),
        answers(results),
        results.evaluation.chain,
        winners_chart(results),
        rungs,
        chapters,
        weights(results),
        weights_chart(results),
        results.iterations,
        results.metrics["replies"],
        repliers(run.replies),
        budget(results),
        results.environment,
    )


def render(page: Page) -> str:
    """Returns the page as HTML.

    Raises:
        PorseError: it is larger than a page may be.
    """
    environment = Environment(
        loader=PackageLoader("porse.report", "pages"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"figure": figure, "visible": visible, "anchor": anchor, "drawn": draw}
    field = {
        "width": WIDTH,
        "height": HEIGHT,
        "left": LEFT,
        "right": WIDTH - RIGHT,
        "top": TOP,
        "bottom": HEIGHT - BOTTOM,
    }
    environment.globals |= {"field": field}
    # Safe: colours that pygments ships.
    text = environment.get_template("page.html.jinja").render(page=page, code_style=Markup(style_sheet()))
    size = len(text.encode("utf-8"))
    if size > MOST_BYTES:
        raise PorseError(
            f"expected a page of at most {MOST_BYTES} bytes, found {size}; the run has more code or more candidates than one page can show: read its tables in results/ instead"
        )
    return text


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
    text = render(page_of(read_results(run)))
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise PorseError(
            f"expected to write the page to {out}, found: {error.strerror}; choose another --out"
        ) from error
    click.echo(f"{out}: {len(text.encode('utf-8')) / 1024:.0f} KiB; open it in a browser")
