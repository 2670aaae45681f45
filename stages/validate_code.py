"""Stage validate-code: checks every function, has broken ones repaired or replaced, and forms the first pool."""

from pathlib import Path

import click

from porse import tables
from porse.pool import START_POLICIES, START_POLICY, policy_file, write_pool
from porse.search.lengths import alpha_is_searched
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
    from porse.generation.brief import read_brief
    from porse.generation.candidates import first_pool
    from porse.generation.functions import checked_functions, reply_row, restored_attempts, verdict_row
    from porse.generation.states import checker

    brief = read_brief(params, iteration, start, prompts)
    attempts = restored_attempts(tables.read(generated / "replies.parquet", tables.REPLIES), brief, params)
    with checker(params) as check:
        checked = checked_functions(attempts, check, brief, params, iteration, cache)
    tried = checked.attempts
    tables.write(
        out / "replies.parquet",
        tables.REPLIES,
        [reply_row(iteration, a.kind, a.slot, a.number, a.reply) for a, _ in tried],
    )
    tables.write(
        out / "verdicts.parquet", tables.VERDICTS, [verdict_row(iteration, a, verdict) for a, verdict in tried]
    )
    candidates = first_pool(checked.functions, brief.winner, brief.breedings, params, iteration)
    stems = START_POLICIES if alpha_is_searched(params, iteration) else (START_POLICY,)
    write_pool(out, candidates, [], {stem: policy_file(start, stem) for stem in stems})
    valid = sum(verdict.passed for _, verdict in tried)
    say(
        f"iteration {iteration}: {valid} of {len(tried)} replies ran, {len(tried) - len(attempts)} of them asked for again"
    )


if __name__ == "__main__":
    run_stage(main)
