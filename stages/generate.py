"""Stage generate: asks for the rewards and the mappings of an iteration."""

from pathlib import Path

import click

from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@folder("start")
@folder("prompts")
@folder("cache")
@folder("out")
def main(iteration: int, start: Path, prompts: Path, cache: Path, out: Path) -> None:
    """Writes the first reply for every slot."""
    params = begin()
    from porse.steps.generate import generate

    say(generate(params, iteration, start, prompts, cache, out))


if __name__ == "__main__":
    run_stage(main)
