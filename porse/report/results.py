"""A finished run as its folder shows it to everybody: params.yaml, results/ and metrics.json, and no folder of a stage."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse import tables
from porse.config import ROOT, Params, load_params
from porse.errors import PorseError
from porse.report.agreement import check_agreement
from porse.report.run import Evaluation, Run
from porse.search.lineage import lineage
from porse.tables import Row, Table

_FIGURES = (
    "score", "mts", "hns", "final_success", "evaluation", "epochs_spent", "epochs_allowed", "environment_steps", "replies",
)  # fmt: skip
"""What a page needs of `metrics.json`."""


@dataclass(frozen=True)
class Results:
    """A finished run.

    Attributes:
        params: its parameters.
        run: the rows of its tables.
        iterations: rows of its iterations table.
        evaluation: how the lineage of winners did with further seeds, and in whole episodes.
        metrics: what `metrics.json` holds.
        environment: the manifest of the machine that made it; empty where it was not kept.
    """

    params: Params
    run: Run
    iterations: Sequence[Row]
    evaluation: Evaluation
    metrics: Mapping[str, Any]
    environment: Mapping[str, str]


def read_results(folder: Path) -> Results:
    """Returns the finished run in `folder`.

    Raises:
        ParamsError: there are no parameters, or they are wrong.
        TableError: a table is missing or is not as declared, or one does not agree with another.
        PorseError: there are no metrics, they are another version's, or the run had no iteration.
    """
    # A run elsewhere may have come with its presets; one that did not has those of the project we are in.
    params = load_params(folder / "params.yaml", folder if (folder / "presets").is_dir() else ROOT)

    def rows(table: Table) -> list[Row]:
        return tables.read(folder / "results" / f"{table.name}.parquet", table)

    iterations, candidates = rows(tables.ITERATIONS), rows(tables.CANDIDATES)
    if not iterations:
        raise PorseError(
            f"expected an iteration in {folder / 'results' / 'iterations.parquet'}, found none; run `dvc repro` first"
        )
    held = incumbents(iterations, candidates, params)
    run = Run(
        rows(tables.REPLIES),
        rows(tables.VERDICTS),
        candidates,
        rows(tables.CURVES),
        rows(tables.SCORES),
        rows(tables.SURVIVORS),
        rows(tables.MUTANTS),
        [row for row, _ in held],
    )
    chain = lineage(run.incumbents, [score for _, score in held], params)
    evaluation = Evaluation(chain, rows(tables.EVALUATION), rows(tables.SEEDS), rows(tables.EPISODES))
    check_agreement(run, iterations, evaluation, params, str(folder / "results"))
    return Results(params, run, iterations, evaluation, read_metrics(folder / "metrics.json"), _environment(folder))


def incumbents(iterations: Sequence[Row], candidates: Sequence[Row], params: Params) -> list[tuple[Row, float]]:
    """Returns whom each iteration handed on, as a row of the candidates table, with the score that it won with.

    Args:
        iterations: rows of the iterations table, in their order.
        candidates: rows of the candidates table.
        params: fuse.incumbent `best` keeps the earlier one unless its score is exceeded.

    Raises:
        PorseError: a winner is not among the candidates.
    """
    by_id = {(row["iteration"], row["candidate_id"]): row for row in candidates}
    held: list[tuple[Row, float]] = []
    for row in iterations:
        name = (row["iteration"], row["winner_id"])
        if name not in by_id:
            raise PorseError(
                f"expected the winner {name[1]} of iteration {name[0]} among the candidates, found no such row; the tables in results/ are of different runs: run `dvc repro`"
            )
        stays = params.fuse.incumbent == "best" and held and row["score"] <= held[-1][1]
        held.append(held[-1] if stays else (by_id[name], row["score"]))
    return held


def read_metrics(path: Path) -> Mapping[str, Any]:
    """Returns what a run's `metrics.json` holds.

    Raises:
        PorseError: there is no such file, it holds no JSON object, or it is another version's.
    """
    found = _json(path)
    if found is None:
        raise PorseError(f"expected the metrics of a run at {path}, found no such file; run `dvc repro` first")
    missing = [name for name in _FIGURES if name not in found]
    if missing:
        raise PorseError(
            f"expected {', '.join(_FIGURES)} in {path}, found no {', '.join(missing)}; the file is of another version: run `dvc repro`"
        )
    return found


def _environment(folder: Path) -> Mapping[str, str]:
    return {name: str(value) for name, value in (_json(folder / "logs" / "environment.json") or {}).items()}


def _json(path: Path) -> Mapping[str, Any] | None:
    """Returns the JSON object in a file, None where there is no such file."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise PorseError(
            f"expected a JSON object in {path}, found an unreadable file: {error}; run `dvc repro`"
        ) from error
    if not isinstance(found, dict):
        raise PorseError(f"expected a JSON object in {path}, found a {type(found).__name__}; run `dvc repro`")
    return found
