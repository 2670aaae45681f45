"""Step validate-code: checks every function, has broken ones repaired or replaced, and forms the first pool."""

from collections.abc import Sequence
from pathlib import Path

from porse import tables
from porse.config import Params
from porse.functions.verdict import Verdict
from porse.generation.brief import read_brief
from porse.generation.candidates import first_pool
from porse.generation.functions import (
    Attempt,
    Check,
    NoFunctionLeft,
    checked_functions,
    reply_row,
    restored_attempts,
    verdict_row,
)
from porse.pool import START_POLICIES, START_POLICY, policy_file, write_pool
from porse.search.lengths import alpha_is_searched


def validate_code(
    params: Params,
    iteration: int,
    start: Path,
    generated: Path,
    check: Check,
    prompts: Path,
    cache: Path,
    out: Path,
) -> str:
    """Writes the verdicts, all replies of the iteration so far, and the pool of K candidates to `out`.

    Args:
        params: the run's parameters.
        iteration: which iteration, from 1.
        start: the folder that the iteration starts from.
        generated: the folder that `generate` wrote.
        check: tries functions, see `porse.generation.states.checker`.
        prompts: the folder of the prompts' templates.
        cache: the folder of recorded replies.
        out: the folder to write.

    Returns:
        What to say about it.

    Raises:
        CacheError: a reply is not recorded, or its record cannot be trusted.
        RepliesPending: in batch mode, some questions wait for an answer.
        SearchError: no valid function is left; the verdicts and the replies are written all the same.
    """
    brief = read_brief(params, iteration, start, prompts)
    attempts = restored_attempts(tables.read(generated / "replies.parquet", tables.REPLIES), brief, params)
    try:
        checked = checked_functions(attempts, check, brief, params, iteration, cache)
    except NoFunctionLeft as failure:
        _write_tried(out, iteration, failure.attempts)
        raise
    tried = checked.attempts
    _write_tried(out, iteration, tried)
    candidates = first_pool(checked.functions, brief.winner, brief.breedings, params, iteration)
    stems = START_POLICIES if alpha_is_searched(params, iteration) else (START_POLICY,)
    write_pool(out, candidates, [], {stem: policy_file(start, stem) for stem in stems})
    valid, again = sum(verdict.passed for _, verdict in tried), len(tried) - len(attempts)
    return f"iteration {iteration}: {valid} of {len(tried)} replies ran, {again} of them asked for again"


def _write_tried(out: Path, iteration: int, tried: Sequence[tuple[Attempt, Verdict]]) -> None:
    """Writes all replies and the verdicts on them."""
    replies = [reply_row(iteration, a.kind, a.slot, a.number, a.reply) for a, _ in tried]
    verdicts = [verdict_row(iteration, a, verdict) for a, verdict in tried]
    tables.write(out / "replies.parquet", tables.REPLIES, replies)
    tables.write(out / "verdicts.parquet", tables.VERDICTS, verdicts)
