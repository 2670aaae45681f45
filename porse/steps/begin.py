"""Step begin: what iteration 1 starts from, in the shape that `fuse` leaves for the others: no winner, theta_random."""

from pathlib import Path

from porse import tables
from porse.checkpoint import write_checkpoint
from porse.config import Params
from porse.pool import RANDOM, START_POLICY, policy_file
from porse.training.start import random_policy


def begin(params: Params, out: Path) -> str:
    """Draws theta_random of iteration 1 and writes it to `out`, with an empty winner and empty feedback; returns what to say about it."""
    random = random_policy(params, 1)
    write_checkpoint(policy_file(out, RANDOM), random)
    # Nothing to fuse with: theta_f is theta_random (algorithm 1, n = 1).
    write_checkpoint(policy_file(out, START_POLICY), random)
    tables.write(out / "winner.parquet", tables.CANDIDATES, [])
    tables.write(out / "score.parquet", tables.SURVIVORS, [])
    tables.write(out / "feedback.parquet", tables.FEEDBACK, [])
    tables.write(out / "members.parquet", tables.MEMBERS, [])
    tables.write(out / "member_feedback.parquet", tables.MEMBER_FEEDBACK, [])
    return "iteration 1: no winner yet, a random policy"
