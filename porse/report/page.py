"""A finished run as one HTML page that needs nothing else: no script, no network, no other file; charts and film are in it.

What comes from a model is hostile text. The templates escape everything, code is escaped token by token
(`porse.report.source`), and the page itself forbids whatever is not a style sheet or a picture of its own.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import BaseLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from porse.errors import PorseError
from porse.printing import visible
from porse.report.answer import (
    Beside,
    Fact,
    answers,
    asked,
    beside_paper,
    budget,
    figure,
    lineage_charts,
    repliers,
    weights,
    weights_chart,
    winners_chart,
)
from porse.report.charts import BOTTOM, HEIGHT, LEFT, RIGHT, TOP, Chart, draw
from porse.report.detail import Attempt, Function, charts, dropped, functions, population_chart, series_of
from porse.report.population import ENDS, Member, anchor, members
from porse.report.results import Results
from porse.report.source import style_sheet
from porse.report.tree import HEAD, ROW, Tree, tree
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
class Film:
    """The winner in motion: an animated GIF, empty where there is none, its size in pixels, and words about it."""

    gif: bytes
    width: int
    height: int
    words: str

    @property
    def address(self) -> str:
        """The film itself, as an address that needs no network."""
        return f"data:image/gif;base64,{base64.b64encode(self.gif).decode('ascii')}"


def no_film(why: str) -> Film:
    """Returns what a page has in a film's place: why there is none."""
    return Film(b"", 0, 0, why)


@dataclass(frozen=True)
class Page:
    """All that the page shows, in its order."""

    title: str
    asked: Sequence[Fact]
    answers: Sequence[Fact]
    beside: Sequence[Beside]
    film: Film
    winners: Sequence[Row]
    winners_chart: Chart
    lineage_charts: Sequence[Chart]
    tree: Tree
    rungs: Sequence[str]
    chapters: Sequence[Chapter]
    weights: Sequence[Mapping[str, Any]]
    weights_chart: Chart
    iterations: Sequence[Row]
    figures: Mapping[str, Any]
    repliers: Sequence[Mapping[str, Any]]
    budget: Sequence[Fact]
    environment: Mapping[str, str]


def page_of(results: Results, film: Film) -> Page:
    """Returns all that the page shows of a run, with a film of its winner."""
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
        beside_paper(results),
        film,
        results.evaluation.lineage,
        winners_chart(results),
        lineage_charts(results),
        tree([[shown.member for shown in chapter.candidates] for chapter in chapters], rungs),
        rungs,
        chapters,
        weights(results),
        weights_chart(results),
        results.iterations,
        results.figures,
        repliers(run.replies),
        budget(results),
        results.environment,
    )


def templates(loader: BaseLoader) -> Environment:
    """Returns templates that escape what is not marked as safe, with the filters and numbers that the charts need."""
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"figure": figure, "visible": visible, "anchor": anchor, "drawn": draw}
    field = {"height": HEIGHT, "left": LEFT, "right": RIGHT, "top": TOP, "bottom": HEIGHT - BOTTOM}
    environment.globals |= {"field": field, "ends": ENDS, "tree_head": HEAD, "tree_row": ROW}
    return environment


def render(page: Page) -> str:
    """Returns the page as HTML.

    Raises:
        PorseError: it is larger than a page may be.
    """
    environment = templates(PackageLoader("porse.report", "pages"))
    # Safe: colours that pygments ships.
    text = environment.get_template("page.html.jinja").render(page=page, code_style=Markup(style_sheet()))
    size = len(text.encode("utf-8"))
    if size > MOST_BYTES:
        raise PorseError(
            f"expected a page of at most {MOST_BYTES} bytes, found {size}; the run has more code or more candidates than one page can show: read its tables in results/ instead"
        )
    return text
