"""All that the page shows of one candidate: its functions, how they were checked, and its series. Pure functions over rows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from porse.report.charts import Chart, Line, Point
from porse.report.population import parents
from porse.report.run import Run
from porse.report.source import differences, listing
from porse.tables import Row

KINDS = ("reward", "mapping")

STREAMS: Sequence[tuple[str, str, Mapping[str, str]]] = (
    ("Size of goal and bonus", "deviation", {"goal_size": "goal", "bonus_size": "bonus"}),
    ("Share of the bonus", "share", {"bonus_share": "share"}),
    ("Cells visited", "share", {"cells_visited": "share"}),
)
"""Charts of goal and bonus: title, unit, and the words for their series."""

Series = Mapping[str, Sequence[Point]]
"""The points of each series of one candidate, by name, in the order of epochs."""


@dataclass(frozen=True)
class Attempt:
    """A reply and the verdict on the function in it."""

    verdict: Row
    text: str


@dataclass(frozen=True)
class Difference:
    """What differs from an earlier function, as HTML; empty where nothing does.

    Attributes:
        since: the row of the candidate that has the earlier one.
        why: what that candidate is to this one.
        lines: the differences.
    """

    since: Row
    why: str
    lines: Markup


@dataclass(frozen=True)
class Function:
    """A function of a candidate: its kind, its source as HTML, what differs from others, the replies up to it."""

    kind: str
    source: Markup
    differences: Sequence[Difference]
    attempts: Sequence[Attempt]


def series_of(curves: Sequence[Row]) -> dict[tuple[int, str], dict[str, list[Point]]]:
    """Returns the points of each series, by iteration and candidate, in the order of epochs."""
    found: dict[tuple[int, str], dict[str, list[Point]]] = {}
    for row in sorted(curves, key=lambda row: row["epoch"]):
        own = found.setdefault((row["iteration"], row["candidate_id"]), {})
        own.setdefault(row["series"], []).append((row["epoch"], row["value"]))
    return found


def functions(run: Run, row: Row, before: Row | None) -> list[Function]:
    """Returns the functions of a candidate that were generated.

    Args:
        run: all rows.
        row: the candidate.
        before: the candidate that the previous iteration handed on, for one that has no parent; None in the first.
    """
    earlier = [(parent, "its parent") for parent in parents(run, row)]
    if not row["parent_id"] and before is not None:
        earlier = [(before, f"the winner that iteration {row['iteration']} started from")]
    found = []
    for kind in KINDS:
        source = row[f"{kind}_source"]
        if source:
            compared = [
                Difference(other, why, differences(other[f"{kind}_source"], source))
                for other, why in earlier
                if other[f"{kind}_source"]
            ]
            found.append(
                Function(kind, listing(source), compared, attempts(run, kind, row[f"{kind}_key"], row["iteration"]))
            )
    return found


def attempts(run: Run, kind: str, key: str, iteration: int) -> list[Attempt]:
    """Returns the replies of the slot that a function came from, up to that function, the first one first.

    A function that was carried over has the replies of the iteration that it was written in.
    """
    own = [row for row in run.verdicts if (row["kind"], row["key"]) == (kind, key) and row["iteration"] <= iteration]
    if not own:
        return []
    last = max(own, key=lambda row: row["iteration"])
    return [attempt for attempt in _slot(run, last) if attempt.verdict["attempt"] <= last["attempt"]]


def dropped(run: Run, iteration: int) -> list[list[Attempt]]:
    """Returns the replies of each slot of an iteration in which no function passed."""
    slots = {(row["kind"], row["slot"]): row for row in run.verdicts if row["iteration"] == iteration}
    found = [_slot(run, row) for _, row in sorted(slots.items())]
    return [slot for slot in found if not any(attempt.verdict["passed"] for attempt in slot)]


def charts(series: Series) -> list[Chart]:
    """Returns the charts of a candidate's series, those that there are."""
    groups: list[tuple[str, str, Mapping[str, str]]] = [
        ("Fitness", "fitness", {"fitness": "fitness"}),
        ("Components of the reward", "mean", _below(series, "component/")),
        ("Progress variables", "mean", _below(series, "progress/")),
        *STREAMS,
    ]
    found = []
    for title, y_label, words in groups:
        lines = [Line(word, series[name]) for name, word in words.items() if name in series]
        if lines:
            found.append(Chart(title, "epoch of the iteration", y_label, lines))
    return found


def population_chart(series: Mapping[tuple[int, str], Series], iteration: int, winner_id: str) -> Chart:
    """Returns the chart of the fitness of all candidates of an iteration, the winner's on top."""
    own = sorted(
        ((name, points["fitness"]) for (n, name), points in series.items() if n == iteration and "fitness" in points),
        key=lambda item: (item[0] == winner_id, item[0]),
    )
    lines = [
        Line(f"{name} (winner)" if name == winner_id else name, points, strong=name == winner_id)
        for name, points in own
    ]
    return Chart(f"Fitness of the candidates of iteration {iteration}", "epoch of the iteration", "fitness", lines)


def _slot(run: Run, verdict: Row) -> list[Attempt]:
    """Returns all replies of the slot that a verdict is about."""
    place = ("iteration", "kind", "slot")
    texts = {tuple(row[name] for name in (*place, "attempt")): row["text"] for row in run.replies}
    rows = [row for row in run.verdicts if all(row[name] == verdict[name] for name in place)]
    ordered = sorted(rows, key=lambda row: row["attempt"])
    return [Attempt(row, texts.get(tuple(row[name] for name in (*place, "attempt")), "")) for row in ordered]


def _below(series: Series, prefix: str) -> dict[str, str]:
    """Returns the series whose names begin with `prefix`, in the order of names, each with the rest of its name."""
    return {name: name.removeprefix(prefix) for name in sorted(series) if name.startswith(prefix)}
