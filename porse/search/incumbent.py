"""The candidate that the next iteration goes on from: the iteration's winner, or an earlier one that is still better (ROSKA)."""

from collections.abc import Sequence
from dataclasses import dataclass

from porse.config import Params
from porse.search.elimination import ranked_pool, survivor_rows
from porse.search.feedback import feedback_rows
from porse.tables import Row


@dataclass(frozen=True)
class Incumbent:
    """The candidate that the next iteration goes on from.

    Attributes:
        row: its row of the candidates table.
        score: its row of the survivors table, with the score that it won its iteration with.
        feedback: rows of the feedback table on it.
        is_new: whether it won this iteration.
    """

    row: Row
    score: Row
    feedback: list[Row]
    is_new: bool


def winner(candidates: Sequence[Row], curves: Sequence[Row], params: Params) -> tuple[Row, Row]:
    """Returns the best candidate of an iteration's last pool: its row of the candidates table, and of the survivors table."""
    best = ranked_pool(candidates, curves, params.eliminate)[:1]
    row = next(row for row in candidates if row["candidate_id"] == best[0].candidate_id)
    return row, survivor_rows(best, row["iteration"], params.fuse.pool.removeprefix("eliminate-"))[0]


def incumbent(
    candidates: Sequence[Row],
    curves: Sequence[Row],
    earlier: Sequence[Row],
    earlier_score: Sequence[Row],
    earlier_feedback: Sequence[Row],
    params: Params,
) -> Incumbent:
    """Returns the candidate that the next iteration goes on from.

    Args:
        candidates: the iteration's last pool, at least one.
        curves: its series.
        earlier: the row of the candidate that this iteration went on from; none in the first.
        earlier_score: the row of the survivors table of that one.
        earlier_feedback: rows of the feedback on that one.
        params: the run's parameters; fuse.incumbent `best` keeps the earlier one unless its score is exceeded.
    """
    new, score = winner(candidates, curves, params)
    if params.fuse.incumbent == "best" and earlier and score["score"] <= earlier_score[0]["score"]:
        return Incumbent(earlier[0], earlier_score[0], list(earlier_feedback), is_new=False)
    return Incumbent(new, score, feedback_rows(curves, new["candidate_id"], params.fuse.points), is_new=True)


def feedback_mts(feedback: Sequence[Row]) -> float:
    """Returns the highest fitness of the training that rows of the feedback table are about."""
    return next(row["maximum"] for row in feedback if row["series"] == "fitness")
