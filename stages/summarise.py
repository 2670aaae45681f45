"""Stage summarise: the run as a whole, for people, `dvc metrics` and `dvc plots`."""

from pathlib import Path

import click

from porse import tables
from porse.report.run import read_lineage, read_run
from porse.report.summary import write_summary
from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@folder("run")
@folder("evaluation")
@folder("results")
@folder("metrics")
@folder("plots")
def main(run: Path, evaluation: Path, results: Path, metrics: Path, plots: Path) -> None:
    """Writes the tables over all iterations, the metrics, and the data of the plots."""
    params = begin()
    evaluated = tables.read(evaluation / "evaluation.parquet", tables.EVALUATION)
    rows = write_summary(read_run(run, params), read_lineage(run, params), evaluated, params, results, metrics, plots)
    for row in rows:
        say(
            f"iteration {row['iteration']}: MTS {row['mts']:.3f}, winner {row['winner_id']} with fitness {row['fitness']:.3f}"
        )


if __name__ == "__main__":
    run_stage(main)
