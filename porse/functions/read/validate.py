"""Verdicts on replies. All of it happens in confined processes; here they are asked."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from porse.functions.read.limits import Limits
from porse.functions.read.sandbox import Sandbox
from porse.functions.verdict import Kind, Verdict
from porse.variables import Variable


@dataclass(frozen=True)
class Submission:
    """A model's reply and what it should hold.

    Attributes:
        reply: the whole text.
        kind: "reward" or "mapping".
    """

    reply: str
    kind: Kind


def validate(
    submissions: Sequence[Submission], variables: Sequence[Variable], states: Path, limits: Limits
) -> list[tuple[Verdict, str]]:
    """Returns for each submission, in order, its verdict and its normalised source, "" when it did not pass.

    One child process serves all submissions, each in processes of its own that end with it.

    Args:
        submissions: the replies.
        variables: what the task offers.
        states: real states of the task, written by `save_states`.
        limits: what one function may use.
    """
    if not submissions:
        return []
    with Sandbox(limits) as sandbox:
        sandbox.load(states, variables)
        return [sandbox.judge(submission.reply, submission.kind) for submission in submissions]
