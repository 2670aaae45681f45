"""The mutants of an iteration: the model's values for the best survivor, and the policies that they start from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.config import Params
from porse.generation.about import about
from porse.generation.values import Proposal, alpha_question, beta_question, propose
from porse.llm.request import Reply
from porse.pool import START_POLICY, Pool, policy_file
from porse.search.elimination import ranked_pool
from porse.search.feedback import STAGED, WEIGHED, series_of, shown_series
from porse.search.fusion import fuse
from porse.search.mutation import mutant, swarm_seed, swarm_step
from porse.search.schedule import ALPHA, BETA, DRAW, mutants, varied
from porse.tables import Row
from porse.tasks import find_task


@dataclass(frozen=True)
class Swarm:
    """The mutants of one iteration.

    Attributes:
        mutants: rows of the candidates table, equal ones once, none equal to a candidate of the pool.
        rows: rows of the mutants table, one for each of `mutants`.
        replies: the replies that were asked for; the last one proposed the values.
    """

    mutants: list[Row]
    rows: list[Row]
    replies: list[Reply]

    @staticmethod
    def propose(pool: Pool, start: Path, params: Params, iteration: int, prompts: Path, cache: Path) -> "Swarm":
        """Returns the mutants of the pool's best survivor; none, and no question, where the schedule has none.

        Raises:
            SearchError: no reply held usable values.
        """
        if not pool.candidates or not mutants(params, iteration):
            return Swarm([], [], [])
        kind = varied(params, iteration)
        scores = ranked_pool(pool.candidates, pool.curves, params.eliminate)
        best = next(row for row in pool.candidates if row["candidate_id"] == scores[0].candidate_id)
        if kind == DRAW:
            draws = [float(number) for number in range(1, params.mutate.mutants + 1)]
            return _collect(pool, best, kind, draws, draws, params, [])
        proposal = _proposal(pool, best, kind, start, params, iteration, prompts, cache)
        memory = _memory(start, kind, best[kind])
        bounds = (0.0, params.candidate.scale) if kind == BETA else (0.0, 1.0)
        values = swarm_step(
            proposal.values, best[kind], memory, bounds, params.mutate, swarm_seed(params.seed, iteration)
        )
        return _collect(pool, best, kind, proposal.values, values, params, proposal.replies)


def write_starts(mutants: Sequence[Row], start: Path, target: Callable[[str], Path]) -> None:
    """Writes the policy that each mutant starts from: theta_f, or its own fusion where alpha was varied.

    Args:
        mutants: rows of the candidates table.
        start: the folder that the iteration started from, with theta_best and theta_random.
        target: stem -> file to write.
    """
    for row in mutants:
        if row["policy"] == START_POLICY:
            write_checkpoint(target(START_POLICY), read_checkpoint(policy_file(start, START_POLICY)))
            continue
        best, random = (read_checkpoint(policy_file(start, stem)).policy() for stem in ("best", "random"))
        write_checkpoint(target(row["policy"]), policy_checkpoint(fuse(best, random, row["alpha"])))


def _proposal(
    pool: Pool, best: Row, kind: str, start: Path, params: Params, iteration: int, prompts: Path, cache: Path
) -> Proposal:
    """Returns the model's values: betas by the record of the best survivor, alphas by that of the previous winner."""
    facts = about(find_task(params.task))
    if kind == BETA:
        record = shown_series(pool.curves, best["candidate_id"], WEIGHED)
        messages = beta_question(best, record, facts, params, prompts)
    else:
        # How much of the previous winner is kept follows from how its own stage went.
        record = series_of(tables.read(start / "feedback.parquet", tables.FEEDBACK), STAGED)
        messages = alpha_question(best, record, facts, params, prompts)
    return propose(messages, kind, params, iteration, cache)


def _collect(
    pool: Pool,
    best: Row,
    kind: str,
    proposed: Sequence[float],
    values: Sequence[float],
    params: Params,
    replies: list[Reply],
) -> Swarm:
    taken = {row["candidate_id"] for row in pool.candidates}
    mutants: list[Row] = []
    rows: list[Row] = []
    for index, (proposal, value) in enumerate(zip(proposed, values, strict=True)):
        policy = f"{ALPHA}-{value:.6f}" if kind == ALPHA else START_POLICY
        row = mutant(params.task, best, kind, value, params.generate.candidates + index, policy)
        if row["candidate_id"] in taken:
            continue
        taken.add(row["candidate_id"])
        mutants.append(row)
        rows.append(
            {
                "iteration": best["iteration"],
                "index": index,
                "candidate_id": row["candidate_id"],
                "parent_id": best["candidate_id"],
                "varied": kind,
                "proposed": proposal,
                "value": value,
            }
        )
    return Swarm(mutants, rows, replies)


def _memory(start: Path, kind: str, survivor: float) -> float:
    """Returns the value of the previous winner, or the survivor's own where there is none."""
    winners = tables.read(start / "winner.parquet", tables.CANDIDATES)
    return winners[0][kind] if winners else survivor
