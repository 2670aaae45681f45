"""Stage train-population: trains every candidate of a pool to the end of a rung."""

from pathlib import Path

import click

from porse.pool import read_pool
from porse.search.lengths import alpha_is_searched, rung_epochs
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
    entering = read_pool(pool)
    until_epoch = until * rung_epochs(params)
    if alpha_is_searched(params, iteration) and all(row["epochs"] == 0 for row in entering.candidates):
        # Imported here: the Gaussian process takes a second to import, and one method needs it.
        from porse.training.probing import search_rung

        search_rung(entering, params, iteration, rung, until_epoch, out)
    else:
        from porse.training.rung import train_rung

        train_rung(entering, params, iteration, rung, until_epoch, out)


if __name__ == "__main__":
    run_stage(main)
