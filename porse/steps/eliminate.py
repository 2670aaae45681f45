"""Step eliminate: ranks a trained pool and keeps the best."""

from pathlib import Path

from porse import tables
from porse.config import Params
from porse.pool import read_pool, write_pool
from porse.search.elimination import how_many_go_on, ranked_pool, score_rows, survivor_rows, survivors


def eliminate(params: Params, iteration: int, rung: str, keep: int, trained: Path, out: Path) -> str:
    """Writes the scores, the survivors, and the pool of the survivors to `out`; returns what to say about it.

    Args:
        params: the run's parameters.
        iteration: which iteration, from 1.
        rung: the rung's name.
        keep: how many go on where eliminate.keep is `rungs`.
        trained: the folder of the trained pool.
        out: the folder to write.

    Raises:
        SearchError: every candidate failed.
    """
    pool = read_pool(trained)
    ranked = ranked_pool(pool.candidates, pool.curves, params.eliminate)
    going = how_many_go_on(params, keep, len(ranked))
    kept = survivors(ranked, going, f"iteration {iteration}, rung {rung}")
    names = {entry.candidate_id for entry in kept}
    tables.write(out / "scores.parquet", tables.SCORES, score_rows(ranked, names, iteration, rung))
    tables.write(out / "survivors.parquet", tables.SURVIVORS, survivor_rows(kept, iteration, rung))
    rows = [row for row in pool.candidates if row["candidate_id"] in names]
    write_pool(out, rows, pool.curves, {row["policy"]: pool.policy(row) for row in rows})
    best = f", best {kept[0].candidate_id} with score {kept[0].value:.3f}" if kept else ""
    return f"iteration {iteration} rung {rung}: {len(kept)} of {len(ranked)} survive{best}"
