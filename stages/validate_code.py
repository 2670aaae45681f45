"""Stage validate-code: checks every function, has broken ones repaired or replaced, and forms the first pool."""

from pathlib import Path

import click

from porse.stage import StageCommand, begin, folder, run_stage, say


@click.command(cls=StageCommand)
@click.option("--iteration", required=True, type=int)
@folder("start")
@folder("generated")
@folder("prompts")
@folder("cache")
@folder("out")
def main(iteration: int, start: Path, generated: Path, prompts: Path, cache: Path, out: Path) -> None:
    """Writes the verdicts, all replies of the iteration so far, and the pool of K candidates."""
    params = begin()
    from porse.generation.states import checker
    from porse.steps.validate_code import validate_code

    with checker(params) as check:
        said = validate_code(params, iteration, start, generated, check, prompts, cache, out)
    say(said)


if __name__ == "__main__":
    run_stage(main)
