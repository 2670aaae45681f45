"""Verdicts on replies: extraction and the static check here, compilation and the first run in a limited child."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from porse.code.check import check_program
from porse.code.contract import Kind
from porse.code.extract import Extracted, extract
from porse.code.limits import Limits
from porse.code.program import parse_program
from porse.code.sandbox import Sandbox
from porse.code.verdict import CodeError, Verdict
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

    One child process serves all submissions, each in a process of its own that ends with it.

    Args:
        submissions: the replies.
        variables: what the task offers.
        states: real states of the task, written by `save_states`.
        limits: what one function may use.
    """
    screened = [screen(submission, variables) for submission in submissions]
    if all(isinstance(found, Verdict) for found in screened):
        return [(found, "") for found in screened if isinstance(found, Verdict)]
    with Sandbox(limits) as sandbox:
        sandbox.load(states, variables)
        return [_probe(found, s.kind, sandbox) for found, s in zip(screened, submissions, strict=True)]


def judge(submission: Submission, variables: Sequence[Variable], sandbox: Sandbox) -> tuple[Verdict, str]:
    """Returns the verdict on one submission and its normalised source, "" when it did not pass."""
    return _probe(screen(submission, variables), submission.kind, sandbox)


def screen(submission: Submission, variables: Sequence[Variable]) -> Extracted | Verdict:
    """Returns the code of a submission, or the verdict when extraction or the static check refuses it already."""
    try:
        extracted = extract(submission.reply, submission.kind)
    except CodeError as error:
        return Verdict(False, error.check, str(error), error.line)
    try:
        check_program(parse_program(extracted.source), {v.name: v for v in variables})
    except CodeError as error:
        return Verdict(False, error.check, str(error), _reply_line(extracted, error.line))
    return extracted


def _probe(screened: Extracted | Verdict, kind: Kind, sandbox: Sandbox) -> tuple[Verdict, str]:
    if isinstance(screened, Verdict):
        return screened, ""
    verdict = sandbox.probe(screened.source, kind)
    if verdict.passed:
        return verdict, screened.source
    return Verdict(False, verdict.check, verdict.message, _reply_line(screened, verdict.line)), ""


def _reply_line(extracted: Extracted, line: int) -> int:
    return extracted.lines[line - 1] if 0 < line <= len(extracted.lines) else 0
