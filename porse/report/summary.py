"""A run's tables over all iterations, its metrics, and the files that `dvc plots` draws."""

import csv
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from porse import tables
from porse.config import Params
from porse.report.figures import lineage_fitness, method_label, run_figures
from porse.report.plots import bonus_rows, component_rows, spread_rows
from porse.report.run import Evaluation, Run
from porse.tables import Row, Table

_SHOWN = ("score", "mts", "hns_lineage", "success", "epochs_spent", "valid_share")
"""The figures that DVC shows: few, so that a line of them fits a terminal. `porse results --json` has all."""


def iteration_rows(run: Run, params: Params) -> list[Row]:
    """Returns one row of the iterations table for each iteration that had candidates."""
    last = [row for row in run.survivors if row["rung"] == str(params.rungs[-1].rung) and row["rank"] == 0]
    candidates = {(row["iteration"], row["candidate_id"]): row for row in run.candidates}
    return [_iteration_row(run, candidates[row["iteration"], row["candidate_id"]], row, params) for row in last]


def _iteration_row(run: Run, winner: Row, survivor: Row, params: Params) -> Row:
    n = survivor["iteration"]
    curves = [row for row in run.curves if row["iteration"] == n]
    fitness = [row for row in curves if row["series"] == "fitness"]
    own = [row["value"] for row in fitness if row["candidate_id"] == winner["candidate_id"]]
    found = [
        row["value"] for row in curves if (row["series"], row["candidate_id"]) == ("new_cells", winner["candidate_id"])
    ]
    first = str(params.rungs[0].rung)
    shares = [row["value"] for row in curves if row["series"] == "bonus_share" and row["rung"] == first]
    cells = {
        row["epoch"]: row["value"]
        for row in curves
        if row["series"] == "cells_visited" and row["candidate_id"] == winner["candidate_id"]
    }
    verdicts = [row for row in run.verdicts if row["iteration"] == n]
    return {
        "iteration": n,
        "winner_id": winner["candidate_id"],
        "beta": winner["beta"],
        "alpha": winner["alpha"],
        "mts": max(row["value"] for row in fitness),
        "winner_mts": max(own),
        "score": survivor["score"],
        "bonus_share": math.fsum(shares) / len(shares) if shares else 0.0,
        "cells_visited": cells[max(cells)] if cells else 0.0,
        "new_cells": math.fsum(found) / len(found) if found else 0.0,
        "epochs": len(fitness),
        "environment_steps": len(fitness) * params.train.num_envs * params.train.steps_per_epoch,
        "replies": len(verdicts),
        "valid_replies": sum(row["passed"] for row in verdicts),
        "repairs": sum(row["attempt"] > 0 for row in verdicts),
    }


def metrics(iterations: Sequence[Row], evaluation: Evaluation, params: Params) -> dict[str, Any]:
    """Returns the run's metrics, which DVC shows and compares: whose they are, then its figures. An undefined one is null.

    DVC sorts names, capitals first; and were the first three called as parameters are, `dvc exp show` would put the names of
    files before both.
    """
    figures = run_figures(iterations, evaluation, params)
    return {
        "Task": params.task,
        "Method": method_label(params.method, params.ablation),
        "Seed": params.seed,
        **{name: figures[name] for name in _SHOWN},
    }


def write_summary(
    run: Run,
    evaluation: Evaluation,
    params: Params,
    results: Path,
    metrics_file: Path,
    plots: Path,
) -> list[Row]:
    """Writes the tables, the metrics and the plots' data; returns the rows of the iterations table."""
    iterations = iteration_rows(run, params)
    written: dict[Table, Sequence[Row]] = {
        tables.REPLIES: run.replies,
        tables.VERDICTS: run.verdicts,
        tables.CANDIDATES: run.candidates,
        tables.CURVES: run.curves,
        tables.SCORES: run.scores,
        tables.SURVIVORS: run.survivors,
        tables.MUTANTS: run.mutants,
        tables.ITERATIONS: iterations,
        tables.EVALUATION: evaluation.rows,
        tables.SEEDS: evaluation.seeds,
        tables.EPISODES: evaluation.episodes,
    }
    for table, rows in written.items():
        tables.write(results / f"{table.name}.parquet", table, rows)
    text = json.dumps(metrics(iterations, evaluation, params), indent=2)
    metrics_file.write_text(f"{text}\n", encoding="utf-8")
    points = enumerate(lineage_fitness(run.curves, evaluation.lineage), start=1)
    lines = ([epoch, fitness, link["candidate_id"]] for epoch, (link, fitness) in points)
    _write_csv(plots / "fitness.csv", ("epoch", "fitness", "candidate"), lines)
    shown = ("iteration", "score", "mts", "winner_mts", "beta", "alpha")
    _write_csv(plots / "iterations.csv", shown, ([row[name] for name in shown] for row in iterations))
    for name, (header, *lines_of) in (
        ("candidates", spread_rows(run.curves)),
        ("bonus", bonus_rows(run.curves, evaluation.lineage)),
        ("components", component_rows(run.curves, evaluation.lineage)),
    ):
        _write_csv(plots / f"{name}.csv", [str(word) for word in header], lines_of)
    return iterations


def _write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
