"""Stage train-population: trains every candidate of a pool to the end of a rung."""

from pathlib import Path

import click

from porse.pool import read_pool
from porse.stage import StageCommand, begin, folder, write_manifest


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
    from porse.training.rung import train_rung

    train_rung(read_pool(pool), params, iteration, rung, until * params.train.rung_epochs, out)


if __name__ == "__main__":
    main()
