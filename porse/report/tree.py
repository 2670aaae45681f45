"""The population of a run as a tree: from which rung to which each candidate lived, whom it came from, how it ended.

Places are numbers in units of a drawing; the macro `tree` of `pages/charts.jinja` draws them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from porse.report.charts import Tick
from porse.report.population import Member

COLUMN, ROW = 20, 15
"""Width of a rung and height of a candidate."""
HEAD, WORDS = 32, 190
"""Height of the words above, and width of those beside a line's end."""


@dataclass(frozen=True)
class Branch:
    """The line of one candidate.

    Attributes:
        member: whose it is.
        start, stop: where its first rung begins and its last one ends.
        at: how far down it is.
    """

    member: Member
    start: int
    stop: int
    at: int


@dataclass(frozen=True)
class Fork:
    """Where a candidate leaves its parent.

    Attributes:
        stop: where the parent's line ends, if that is before.
        at: where the candidate's begins.
        parent, child: how far down the two are.
    """

    stop: int
    at: int
    parent: int
    child: int


@dataclass(frozen=True)
class Tree:
    """The whole drawing: its size, the borders of iterations with their words, the rungs' names, the branches, the forks."""

    width: int
    height: int
    borders: Sequence[Tick]
    rungs: Sequence[Tick]
    branches: Sequence[Branch]
    forks: Sequence[Fork]


def tree(populations: Sequence[Sequence[Member]], rungs: Sequence[str]) -> Tree:
    """Returns the tree of a run.

    Args:
        populations: the members of each iteration, as `members` orders them.
        rungs: the rungs of an iteration, in their order.
    """
    branches: list[Branch] = []
    for number, population in enumerate(populations):
        for member in population:
            places = [rungs.index(stop.rung) for stop in member.stops] or [0]
            first, last = number * len(rungs) + min(places), number * len(rungs) + max(places) + 1
            branches.append(Branch(member, COLUMN * first, COLUMN * last, HEAD + ROW * len(branches) + ROW // 2))
    known = {branch.member.anchor: branch for branch in branches}
    forks = [
        Fork(min(branch.start, known[parent].stop), branch.start, known[parent].at, branch.at)
        for branch in branches
        for parent in branch.member.parents
        if parent in known
    ]
    span = COLUMN * len(rungs)
    return Tree(
        span * len(populations) + WORDS,
        HEAD + ROW * len(branches) + ROW,
        [
            Tick(span * number, f"iteration {population[0].row['iteration']}")
            for number, population in enumerate(populations)
            if population
        ],
        [
            # A column is narrow: numbers stand as they are, a word as its first letter.
            Tick(span * number + COLUMN * place + COLUMN / 2, rung if len(rung) < 3 else rung[:1])
            for number in range(len(populations))
            for place, rung in enumerate(rungs)
        ],
        branches,
        forks,
    )
