"""Who goes on: candidates ranked by one declared score, ties by MTS, then by candidate id."""

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

from porse.config import EliminateParams, Params
from porse.errors import SearchError
from porse.tables import Row


@dataclass(frozen=True)
class Score:
    """A candidate's score.

    Attributes:
        candidate_id: whose.
        value: what ranks it, see `score_of`.
        mts: highest fitness so far.
        failed: whether its training ended early, or another probe took its place, or its fitness is not a number; it ranks
            behind all others.
    """

    candidate_id: str
    value: float
    mts: float
    failed: bool


def score_of(fitness: Sequence[float], params: EliminateParams) -> float:
    """Returns the score of a training, the one number that ranks it wherever trainings are compared.

    ROSKA's probes and REvolve's members alone are compared by their highest fitness instead.

    Args:
        fitness: of its epochs, in their order; at least one.
        params: eliminate.score says which: the `mean` over the last eliminate.window epochs, or the `max` over all, its MTS.
    """
    last = fitness[-params.window :]
    return max(fitness) if params.score == "max" else math.fsum(last) / len(last)


def score(candidate: Row, curves: Sequence[Row], params: EliminateParams) -> Score:
    """Returns the score of one candidate from the fitness rows of `curves`."""
    name = candidate["candidate_id"]
    fitness = [
        row["value"]
        for row in sorted(curves, key=lambda row: row["epoch"])
        if row["candidate_id"] == name and row["series"] == "fitness"
    ]
    if candidate["failure"] or not fitness or not all(map(math.isfinite, fitness)):
        return Score(name, 0.0, 0.0, failed=True)
    return Score(name, score_of(fitness, params), max(fitness), failed=False)


def ranked_pool(candidates: Sequence[Row], curves: Sequence[Row], params: EliminateParams) -> list[Score]:
    """Returns the scores of a pool's candidates, best first.

    Candidates with fewer epochs than the oldest are probes that lost to another. They count as failed, and rank above those
    that really failed.
    """
    oldest = max((row["epochs"] for row in candidates), default=0)
    scores = rank([score(row, curves, params) for row in candidates])
    young = {row["candidate_id"] for row in candidates if row["epochs"] < oldest}
    alive = [entry for entry in scores if not entry.failed]
    beaten = [replace(entry, failed=True) for entry in alive if entry.candidate_id in young]
    failed = [entry for entry in scores if entry.failed]
    return [*(entry for entry in alive if entry.candidate_id not in young), *beaten, *failed]


def rank(scores: Sequence[Score]) -> list[Score]:
    """Returns the scores, best first. The order is total: values are finite, and no two candidates have one id."""
    return sorted(scores, key=lambda s: (s.failed, -s.value, -s.mts, s.candidate_id))


def how_many_go_on(params: Params, declared: int, pool: int) -> int:
    """Returns how many of a pool go on after a rung that declares `declared` of them."""
    return {"rungs": declared, "all": pool, "one": 1}[params.eliminate.keep]


def survivors(ranked: Sequence[Score], keep: int, where: str) -> list[Score]:
    """Returns the `keep` best that did not fail.

    Raises:
        SearchError: all of them failed; an empty pool is not a failure.
    """
    alive = [entry for entry in ranked if not entry.failed]
    if ranked and not alive:
        raise SearchError(
            f"expected a candidate whose training did not fail at {where}, found none among {len(ranked)}; read the column failure of the candidates table there, then change the prompts or the model"
        )
    return alive[:keep]


def score_rows(ranked: Sequence[Score], kept: Container[str], iteration: int, rung: str) -> list[Row]:
    """Returns the rows of the scores table for a ranked pool."""
    return [
        {
            "iteration": iteration,
            "rung": rung,
            "candidate_id": entry.candidate_id,
            "rank": position,
            "score": entry.value,
            "mts": entry.mts,
            "failed": entry.failed,
            "survives": entry.candidate_id in kept,
        }
        for position, entry in enumerate(ranked)
    ]


def survivor_rows(kept: Sequence[Score], iteration: int, rung: str) -> list[Row]:
    """Returns the rows of the survivors table."""
    return [
        {
            "iteration": iteration,
            "rung": rung,
            "rank": position,
            "candidate_id": entry.candidate_id,
            "score": entry.value,
        }
        for position, entry in enumerate(kept)
    ]
