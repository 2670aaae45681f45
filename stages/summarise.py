"""Stage summarise: the run as a whole, for people, `dvc metrics` and `dvc plots`."""

from pathlib import Path

import click

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
    from porse.steps.summarise import summarise

    say(summarise(params, run, evaluation, results, metrics, plots))


if __name__ == "__main__":
    run_stage(main)
