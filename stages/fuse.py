"""Stage fuse: the winner becomes theta_best, and all that the next iteration starts from is written."""

from pathlib import Path

import click

from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@folder("start")
@folder("pool")
@folder("out")
def main(iteration: int, start: Path, pool: Path, out: Path) -> None:
    """Writes theta_best, theta_random and theta_f of the next iteration, the winner, the feedback and the islands."""
    params = begin()
    from porse.steps.fuse import fuse

    say(fuse(params, iteration, start, pool, out))


if __name__ == "__main__":
    run_stage(main)
