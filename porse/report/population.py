"""The population of an iteration as a tree, and how far each candidate came: pure functions over rows."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from porse.report.run import Run
from porse.tables import Row

ENDS: Mapping[str, str] = {
    "won": "won its iteration",
    "stayed": "trained to the end",
    "dropped": "eliminated",
    "failed": "failed",
}
"""How the way of a candidate ends, and the words for it."""


@dataclass(frozen=True)
class Stop:
    """Where a candidate stood at the end of one rung.

    Attributes:
        rung: the rung.
        place: its rank, from 1.
        of: how many were ranked.
        score: what ranked it.
        mts: its highest fitness so far.
        failed: whether its training ended early, or another probe beat it.
        survives: whether it went on.
    """

    rung: str
    place: int
    of: int
    score: float
    mts: float
    failed: bool
    survives: bool


@dataclass(frozen=True)
class Member:
    """One candidate in its place in the tree of an iteration.

    Attributes:
        row: its row of the candidates table.
        depth: how many of its ancestors are in the same iteration.
        stops: the rungs that it was ranked in, in their order.
        won: whether it won the iteration.
        end: how its way ended, in words.
        parents: their places on the page; they are of this iteration or of an earlier one.
    """

    row: Row
    depth: int
    stops: Sequence[Stop]
    won: bool
    end: str
    parents: Sequence[str]

    @property
    def kind(self) -> str:
        """How its way ended, in one of `ENDS`."""
        if self.won:
            return "won"
        last = self.stops[-1] if self.stops else None
        if last is None or last.failed or self.row["failure"]:
            return "failed"
        return "stayed" if last.survives else "dropped"

    @property
    def anchor(self) -> str:
        """Its place on the page; a candidate may be in several iterations."""
        return anchor(self.row)

    def stop(self, rung: str) -> Stop | None:
        """Returns where it stood at the end of a rung; None where it was not ranked."""
        return next((stop for stop in self.stops if stop.rung == rung), None)


def anchor(row: Row) -> str:
    """Returns the place of a candidate on the page."""
    return f"{row['iteration']}-{row['candidate_id']}"


def members(run: Run, iteration: int, winner_id: str, rungs: Sequence[str]) -> list[Member]:
    """Returns the candidates of an iteration, each after its parent, those without one in the order of their slots.

    Args:
        run: all rows.
        iteration: which, from 1.
        winner_id: who won it.
        rungs: the rungs in their order.
    """
    rows = sorted((row for row in run.candidates if row["iteration"] == iteration), key=lambda row: row["slot"])
    found = []
    for row, depth in _tree(rows):
        stops = _stops(run, row, rungs)
        won = row["candidate_id"] == winner_id
        above = [anchor(parent) for parent in parents(run, row)]
        found.append(Member(row, depth, stops, won, _end(run, row, stops, won), above))
    return found


def parents(run: Run, row: Row) -> list[Row]:
    """Returns the parents of a candidate: of the same iteration, else of the latest one before it that has such an id."""
    found = []
    for name in filter(None, row["parent_id"].split("+")):
        known = [
            other
            for other in run.candidates
            if other["candidate_id"] == name
            and other["iteration"] <= row["iteration"]
            and (other["iteration"], name) != (row["iteration"], row["candidate_id"])
        ]
        found += sorted(known, key=lambda other: other["iteration"])[-1:]
    return found


def _tree(rows: Sequence[Row]) -> Iterator[tuple[Row, int]]:
    """Yields rows depth first, with their depth; every row once, also where parents go round in a circle."""
    names = {row["candidate_id"] for row in rows}
    above = {row["candidate_id"]: _parent_here(row, names) for row in rows}
    seen: set[str] = set()

    def below(row: Row, depth: int) -> Iterator[tuple[Row, int]]:
        if row["candidate_id"] in seen:
            return
        seen.add(row["candidate_id"])
        yield row, depth
        for other in rows:
            if above[other["candidate_id"]] == row["candidate_id"]:
                yield from below(other, depth + 1)

    for row in [*(row for row in rows if not above[row["candidate_id"]]), *rows]:
        yield from below(row, 0)


def _parent_here(row: Row, names: set[str]) -> str:
    """Returns the first parent among the candidates of the same iteration; empty where there is none."""
    return next((name for name in row["parent_id"].split("+") if name in names - {row["candidate_id"]}), "")


def _stops(run: Run, row: Row, rungs: Sequence[str]) -> list[Stop]:
    here = [score for score in run.scores if score["iteration"] == row["iteration"]]
    return [
        Stop(
            rung,
            score["rank"] + 1,
            sum(other["rung"] == rung for other in here),
            score["score"],
            score["mts"],
            score["failed"],
            score["survives"],
        )
        for rung in rungs
        for score in here
        if score["rung"] == rung and score["candidate_id"] == row["candidate_id"]
    ]


def _end(run: Run, row: Row, stops: Sequence[Stop], won: bool) -> str:
    if won:
        return "won the iteration"
    if not stops:
        return f"failed before it was ranked: {row['failure']}" if row["failure"] else "never ranked"
    last = stops[-1]
    if row["failure"]:
        return f"failed in rung {last.rung}: {row['failure']}"
    if last.failed:
        return f"failed in rung {last.rung}: {_unsaid(run, row)}"
    if last.survives:
        return f"went on to the end, ranked {last.place} of {last.of} there"
    return f"eliminated after rung {last.rung}, ranked {last.place} of {last.of} with score {last.score:.3f}"


def _unsaid(run: Run, row: Row) -> str:
    """Returns why a candidate failed whose training ended as it should."""
    fitness = [
        point["value"]
        for point in run.curves
        if (point["iteration"], point["candidate_id"], point["series"])
        == (row["iteration"], row["candidate_id"], "fitness")
    ]
    if not fitness or not all(map(math.isfinite, fitness)):
        return "its fitness was not a finite number"
    return "another probe of the same candidate was better"
