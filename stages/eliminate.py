"""Stage eliminate: ranks a trained pool and keeps the best."""

from pathlib import Path

import click

from porse import tables
from porse.pool import read_pool, write_pool
from porse.search.elimination import how_many_go_on, ranked_pool, score_rows, survivor_rows, survivors
from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@click.option("--rung", required=True)
@click.option(
    "--keep", required=True, type=click.IntRange(min=1), help="How many go on where eliminate.keep is `rungs`."
)
@folder("trained")
@folder("out")
def main(iteration: int, rung: str, keep: int, trained: Path, out: Path) -> None:
    """Writes the scores, the survivors, and the pool of the survivors."""
    params = begin()
    pool = read_pool(trained)
    ranked = ranked_pool(pool.candidates, pool.curves, params.eliminate.window)
    going = how_many_go_on(params, keep, len(ranked))
    kept = survivors(ranked, going, f"iteration {iteration}, rung {rung}")
    names = {entry.candidate_id for entry in kept}
    tables.write(out / "scores.parquet", tables.SCORES, score_rows(ranked, names, iteration, rung))
    tables.write(out / "survivors.parquet", tables.SURVIVORS, survivor_rows(kept, iteration, rung))
    rows = [row for row in pool.candidates if row["candidate_id"] in names]
    write_pool(out, rows, pool.curves, {row["policy"]: pool.policy(row) for row in rows})
    best = f", best {kept[0].candidate_id} with fitness {kept[0].fitness:.3f}" if kept else ""
    say(f"iteration {iteration} rung {rung}: {len(kept)} of {len(ranked)} survive{best}")


if __name__ == "__main__":
    run_stage(main)
