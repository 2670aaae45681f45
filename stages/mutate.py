"""Stage mutate: adds variants of the best survivor at half time, beta in odd iterations, alpha in even ones."""

from pathlib import Path

import click

from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@folder("pool")
@folder("start")
@folder("prompts")
@folder("cache")
@folder("out")
def main(iteration: int, pool: Path, start: Path, prompts: Path, cache: Path, out: Path) -> None:
    """Writes the mutants, the replies that proposed them, and the pool of survivors and mutants."""
    params = begin()
    from porse.steps.mutate import mutate

    say(mutate(params, iteration, pool, start, prompts, cache, out))


if __name__ == "__main__":
    run_stage(main)
