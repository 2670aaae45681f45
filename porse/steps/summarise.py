"""Step summarise: the run as a whole, for people, `dvc metrics` and `dvc plots`."""

from pathlib import Path

from porse.config import Params
from porse.report.run import read_evaluation, read_run
from porse.report.summary import write_summary


def summarise(params: Params, run: Path, evaluation: Path, results: Path, metrics: Path, plots: Path) -> str:
    """Writes the tables over all iterations, the metrics, and the data of the plots.

    Args:
        params: the run's parameters.
        run: the folder of the run.
        evaluation: the folder that `evaluate` wrote.
        results: the folder to write tables to.
        metrics: the file to write metrics to.
        plots: the folder to write the data of the plots to.

    Returns:
        What to say about it, a line for each iteration.
    """
    evaluated = read_evaluation(evaluation, run, params)
    rows = write_summary(read_run(run, params), evaluated, params, results, metrics, plots)
    return "\n".join(
        f"iteration {row['iteration']}: MTS {row['mts']:.3f}, winner {row['winner_id']} with score {row['score']:.3f}"
        for row in rows
    )
