"""One rung: a pool goes in, and the same pool comes out, every candidate trained to the rung's last epoch."""

from collections.abc import Sequence
from pathlib import Path

from porse.config import Params
from porse.identity import seed_for
from porse.pool import Pool, policy_file, write_pool
from porse.tables import Row
from porse.training.bar import RungBar
from porse.training.job import Job, Outcome
from porse.training.population import train_pool


def train_rung(pool: Pool, params: Params, iteration: int, rung: str, until: int, out: Path) -> None:
    """Trains the pool to epoch `until` and writes it to `out`.

    A candidate that is as old as the rung already, or that failed before, stays as it is. One that fails now keeps the
    policy that it started the rung from, and its row says why it failed.
    """
    going = [row for row in pool.candidates if row["epochs"] < until and not row["failure"]]
    # Candidates of one iteration share their draws, so that they differ by their functions and weights alone.
    seed = seed_for(params.seed, "training", iteration)
    jobs = [_job(row, pool, until, seed, out) for row in going]
    steps = params.train.num_envs * params.train.steps_per_epoch
    lengths = {row["candidate_id"]: until - row["epochs"] for row in going}
    with RungBar(f"iteration {iteration} rung {rung}", lengths, steps) as bar:
        outcomes = train_pool(jobs, params, bar.advance)
    results = {row["candidate_id"]: outcome for row, outcome in zip(going, outcomes, strict=True)}
    candidates = [_after(row, results.get(row["candidate_id"]), until) for row in pool.candidates]
    curves = [*pool.curves, *_curve_rows(results, iteration, rung)]
    kept = {row["policy"]: pool.policy(row) for row in candidates if not policy_file(out, row["policy"]).exists()}
    write_pool(out, candidates, curves, kept)


def _job(row: Row, pool: Pool, until: int, seed: int, out: Path) -> Job:
    return Job(
        name=row["candidate_id"],
        reward_source=row["reward_source"],
        mapping_source=row["mapping_source"],
        beta=row["beta"],
        start=pool.policy(row),
        finish=policy_file(out, row["candidate_id"]),
        until=until,
        seed=seed,
    )


def _after(row: Row, outcome: Outcome | None, until: int) -> Row:
    """Returns a candidate's row after the rung; `outcome` is None where it was not trained."""
    if outcome is None:
        return row
    if outcome.failure:
        return {**row, "failure": outcome.failure}
    return {**row, "epochs": until, "policy": row["candidate_id"]}


def _curve_rows(results: dict[str, Outcome], iteration: int, rung: str) -> Sequence[Row]:
    return [
        {
            "iteration": iteration,
            "rung": rung,
            "candidate_id": name,
            "series": series,
            "epoch": epoch,
            "value": value,
        }
        for name, outcome in results.items()
        for epoch, series, value in outcome.rows
    ]
