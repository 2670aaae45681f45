"""Stage eliminate: ranks a trained pool and keeps the best."""

from pathlib import Path

import click

from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@click.option("--rung", required=True)
@click.option(
    "--keep", required=True, type=click.IntRange(min=1), help="How many go on where eliminate.keep is `rungs`."
)
@folder("trained")
@folder("out")
def main(iteration: int, rung: str, keep: int, trained: Path, out: Path) -> None:
    """Writes the scores, the survivors, and the pool of the survivors."""
    params = begin()
    from porse.steps.eliminate import eliminate

    say(eliminate(params, iteration, rung, keep, trained, out))


if __name__ == "__main__":
    run_stage(main)
