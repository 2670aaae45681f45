"""Stage evaluate: trains the winning lineage again with further seeds, and lets the run's winner play."""

from pathlib import Path

import click

from porse.stage import StageCommand, begin, folder, run_stage, say, write_manifest


@click.command(cls=StageCommand)
@folder("run")
@folder("out")
def main(run: Path, out: Path) -> None:
    """Writes the tables evaluation, seeds and episodes."""
    params = begin()
    write_manifest()
    from porse.steps.evaluate import evaluate

    say(evaluate(params, run, out))


if __name__ == "__main__":
    run_stage(main)
