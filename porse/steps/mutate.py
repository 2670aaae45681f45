"""Step mutate: adds variants of the best survivor at half time, beta in odd iterations, alpha in even ones."""

from pathlib import Path

from porse import tables
from porse.config import Params
from porse.generation.functions import reply_row
from porse.generation.mutants import Swarm, write_starts
from porse.pool import policy_file, read_pool, write_pool
from porse.search.schedule import varied


def mutate(params: Params, iteration: int, pool: Path, start: Path, prompts: Path, cache: Path, out: Path) -> str:
    """Writes the mutants, the replies that proposed them, and the pool of survivors and mutants to `out`.

    Args:
        params: the run's parameters.
        iteration: which iteration, from 1.
        pool: the folder of the pool at half time.
        start: the folder that the iteration starts from.
        prompts: the folder of the prompts' templates.
        cache: the folder of recorded replies.
        out: the folder to write.

    Returns:
        What to say about it.

    Raises:
        CacheError: a reply is not recorded, or its record cannot be trusted.
        RepliesPending: in batch mode, the question waits for an answer.
    """
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
    return f"iteration {iteration}: {len(swarm.mutants)} mutants{values}"
