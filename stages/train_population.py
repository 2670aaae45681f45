"""Stage train-population: trains every candidate of a pool to the end of a rung."""

from pathlib import Path

import click

from porse.stage import StageCommand, begin, folder, run_stage, write_manifest


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@click.option("--rung", required=True)
@click.option("--until", required=True, type=click.IntRange(min=1), help="Rungs that are done after this one.")
@folder("pool")
@folder("out")
def main(iteration: int, rung: str, until: int, pool: Path, out: Path) -> None:
    """Writes the trained pool."""
    params = begin()
    write_manifest()
    from porse.steps.train_population import train_population

    train_population(params, iteration, rung, until, pool, out)


if __name__ == "__main__":
    run_stage(main)
