"""Step generate: asks for the rewards and the mappings of an iteration."""

from pathlib import Path

from porse import tables
from porse.config import Params
from porse.generation.brief import read_brief
from porse.generation.functions import first_attempts, reply_row


def generate(params: Params, iteration: int, start: Path, prompts: Path, cache: Path, out: Path) -> str:
    """Writes the first reply for every slot to `out`; returns what to say about it.

    Args:
        params: the run's parameters.
        iteration: which iteration, from 1.
        start: the folder that the iteration starts from.
        prompts: the folder of the prompts' templates.
        cache: the folder of recorded replies.
        out: the folder to write.

    Raises:
        CacheError: a reply is not recorded, or its record cannot be trusted.
        RepliesPending: in batch mode, some questions wait for an answer.
    """
    attempts = first_attempts(read_brief(params, iteration, start, prompts), params, iteration, cache)
    rows = [reply_row(iteration, a.kind, a.slot, a.number, a.reply) for a in attempts]
    tables.write(out / "replies.parquet", tables.REPLIES, rows)
    return f"iteration {iteration}: {len(rows)} replies"
