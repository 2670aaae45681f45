"""A run as its folder holds it: all rows of its tables, over its iterations."""

from dataclasses import dataclass
from pathlib import Path

from porse import tables
from porse.config import Params
from porse.pool import CANDIDATES_FILE, CURVES_FILE
from porse.search.lineage import lineage
from porse.tables import Row


@dataclass(frozen=True)
class Evaluation:
    """What `evaluate` found.

    Attributes:
        lineage: the winning lineage: rows of the candidates table, the first link first. Its last is the run's winner.
        rows: of the evaluation table.
        seeds: rows of the seeds table.
        episodes: rows of the episodes table.
    """

    lineage: list[Row]
    rows: list[Row]
    seeds: list[Row]
    episodes: list[Row]


@dataclass(frozen=True)
class Run:
    """All rows of a run, over its iterations.

    Attributes:
        replies, verdicts, candidates, curves, scores, survivors, mutants: rows of the tables of these names.
        incumbents: for each iteration the candidate that the next one goes on from, as a row of the candidates table.
    """

    replies: list[Row]
    verdicts: list[Row]
    candidates: list[Row]
    curves: list[Row]
    scores: list[Row]
    survivors: list[Row]
    mutants: list[Row]
    incumbents: list[Row]


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
        run.incumbents.extend(tables.read(folder / str(entry.next) / "start" / "winner.parquet", tables.CANDIDATES))
    return run


def read_lineage(folder: Path, params: Params) -> list[Row]:
    """Returns the winning lineage of the run in `folder`: rows of the candidates table, the first link first.

    Raises:
        TableError: a table is missing or is not as declared.
    """
    starts = [folder / str(entry.next) / "start" for entry in params.iterations]
    incumbents = [row for start in starts for row in tables.read(start / "winner.parquet", tables.CANDIDATES)]
    scores = [row["score"] for start in starts for row in tables.read(start / "score.parquet", tables.SURVIVORS)]
    return lineage(incumbents, scores, params)


def read_evaluation(folder: Path, run: Path, params: Params) -> Evaluation:
    """Returns what `evaluate` wrote to `folder` about the run in the folder `run`.

    Raises:
        TableError: a table is missing or is not as declared.
    """
    return Evaluation(
        read_lineage(run, params),
        tables.read(folder / "evaluation.parquet", tables.EVALUATION),
        tables.read(folder / "seeds.parquet", tables.SEEDS),
        tables.read(folder / "episodes.parquet", tables.EPISODES),
    )
