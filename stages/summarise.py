"""Stage summarise: the run as a whole, for people, `dvc metrics` and `dvc plots`."""

from pathlib import Path

import click

from porse.report.summary import read_run, write_summary
from porse.stage import StageCommand, begin, folder, say


@click.command(cls=StageCommand)
@folder("run")
@folder("results")
@folder("metrics")
@folder("plots")
def main(run: Path, results: Path, metrics: Path, plots: Path) -> None:
    """Writes the tables over all iterations, the metrics, and the data of the plots."""
    params = begin()
    for row in write_summary(read_run(run, params), params, results, metrics, plots):
        say(
            f"iteration {row['iteration']}: MTS {row['mts']:.3f}, winner {row['winner_id']} with fitness {row['fitness']:.3f}"
        )


if __name__ == "__main__":
    main()
