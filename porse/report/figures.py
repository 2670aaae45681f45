"""The figures of a run, flat and under one name each: pure functions over rows.

`metrics.json`, `porse results --json`, `porse suite status --json` and `porse suite compare --figure` have them under these names.
"""

import math
from collections.abc import Sequence
from typing import Any

from porse.config import EliminateParams, Params
from porse.report.run import Evaluation, Run
from porse.search.elimination import score_of
from porse.search.schedule import allowed_epochs
from porse.tables import Row

CONFIDENCE = 0.95
"""Of the interval about final success."""

LENGTHS = ("lineage", "budget")
"""How long the policies were trained that the human normalised score is measured against."""


def method_label(method: str, ablation: str) -> str:
    """Returns what a method with an ablation is called in a table; the method alone where nothing is left out of it."""
    return method if ablation == "none" else f"{method} {ablation}"


def run_figures(iterations: Sequence[Row], evaluation: Evaluation, params: Params) -> dict[str, Any]:
    """Returns a run's figures, but for those of `curve_figures`. One that is undefined is None.

    Args:
        iterations: rows of its iterations table.
        evaluation: what `evaluate` found; its lineage is the winning one.
        params: the run's parameters.
    """
    score = {(row["iteration"], row["winner_id"]): row["score"] for row in iterations}
    winner = evaluation.lineage[-1]
    functions, valid = (sum(row[name] for row in iterations) for name in ("replies", "valid_replies"))
    mts = max(row["mts"] for row in iterations)
    return {
        "score": score[winner["iteration"], winner["candidate_id"]],
        "mts": mts,
        **task_scores(mts, params),
        **final_success(evaluation.episodes),
        **evaluation_figures(evaluation.rows, evaluation.seeds, params.eliminate),
        "epochs_spent": sum(row["epochs"] for row in iterations),
        "epochs_allowed": allowed_epochs(params),
        "environment_steps": sum(row["environment_steps"] for row in iterations),
        "functions": functions,
        "valid_functions": valid,
        "valid_share": valid / functions if functions else None,
    }


def curve_figures(run: Run, evaluation: Evaluation, params: Params) -> dict[str, Any]:
    """Returns those figures of a run that need its long tables: curves, candidates, replies. An undefined one is None."""
    return {
        "fitness_area": area_under_curve([fitness for _, fitness in lineage_fitness(run.curves, evaluation.lineage)]),
        "epochs_to_threshold": epochs_to(params.summarise.thresholds.get(params.task), run, params),
        "failed_candidates": sum(bool(row["failure"]) for row in run.candidates),
        "replies": len(run.replies),
        "prompt_tokens": sum(row["prompt_tokens"] for row in run.replies),
        "completion_tokens": sum(row["completion_tokens"] for row in run.replies),
        "recorded_usd": math.fsum(row["recorded_usd"] for row in run.replies),
    }


def human_normalised_score(mts: float, human: float, sparse: float) -> float | None:
    """Returns (MTS - MTS_sparse) / (MTS_human - MTS_sparse) (eq. 8); None where human and sparse are equal."""
    return None if human == sparse else (mts - sparse) / (human - sparse)


def task_scores(mts: float, params: Params) -> dict[str, float | None]:
    """Returns the human normalised score by the references of the run's task, of both lengths; None where there are none."""
    reference = params.summarise.references.get(params.task)
    if reference is None:
        return {f"hns_{length}": None for length in LENGTHS}
    return {
        "hns_lineage": human_normalised_score(mts, reference.human.lineage, reference.sparse.lineage),
        "hns_budget": human_normalised_score(mts, reference.human.budget, reference.sparse.budget),
    }


def final_success(episodes: Sequence[Row]) -> dict[str, Any]:
    """Returns the mean outcome of whole episodes, their number, and an interval of confidence about the mean.

    The interval is Wilson's where outcomes are 0 and 1 alone, else Student's. Its ends are rounded to six digits: SciPy takes
    them from the system's logarithm, the last bits of which differ between CPUs.

    Args:
        episodes: rows of the episodes table, at least two.
    """
    # Imported here: it takes most of a second, and nothing else in this module needs it.
    from scipy import stats

    outcomes = [row["outcome"] for row in episodes]
    count = len(outcomes)
    mean = math.fsum(outcomes) / count
    low = high = mean
    if set(outcomes) <= {0.0, 1.0}:
        low, high = stats.binomtest(outcomes.count(1.0), count).proportion_ci(CONFIDENCE, method="wilson")
    elif error := math.sqrt(math.fsum((outcome - mean) ** 2 for outcome in outcomes) / (count - 1) / count):
        low, high = stats.t.interval(CONFIDENCE, count - 1, loc=mean, scale=error)
    return {
        "success": mean,
        "success_low": float(f"{low:.6g}"),
        "success_high": float(f"{high:.6g}"),
        "episodes": count,
    }


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


def lineage_fitness(curves: Sequence[Row], lineage: Sequence[Row]) -> list[tuple[Row, float]]:
    """Returns (link, fitness) for every epoch of a lineage of candidates, one link after the other."""
    points: list[tuple[Row, float]] = []
    for link in lineage:
        rows = [
            row
            for row in curves
            if row["iteration"] == link["iteration"]
            and row["candidate_id"] == link["candidate_id"]
            and row["series"] == "fitness"
        ]
        points += [(link, row["value"]) for row in sorted(rows, key=lambda row: row["epoch"])]
    return points


def evaluation_figures(rows: Sequence[Row], seeds: Sequence[Row], params: EliminateParams) -> dict[str, Any]:
    """Returns how often the winning lineage was trained with further seeds, and mean and deviation of its score and its MTS.

    The score is that of the last link, as in the run. The deviation is that of a sample (n - 1), None for fewer than two
    seeds. A seed that failed counts as failed, and its links before that count nowhere. The run's own seed is not among them: it
    chose the lineage.

    Args:
        rows: of the evaluation table.
        seeds: of the seeds table.
        params: what the score is.
    """
    done = [row["seed"] for row in seeds if not row["failure"]]
    own = [sorted((row for row in rows if row["seed"] == seed), key=lambda row: row["epoch"]) for seed in done]
    last = max((row["iteration"] for row in rows), default=0)
    scores = [score_of([row["fitness"] for row in each if row["iteration"] == last], params) for each in own]
    return {
        "evaluation_seeds": len(done),
        "evaluation_failed": len(seeds) - len(done),
        **spread("evaluation_score", scores),
        **spread("evaluation_mts", [max(row["fitness"] for row in each) for each in own]),
    }


def spread(name: str, values: Sequence[float]) -> dict[str, float | None]:
    """Returns mean and deviation, that of a sample, as `NAME_mean` and `NAME_std`; None where there are too few values."""
    if not values:
        return {f"{name}_mean": None, f"{name}_std": None}
    mean, deviation = mean_and_deviation(values)
    return {f"{name}_mean": mean, f"{name}_std": deviation}


def mean_and_deviation(values: Sequence[float]) -> tuple[float, float | None]:
    """Returns the mean of at least one value, and the deviation of a sample (n - 1), None for a single value."""
    mean = math.fsum(values) / len(values)
    squares = math.fsum((value - mean) ** 2 for value in values)
    return mean, math.sqrt(squares / (len(values) - 1)) if len(values) > 1 else None
