"""Stage generate: asks for the rewards and the mappings of an iteration."""

from pathlib import Path

import click

from porse import tables
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
    from porse.generation.brief import read_brief
    from porse.generation.functions import first_attempts, reply_row

    attempts = first_attempts(read_brief(params, iteration, start, prompts), params, iteration, cache)
    rows = [reply_row(iteration, a.kind, a.slot, a.number, a.reply) for a in attempts]
    tables.write(out / "replies.parquet", tables.REPLIES, rows)
    say(f"iteration {iteration}: {len(rows)} replies")


if __name__ == "__main__":
    run_stage(main)
