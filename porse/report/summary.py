"""A run as a whole: its tables over all iterations, its metrics, and the files that `dvc plots` draws."""

import csv
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse import tables
from porse.config import Params
from porse.pool import CANDIDATES_FILE, CURVES_FILE
from porse.search.schedule import total_epochs
from porse.tables import Row, Table


@dataclass(frozen=True)
class Run:
    """All rows of a run, over its iterations."""

    replies: list[Row]
    verdicts: list[Row]
    candidates: list[Row]
    curves: list[Row]
    scores: list[Row]
    survivors: list[Row]
    mutants: list[Row]
    winners: list[Row]


def read_run(folder: Path, params: Params) -> Run:
    """Returns all rows of the run in `folder`.

    Raises:
        TableError: a table is missing or is not as declared.
    """
    run = Run([], [], [], [], [], [], [], [])
    for entry in params.iterations:
        here = folder / str(entry.n)
        for stage in ("validate-code", "mutate"):
            run.replies.extend(tables.read(here / stage / "replies.parquet", tables.REPLIES))
        run.verdicts.extend(tables.read(here / "validate-code" / "verdicts.parquet", tables.VERDICTS))
        run.mutants.extend(tables.read(here / "mutate" / "mutants.parquet", tables.MUTANTS))
        trained: dict[str, Row] = {}
        for rung in params.rungs:
            pool, kept = here / f"train-{rung.rung}", here / f"eliminate-{rung.rung}"
            trained |= {row["candidate_id"]: row for row in tables.read(pool / CANDIDATES_FILE, tables.CANDIDATES)}
            # A pool carries the curves of earlier rungs along; each row counts where it was made.
            curves = tables.read(pool / CURVES_FILE, tables.CURVES)
            run.curves.extend(row for row in curves if row["rung"] == str(rung.rung))
            run.scores.extend(tables.read(kept / "scores.parquet", tables.SCORES))
            run.survivors.extend(tables.read(kept / "survivors.parquet", tables.SURVIVORS))
        run.candidates.extend(trained.values())
        run.winners.extend(tables.read(folder / str(entry.next) / "start" / "winner.parquet", tables.CANDIDATES))
    return run


def iteration_rows(run: Run, params: Params) -> list[Row]:
    """Returns one row of the iterations table for each iteration."""
    return [_iteration_row(run, winner, params) for winner in run.winners]


def _iteration_row(run: Run, winner: Row, params: Params) -> Row:
    n = winner["iteration"]
    fitness = [row for row in run.curves if row["iteration"] == n and row["series"] == "fitness"]
    own = [row["value"] for row in fitness if row["candidate_id"] == winner["candidate_id"]]
    last = [row for row in run.scores if row["iteration"] == n and row["candidate_id"] == winner["candidate_id"]]
    final = next(row for row in last if row["rung"] == str(params.rungs[-1].rung))
    verdicts = [row for row in run.verdicts if row["iteration"] == n]
    return {
        "iteration": n,
        "winner_id": winner["candidate_id"],
        "beta": winner["beta"],
        "alpha": winner["alpha"],
        "mts": max(row["value"] for row in fitness),
        "winner_mts": max(own),
        "fitness": final["fitness"],
        "epochs": len(fitness),
        "environment_steps": len(fitness) * params.train.num_envs * params.train.steps_per_epoch,
        "replies": len(verdicts),
        "valid_replies": sum(row["passed"] for row in verdicts),
        "repairs": sum(row["attempt"] > 0 for row in verdicts),
    }


def metrics(run: Run, iterations: Sequence[Row], params: Params) -> dict[str, Any]:
    """Returns the run's metrics, for `dvc metrics diff`."""
    last = iterations[-1]
    replies, valid = (sum(row[name] for row in iterations) for name in ("replies", "valid_replies"))
    return {
        "mts": max(row["mts"] for row in iterations),
        "final_fitness": last["fitness"],
        "epochs_spent": sum(row["epochs"] for row in iterations),
        "epochs_allowed": total_epochs(params),
        "environment_steps": sum(row["environment_steps"] for row in iterations),
        "failed_candidates": sum(bool(row["failure"]) for row in run.candidates),
        "replies": {
            "functions": replies,
            "valid": valid,
            "valid_share": valid / replies,
            "all": len(run.replies),
            "prompt_tokens": sum(row["prompt_tokens"] for row in run.replies),
            "completion_tokens": sum(row["completion_tokens"] for row in run.replies),
            "recorded_usd": math.fsum(row["recorded_usd"] for row in run.replies),
        },
        "by_iteration": {
            str(row["iteration"]): {name: row[name] for name in ("mts", "fitness", "beta", "alpha")}
            for row in iterations
        },
    }


def write_summary(run: Run, params: Params, results: Path, metrics_file: Path, plots: Path) -> list[Row]:
    """Writes the tables, the metrics and the plots' data; returns the rows of the iterations table."""
    iterations = iteration_rows(run, params)
    written: dict[Table, list[Row]] = {
        tables.REPLIES: run.replies,
        tables.VERDICTS: run.verdicts,
        tables.CANDIDATES: run.candidates,
        tables.CURVES: run.curves,
        tables.SCORES: run.scores,
        tables.SURVIVORS: run.survivors,
        tables.MUTANTS: run.mutants,
        tables.ITERATIONS: iterations,
    }
    for table, rows in written.items():
        tables.write(results / f"{table.name}.parquet", table, rows)
    text = json.dumps(metrics(run, iterations, params), indent=2, sort_keys=True)
    metrics_file.write_text(f"{text}\n", encoding="utf-8")
    _write_csv(plots / "fitness.csv", ("epoch", "fitness", "candidate"), lineage_rows(run))
    shown = ("iteration", "mts", "winner_mts", "fitness", "beta", "alpha")
    _write_csv(plots / "iterations.csv", shown, ([row[name] for name in shown] for row in iterations))
    return iterations


def lineage_rows(run: Run) -> Iterable[list[Any]]:
    """Yields (epoch counted over all iterations, fitness, candidate) along the chain of winners."""
    done = 0
    for winner in run.winners:
        rows = [
            row
            for row in run.curves
            if row["iteration"] == winner["iteration"]
            and row["candidate_id"] == winner["candidate_id"]
            and row["series"] == "fitness"
        ]
        for row in sorted(rows, key=lambda row: row["epoch"]):
            yield [done + row["epoch"], row["value"], winner["candidate_id"]]
        done += max(row["epoch"] for row in rows)


def _write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
