"""The figures of a run that its metrics report: pure functions over rows."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from porse.config import Params
from porse.report.run import Run
from porse.tables import Row


def human_normalised_score(mts: float, human: float, sparse: float) -> float | None:
    """Returns (MTS - MTS_sparse) / (MTS_human - MTS_sparse) (eq. 8); None where human and sparse are equal."""
    return None if human == sparse else (mts - sparse) / (human - sparse)


def task_score(mts: float, params: Params) -> float | None:
    """Returns the human normalised score by the references of the run's task; None where there are none."""
    reference = params.summarise.references.get(params.task)
    return human_normalised_score(mts, reference.human, reference.sparse) if reference else None


def area_under_curve(fitness: Sequence[float]) -> float:
    """Returns the area under a fitness curve divided by its length: the mean fitness over its epochs."""
    return math.fsum(fitness) / len(fitness)


def epochs_to(threshold: float | None, run: Run, params: Params) -> int | None:
    """Returns how many epochs were spent, in the order of the schedule, when a fitness first reached `threshold`.

    Candidates of a rung are trained side by side: an epoch of one counts when those of the others up to it are done.

    Returns:
        None where no threshold is given, or no fitness reached it.
    """
    if threshold is None:
        return None
    order = {str(rung.rung): place for place, rung in enumerate(params.rungs)}
    rows = sorted(
        (row for row in run.curves if row["series"] == "fitness"),
        key=lambda row: (row["iteration"], order[row["rung"]], row["epoch"], row["candidate_id"]),
    )
    return next((spent for spent, row in enumerate(rows, start=1) if row["value"] >= threshold), None)


def chain_fitness(curves: Sequence[Row], chain: Sequence[Row]) -> list[tuple[Row, float]]:
    """Returns (link, fitness) for every epoch of a chain of candidates, one link after the other."""
    points: list[tuple[Row, float]] = []
    for link in chain:
        rows = [
            row
            for row in curves
            if row["iteration"] == link["iteration"]
            and row["candidate_id"] == link["candidate_id"]
            and row["series"] == "fitness"
        ]
        points += [(link, row["value"]) for row in sorted(rows, key=lambda row: row["epoch"])]
    return points


def evaluation_figures(rows: Sequence[Row]) -> Mapping[str, Any]:
    """Returns mean and standard deviation of the MTS that the winning lineage reached with further seeds.

    The deviation is that of a sample (n - 1), None for fewer than two seeds. The run's own seed is not among them: it
    chose the lineage.
    """
    best: dict[int, float] = {}
    for row in rows:
        best[row["seed"]] = max(row["fitness"], best.get(row["seed"], -math.inf))
    values = [best[seed] for seed in sorted(best)]
    if not values:
        return {"seeds": 0, "mts_mean": None, "mts_std": None}
    mean = math.fsum(values) / len(values)
    spread = math.fsum((value - mean) ** 2 for value in values)
    return {
        "seeds": len(values),
        "mts_mean": mean,
        "mts_std": math.sqrt(spread / (len(values) - 1)) if len(values) > 1 else None,
    }
