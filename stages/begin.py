"""Stage begin: what iteration 1 starts from."""

from pathlib import Path

import click

from porse.stage import StageCommand, begin, folder, run_stage, say, write_manifest


@click.command(cls=StageCommand)
@folder("out")
def main(out: Path) -> None:
    """Draws theta_random of iteration 1 and writes it with an empty winner and empty feedback."""
    params = begin()
    write_manifest()
    from porse.steps.begin import begin as begin_run

    say(begin_run(params, out))


if __name__ == "__main__":
    run_stage(main)
