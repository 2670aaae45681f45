"""Stage fuse: the winner becomes theta_best, and all that the next iteration starts from is written."""

from pathlib import Path

import click

from porse import tables
from porse.checkpoint import policy_checkpoint, read_checkpoint, write_checkpoint
from porse.pool import policy_file, read_pool
from porse.search.feedback import feedback_rows
from porse.search.fusion import fuse
from porse.search.schedule import find_iteration
from porse.stage import StageCommand, begin, folder, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@folder("pool")
@folder("out")
def main(iteration: int, pool: Path, out: Path) -> None:
    """Writes theta_best, theta_random and theta_f of the next iteration, the winner and the feedback on it."""
    params = begin()
    from porse.training.start import random_policy

    last = read_pool(pool)
    [winner] = last.candidates
    best = read_checkpoint(last.policy(winner)).policy()
    random = random_policy(params, find_iteration(params.iterations, iteration).next)
    write_checkpoint(policy_file(out, "best"), policy_checkpoint(best))
    write_checkpoint(policy_file(out, "random"), random)
    write_checkpoint(policy_file(out, "fused"), policy_checkpoint(fuse(best, random.policy(), params.candidate.alpha)))
    tables.write(out / "winner.parquet", tables.CANDIDATES, [winner])
    tables.write(
        out / "feedback.parquet",
        tables.FEEDBACK,
        feedback_rows(last.curves, winner["candidate_id"], params.fuse.points),
    )
    say(
        f"iteration {iteration}: {winner['candidate_id']} wins with beta = {winner['beta']:g}, alpha = {winner['alpha']:g}"
    )


if __name__ == "__main__":
    main()
