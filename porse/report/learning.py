"""What training with one reward did to fitness, for every run of a suite: `python -m porse.report.learning RESULTS CSV`."""

import csv
import json
import math
from collections.abc import Sequence
from pathlib import Path

import click

from porse import tables
from porse.config import load_params
from porse.tables import Row

EPOCHS = 10
"""How many first and last epochs are averaged."""

COLUMNS = ("task", "epochs", "environment_steps", "first", "last", "mts")


def learning_row(result: Path) -> Row:
    """Returns what one finished run learned: mean fitness of its first and its last epochs, MTS, and what that took.

    Args:
        result: a folder with the run's `params.yaml`, `metrics.json` and `results/`.
    """
    metrics = json.loads((result / "metrics.json").read_text(encoding="utf-8"))
    curves = tables.read(result / "results" / "curves.parquet", tables.CURVES)
    fitness = [row["value"] for row in sorted(curves, key=lambda row: row["epoch"]) if row["series"] == "fitness"]
    return {
        "task": load_params(result / "params.yaml").task,
        "epochs": metrics["epochs_spent"],
        "environment_steps": metrics["environment_steps"],
        "first": round(_mean(fitness[:EPOCHS]), 4),
        "last": round(_mean(fitness[-EPOCHS:]), 4),
        "mts": round(metrics["mts"], 4),
    }


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


@click.command()
@click.argument("results", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("target", type=click.Path(dir_okay=False, path_type=Path))
def main(results: Path, target: Path) -> None:
    """Write one line for each finished run in the folder RESULTS of a suite to the CSV file TARGET."""
    rows = [learning_row(entry) for entry in sorted(results.iterdir()) if (entry / "done.json").exists()]
    with target.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
