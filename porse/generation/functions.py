"""K valid functions of each kind: ask, check, repair, replace.

Each slot has its own sequence of attempts: a first reply, up to `max_repairs` repairs of it, then up to `max_fresh`
fresh replies, each with its own repairs. The slots go through their attempts side by side, so that all open questions of
a round are asked at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from porse.config import Params
from porse.errors import SearchError
from porse.functions.verdict import Kind, Verdict
from porse.generation.answers import answers
from porse.generation.conversations import Brief, conversation, repair
from porse.llm.request import Message, Origin, Question, Reply, request_of
from porse.search.schedule import asked_kinds, is_searched
from porse.tables import Row

ROUNDS = 1001
"""How many samples of a question an iteration has for each slot: `validate.max_fresh` is at most 1000."""


@dataclass(frozen=True)
class Attempt:
    """One reply of one slot, and the verdict on it.

    Attributes:
        kind: what was asked for.
        slot: place in the iteration.
        number: 0 for the first reply.
        asked: the messages that it answers.
        reply: the reply.
    """

    kind: Kind
    slot: int
    number: int
    asked: tuple[Message, ...]
    reply: Reply


@dataclass(frozen=True)
class Function:
    """A function that passed every check."""

    kind: Kind
    slot: int
    key: str
    source: str
    program: str


def first_places(params: Params, iteration: int) -> list[tuple[Kind, int]]:
    """Returns the kind and the slot of every function that an iteration starts with by asking; none where it has none."""
    if not is_searched(params, iteration):
        return []
    elites = params.generate.elites if iteration > 1 else 0
    return [(kind, slot) for kind in asked_kinds(params) for slot in range(params.generate.candidates - elites)]


def attempts_at_most(params: Params) -> int:
    """Returns how many replies one function may take: the first, fresh ones, and the repairs of each."""
    return (params.validate.max_repairs + 1) * (params.validate.max_fresh + 1)


def first_attempts(brief: Brief, params: Params, iteration: int, cache: Path) -> list[Attempt]:
    """Returns the first reply of every slot of every kind that candidates are made of; none where there are none."""
    places = first_places(params, iteration)
    asked = [conversation(brief, kind, slot) for kind, slot in places]
    questions = [
        _question(
            params,
            messages,
            sample_of(brief, kind, slot, 0, params, iteration),
            Origin("generate", iteration, f"{kind} {slot}"),
        )
        for (kind, slot), messages in zip(places, asked, strict=True)
    ]
    replies = answers([kind for kind, _ in places], questions, params, cache)
    return [
        Attempt(kind, slot, 0, messages, reply)
        for (kind, slot), messages, reply in zip(places, asked, replies, strict=True)
    ]


def restored_attempts(rows: Sequence[Row], brief: Brief, params: Params) -> list[Attempt]:
    """Returns the first attempts again from the rows of the replies table that `generate` wrote."""
    return [
        Attempt(kind, row["slot"], row["attempt"], conversation(brief, kind, row["slot"]), reply_of(row))
        for kind in asked_kinds(params)
        for row in rows
        if row["kind"] == kind
    ]


Check = Callable[[Sequence[Attempt]], list[tuple[Verdict, str]]]
"""Attempts -> for each its verdict and its normalised source, "" when it did not pass."""


@dataclass(frozen=True)
class Checked:
    """What checking and repairing left: every attempt with its verdict, and one function for each slot and kind."""

    attempts: list[tuple[Attempt, Verdict]]
    functions: list[Function]


class NoFunctionLeft(SearchError):
    """A slot has no attempt left.

    Attributes:
        attempts: every attempt of all slots so far, with its verdict.
    """

    def __init__(self, message: str, attempts: list[tuple[Attempt, Verdict]]) -> None:
        super().__init__(message)
        self.attempts = attempts


def checked_functions(
    attempts: Sequence[Attempt],
    check: Check,
    brief: Brief,
    params: Params,
    iteration: int,
    cache: Path,
) -> Checked:
    """Returns one function that passed for every slot of `attempts`, repairing and replacing those that did not.

    Raises:
        NoFunctionLeft: a slot has no attempt left.
    """
    tried: list[tuple[Attempt, Verdict]] = []
    passed: list[Function] = []
    open_attempts = list(attempts)
    while open_attempts:
        broken: list[tuple[Attempt, Verdict]] = []
        for attempt, (verdict, source) in zip(open_attempts, check(open_attempts), strict=True):
            tried.append((attempt, verdict))
            if verdict.passed:
                passed.append(Function(attempt.kind, attempt.slot, attempt.reply.key, source, verdict.program))
            else:
                broken.append((attempt, verdict))
        for attempt, verdict in broken:
            _check_any_left(attempt, verdict, tried, params, iteration)
        open_attempts = _next_attempts(broken, brief, params, iteration, cache)
    return Checked(tried, passed)


def _next_attempts(
    broken: Sequence[tuple[Attempt, Verdict]], brief: Brief, params: Params, iteration: int, cache: Path
) -> list[Attempt]:
    """Asks for a repair of each broken attempt, or for a fresh reply where its repairs are used up."""
    numbers = [attempt.number + 1 for attempt, _ in broken]
    asked = [_next_messages(attempt, verdict, brief, params) for attempt, verdict in broken]
    questions = [
        _question(
            params,
            messages,
            sample_of(brief, attempt.kind, attempt.slot, _fresh_before(number, params), params, iteration),
            Origin("validate-code", iteration, f"{attempt.kind} {attempt.slot}, attempt {number}"),
        )
        for (attempt, _), messages, number in zip(broken, asked, numbers, strict=True)
    ]
    replies = answers([attempt.kind for attempt, _ in broken], questions, params, cache)
    return [
        Attempt(attempt.kind, attempt.slot, number, messages, reply)
        for (attempt, _), number, messages, reply in zip(broken, numbers, asked, replies, strict=True)
    ]


def _check_any_left(
    attempt: Attempt, verdict: Verdict, tried: list[tuple[Attempt, Verdict]], params: Params, iteration: int
) -> None:
    number = attempt.number + 1
    if _fresh_before(number, params) > params.validate.max_fresh:
        raise NoFunctionLeft(
            f"expected a usable {attempt.kind} function for slot {attempt.slot} of iteration {iteration}, found none in "
            f"{number} replies; the last failed the check {verdict.check}: {verdict.message.rstrip('.')}. Raise "
            "validate.max_repairs or validate.max_fresh, or change the prompts or the model",
            tried,
        )


def _next_messages(attempt: Attempt, verdict: Verdict, brief: Brief, params: Params) -> tuple[Message, ...]:
    if (attempt.number + 1) % (params.validate.max_repairs + 1) == 0:
        return conversation(brief, attempt.kind, attempt.slot)
    return repair(attempt.asked, attempt.reply.text, verdict, brief.prompts)


def _fresh_before(number: int, params: Params) -> int:
    """Returns how many fresh replies came before attempt `number` and its repairs."""
    return number // (params.validate.max_repairs + 1)


def sample_of(brief: Brief, kind: Kind, slot: int, fresh: int, params: Params, iteration: int) -> int:
    """Returns which sample of its question a slot asks for, so that no two of its attempts in a run share a reply.

    A question stays the same while the winner that it refines does (ROSKA), or the parents that it breeds from (REvolve).

    Args:
        brief: of the iteration.
        kind: what is asked for.
        slot: place in the iteration.
        fresh: how many fresh replies the slot had in this iteration before.
        params: the run's parameters.
        iteration: from 1.
    """
    return slot + params.generate.candidates * (fresh + ROUNDS * _asked_before(brief, kind, slot, iteration))


def _asked_before(brief: Brief, kind: Kind, slot: int, iteration: int) -> int:
    """Returns how many earlier iterations may have asked the question of a slot."""
    if kind == "reward" and brief.breedings:
        return iteration - (2 if brief.breedings[slot].parents else 1)
    return iteration - 1 - (brief.winner["iteration"] if brief.winner else 0)


def _question(params: Params, messages: tuple[Message, ...], sample: int, origin: Origin) -> Question:
    return Question(request_of(params.llm, messages, sample), origin)


def reply_row(iteration: int, kind: str, slot: int, number: int, reply: Reply) -> Row:
    """Returns the row of the replies table for one reply."""
    return {
        "iteration": iteration,
        "kind": kind,
        "slot": slot,
        "attempt": number,
        "key": reply.key,
        "finish_reason": reply.finish_reason,
        "prompt_tokens": reply.prompt_tokens,
        "completion_tokens": reply.completion_tokens,
        "recorded_usd": reply.cost_usd,
        "answered_by": reply.answered_by,
        "text": reply.text,
    }


def verdict_row(iteration: int, attempt: Attempt, verdict: Verdict) -> Row:
    """Returns the row of the verdicts table for one attempt."""
    return {
        "iteration": iteration,
        "kind": attempt.kind,
        "slot": attempt.slot,
        "attempt": attempt.number,
        "key": attempt.reply.key,
        "passed": verdict.passed,
        "check": verdict.check,
        "line": verdict.line,
        "message": verdict.message,
        "warning": verdict.warning,
    }


def reply_of(row: Row) -> Reply:
    """Returns the reply that a row of the replies table holds."""
    return Reply(
        key=row["key"],
        text=row["text"],
        finish_reason=row["finish_reason"],
        prompt_tokens=row["prompt_tokens"],
        completion_tokens=row["completion_tokens"],
        answered_by=row["answered_by"],
        cost_usd=row["recorded_usd"],
    )
