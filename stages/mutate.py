"""Stage mutate: adds variants of the best survivor at half time, beta in odd iterations, alpha in even ones."""

from pathlib import Path

import click

from porse import tables
from porse.pool import policy_file, read_pool, write_pool
from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@folder("pool")
@folder("start")
@folder("prompts")
@folder("cache")
@folder("out")
def main(iteration: int, pool: Path, start: Path, prompts: Path, cache: Path, out: Path) -> None:
    """Writes the mutants, the replies that proposed them, and the pool of survivors and mutants."""
    params = begin()
    from porse.generation.functions import reply_row
    from porse.generation.mutants import Swarm, write_starts
    from porse.search.schedule import varied

    entering = read_pool(pool)
    swarm = Swarm.propose(entering, start, params, iteration, prompts, cache)
    kind = varied(params, iteration)
    replies = [reply_row(iteration, kind, 0, number, reply) for number, reply in enumerate(swarm.replies)]
    tables.write(out / "replies.parquet", tables.REPLIES, replies)
    tables.write(out / "mutants.parquet", tables.MUTANTS, swarm.rows)
    kept = {row["policy"]: entering.policy(row) for row in entering.candidates}
    write_pool(out, [*entering.candidates, *swarm.mutants], entering.curves, kept)
    write_starts(swarm.mutants, start, lambda stem: policy_file(out, stem))
    values = f", {kind} = {', '.join(f'{row[kind]:g}' for row in swarm.mutants)}" if swarm.mutants else ""
    say(f"iteration {iteration}: {len(swarm.mutants)} mutants{values}")


if __name__ == "__main__":
    run_stage(main)
