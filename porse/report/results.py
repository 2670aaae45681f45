"""A finished run as its folder shows it to everybody: parameters and results/, and no folder of a stage.

`metrics.json` is for DVC and is not read: all that it says follows from the tables.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse import tables
from porse.config import Params
from porse.errors import PorseError
from porse.outdated import params_of_run
from porse.pool import BEST, policy_file
from porse.report.agreement import check_agreement
from porse.report.figures import curve_figures, run_figures
from porse.report.run import Evaluation, Run
from porse.search.lineage import lineage
from porse.tables import Row, Table


@dataclass(frozen=True)
class Results:
    """A finished run.

    Attributes:
        params: what it was made with, whatever params.yaml says by now.
        run: the rows of its tables.
        iterations: rows of its iterations table.
        evaluation: how the lineage of winners did with further seeds, and in whole episodes.
        figures: its figures (`porse.report.figures`), those of the curves among them.
        environment: the manifest of the machine that made it; empty where it was not kept.
    """

    params: Params
    run: Run
    iterations: Sequence[Row]
    evaluation: Evaluation
    figures: Mapping[str, Any]
    environment: Mapping[str, str]


def read_results(folder: Path) -> Results:
    """Returns the finished run in `folder`.

    Raises:
        ParamsError: there are no parameters, or they are wrong.
        TableError: a table is missing or is not as declared, or one does not agree with another.
        PorseError: the run had no iteration.
    """
    params, iterations, candidates, held, evaluation = _answer(folder)
    run = Run(
        _rows(folder, tables.REPLIES),
        _rows(folder, tables.VERDICTS),
        candidates,
        _rows(folder, tables.CURVES),
        _rows(folder, tables.SCORES),
        _rows(folder, tables.SURVIVORS),
        _rows(folder, tables.MUTANTS),
        held,
    )
    check_agreement(run, iterations, evaluation, params, str(folder / "results"))
    figures = run_figures(iterations, evaluation, params) | curve_figures(run, evaluation, params)
    return Results(params, run, iterations, evaluation, figures, _environment(folder))


def read_figures(folder: Path) -> dict[str, Any]:
    """Returns the figures of the finished run in `folder` that follow from its short tables: `run_figures`.

    Raises:
        ParamsError: there are no parameters, or they are wrong.
        TableError: a table is missing or is not as declared.
        PorseError: the run had no iteration.
    """
    params, iterations, _, _, evaluation = _answer(folder)
    return run_figures(iterations, evaluation, params)


def read_winner(folder: Path) -> Row:
    """Returns the winner of the finished run in `folder`: its row of the candidates table.

    Raises:
        ParamsError: there are no parameters, or they are wrong.
        TableError: a table is missing or is not as declared.
        PorseError: the run had no iteration.
    """
    *_, evaluation = _answer(folder)
    return evaluation.lineage[-1]


def _answer(folder: Path) -> tuple[Params, list[Row], list[Row], list[Row], Evaluation]:
    """Returns parameters, rows of iterations, of candidates and of incumbents, and the evaluation."""
    params = params_of_run(folder)
    iterations, candidates = _rows(folder, tables.ITERATIONS), _rows(folder, tables.CANDIDATES)
    if not iterations:
        raise PorseError(
            f"expected an iteration in {folder / 'results' / 'iterations.parquet'}, found none; run `porse repro` first"
        )
    held = incumbents(iterations, candidates, params)
    winners = [row for row, _ in held]
    links = lineage(winners, [score for _, score in held], params)
    evaluation = Evaluation(
        links, _rows(folder, tables.EVALUATION), _rows(folder, tables.SEEDS), _rows(folder, tables.EPISODES)
    )
    return params, iterations, candidates, winners, evaluation


def _rows(folder: Path, table: Table) -> list[Row]:
    return tables.read(folder / "results" / f"{table.name}.parquet", table)


def incumbents(iterations: Sequence[Row], candidates: Sequence[Row], params: Params) -> list[tuple[Row, float]]:
    """Returns the candidate that each iteration handed on, as a row of the candidates table, with the score that it won with.

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
                f"expected the winner {name[1]} of iteration {name[0]} among the candidates, found no such row; the tables in results/ are of different runs: run `porse repro`"
            )
        stays = params.fuse.incumbent == "best" and held and row["score"] <= held[-1][1]
        held.append(held[-1] if stays else (by_id[name], row["score"]))
    return held


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
            f"expected a JSON object in {path}, found an unreadable file: {error}; run `porse repro`"
        ) from error
    if not isinstance(found, dict):
        raise PorseError(f"expected a JSON object in {path}, found a {type(found).__name__}; run `porse repro`")
    return found


def winners_policy(run: Path, params: Params) -> Path:
    """Returns the file of the policy that a run ended with.

    Args:
        run: the folder of the run, or that of its iterations, `run` in it.
        params: its parameters.
    """
    iterations = run / "run" if (run / "run").is_dir() else run
    return policy_file(iterations / str(params.iterations[-1].next) / "start", BEST)


def params_file(run: Path) -> Path:
    """Returns the `params.yaml` in or above a run's folder or one of its policies, else that of the project."""
    folder = run.resolve() if run.is_dir() else run.resolve().parent
    found = (place / "params.yaml" for place in (folder, *folder.parents))
    return next((path for path in found if path.is_file()), Path("params.yaml"))
