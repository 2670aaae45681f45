"""Stage fuse: the winner becomes theta_best, and all that the next iteration starts from is written."""

import shutil
from pathlib import Path

import click

from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.config import Params
from porse.pool import BEST, RANDOM, START_POLICY, Pool, policy_file, read_pool
from porse.search.breeding import Population, bred
from porse.search.fusion import fuse
from porse.search.incumbent import incumbent
from porse.search.schedule import find_iteration
from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@folder("start")
@folder("pool")
@folder("out")
def main(iteration: int, start: Path, pool: Path, out: Path) -> None:
    """Writes theta_best, theta_random and theta_f of the next iteration, the winner, the feedback and the islands."""
    params = begin()
    last = read_pool(pool)
    if not last.candidates:
        shutil.copytree(start, out, dirs_exist_ok=True, copy_function=shutil.copyfile)
        say(f"iteration {iteration}: no candidates, handed on as it started")
        return
    hand_on_winner(params, iteration, start, last, out)
    hand_on_population(params, iteration, start, last, out)


def hand_on_winner(params: Params, iteration: int, start: Path, last: Pool, out: Path) -> None:
    """Writes the winner, the feedback on it, and the policies."""
    from porse.training.start import random_policy

    earlier = tables.read(start / "winner.parquet", tables.CANDIDATES)
    chosen = incumbent(
        last.candidates, last.curves, earlier, tables.read(start / "feedback.parquet", tables.FEEDBACK), params
    )
    best = read_checkpoint(last.policy(chosen.row) if chosen.is_new else policy_file(start, BEST)).policy()
    random = random_policy(params, find_iteration(params.iterations, iteration).next)
    fused = random
    if params.fuse.policy == "fused":
        fused = policy_checkpoint(fuse(best, random.policy(), params.candidate.alpha))
    for stem, policy in ((BEST, policy_checkpoint(best)), (RANDOM, random), (START_POLICY, fused)):
        write_checkpoint(policy_file(out, stem), policy)
    tables.write(out / "winner.parquet", tables.CANDIDATES, [chosen.row])
    tables.write(out / "feedback.parquet", tables.FEEDBACK, chosen.feedback)
    row, verb = chosen.row, "wins" if chosen.is_new else "stays"
    say(f"iteration {iteration}: {row['candidate_id']} {verb} with beta = {row['beta']:g}, alpha = {row['alpha']:g}")


def hand_on_population(params: Params, iteration: int, start: Path, last: Pool, out: Path) -> None:
    """Writes the islands."""
    before = Population(
        tables.read(start / "members.parquet", tables.MEMBERS),
        tables.read(start / "member_feedback.parquet", tables.MEMBER_FEEDBACK),
    )
    after = bred(before, last.candidates, last.curves, params, iteration)
    tables.write(out / "members.parquet", tables.MEMBERS, after.members)
    tables.write(out / "member_feedback.parquet", tables.MEMBER_FEEDBACK, after.feedback)


if __name__ == "__main__":
    run_stage(main)
