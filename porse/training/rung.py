"""One rung: a pool goes in, and the same pool comes out, every candidate trained to the rung's last epoch."""

from collections.abc import Mapping, Sequence
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
    # The longest first: a short one fills what is left at the end.
    going.sort(key=lambda row: row["epochs"])
    epochs = sum(until - row["epochs"] for row in going)
    with rung_bar(params, f"iteration {iteration} rung {rung}", len(going), epochs) as bar:
        jobs = [job_for(row, pool.policy(row), until, params, out) for row in going]
        outcomes = train_pool(jobs, params, bar.tell)
    results = {row["candidate_id"]: outcome for row, outcome in zip(going, outcomes, strict=True)}
    candidates = [row_after(row, results.get(row["candidate_id"]), until) for row in pool.candidates]
    write_trained(pool, candidates, curve_rows(results, iteration, rung), out)


def rung_bar(params: Params, label: str, candidates: int, epochs: int) -> RungBar:
    """Returns the progress bar of trainings of so many candidates for so many epochs in all."""
    steps = params.train.num_envs * params.train.steps_per_epoch
    return RungBar(label, candidates, epochs, steps)


def job_for(row: Row, start: Path, until: int, params: Params, out: Path) -> Job:
    """Returns the training of a candidate from the file `start` to epoch `until`; its checkpoint goes to the pool `out`."""
    return Job(
        name=row["candidate_id"],
        reward_program=row["reward_program"],
        mapping_program=row["mapping_program"],
        beta=row["beta"],
        start=start,
        finish=policy_file(out, row["candidate_id"]),
        until=until,
        # Candidates of one iteration share their draws, so that they differ by their functions and weights alone; but for
        # those that differ by their draws.
        seed=seed_for(params.seed, "training", row["iteration"], *(("draw", row["draw"]) if row["draw"] else ())),
    )


def row_after(row: Row, outcome: Outcome | None, until: int) -> Row:
    """Returns a candidate's row after its training; `outcome` is None where it was not trained."""
    if outcome is None:
        return row
    if outcome.failure:
        return {**row, "failure": outcome.failure}
    return {**row, "epochs": until, "policy": row["candidate_id"]}


def curve_rows(results: Mapping[str, Outcome], iteration: int, rung: str) -> list[Row]:
    """Returns the rows of the curves table from outcomes by candidate id."""
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


def write_trained(pool: Pool, candidates: Sequence[Row], curves: Sequence[Row], out: Path) -> None:
    """Writes a trained pool: `curves` are those of this rung, and policies that were not trained on are copied."""
    kept = {row["policy"]: pool.policy(row) for row in candidates if not policy_file(out, row["policy"]).exists()}
    write_pool(out, candidates, [*pool.curves, *curves], kept)
