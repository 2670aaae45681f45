"""Step fuse: the winner becomes theta_best, and all that the next iteration starts from is written."""

import shutil
from pathlib import Path

from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.config import Params
from porse.pool import BEST, RANDOM, START_POLICY, Pool, policy_file, read_pool
from porse.search.breeding import Population, bred
from porse.search.fusion import fuse as fused_policy
from porse.search.incumbent import incumbent
from porse.search.schedule import find_iteration


def fuse(params: Params, iteration: int, start: Path, pool: Path, out: Path) -> str:
    """Writes theta_best, theta_random and theta_f of the next iteration, the winner, its score, the feedback and the islands to `out`.

    Args:
        params: the run's parameters.
        iteration: which iteration, from 1.
        start: the folder that the iteration started from.
        pool: the folder of the pool that holds the winner.
        out: the folder to write, which the next iteration starts from.

    Returns:
        What to say about it.
    """
    last = read_pool(pool)
    if not last.candidates:
        shutil.copytree(start, out, dirs_exist_ok=True, copy_function=shutil.copyfile)
        return f"iteration {iteration}: no candidates, handed on as it started"
    said = _hand_on_winner(params, iteration, start, last, out)
    _hand_on_population(params, iteration, start, last, out)
    return said


def _hand_on_winner(params: Params, iteration: int, start: Path, last: Pool, out: Path) -> str:
    """Writes the winner, the feedback on it, and the policies; returns what to say about it."""
    # Imported here: an iteration without candidates needs no torch.
    from porse.training.start import random_policy

    earlier = tables.read(start / "winner.parquet", tables.CANDIDATES)
    score = tables.read(start / "score.parquet", tables.SURVIVORS)
    feedback = tables.read(start / "feedback.parquet", tables.FEEDBACK)
    chosen = incumbent(last.candidates, last.curves, earlier, score, feedback, params)
    best = read_checkpoint(last.policy(chosen.row) if chosen.is_new else policy_file(start, BEST)).policy()
    random = random_policy(params, find_iteration(params.iterations, iteration).next)
    fused = random
    if params.fuse.policy == "fused":
        fused = policy_checkpoint(fused_policy(best, random.policy(), params.candidate.alpha))
    for stem, policy in ((BEST, policy_checkpoint(best)), (RANDOM, random), (START_POLICY, fused)):
        write_checkpoint(policy_file(out, stem), policy)
    tables.write(out / "winner.parquet", tables.CANDIDATES, [chosen.row])
    tables.write(out / "score.parquet", tables.SURVIVORS, [chosen.score])
    tables.write(out / "feedback.parquet", tables.FEEDBACK, chosen.feedback)
    row, verb = chosen.row, "wins" if chosen.is_new else "stays"
    return f"iteration {iteration}: {row['candidate_id']} {verb} with beta = {row['beta']:g}, alpha = {row['alpha']:g}"


def _hand_on_population(params: Params, iteration: int, start: Path, last: Pool, out: Path) -> None:
    """Writes the islands."""
    before = Population(
        tables.read(start / "members.parquet", tables.MEMBERS),
        tables.read(start / "member_feedback.parquet", tables.MEMBER_FEEDBACK),
    )
    after = bred(before, last.candidates, last.curves, params, iteration)
    tables.write(out / "members.parquet", tables.MEMBERS, after.members)
    tables.write(out / "member_feedback.parquet", tables.MEMBER_FEEDBACK, after.feedback)
