"""The recorded request that comes nearest to a missing one, and what differs: most misses are one small change."""

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from porse.errors import CacheError
from porse.identity import content_id
from porse.llm.record import Record
from porse.llm.request import Question, Request
from porse.llm.store import Store

SHORTLIST = 8
"""Entries whose texts are compared line by line; the others are ranked by their summaries alone."""

EXCERPT = 60
"""Characters shown of a line that differs."""

DIGEST_LENGTH = 16

SCALARS = ("model", "temperature", "top_p", "max_tokens", "sample", "limit", "extra")


@dataclass(frozen=True)
class Summary:
    """What is known of a record without reading it again.

    Attributes:
        key: the record's key.
        fields: values of `SCALARS`.
        messages: a digest of each message.
        origin: stage, iteration and subject.
    """

    key: str
    fields: tuple[Any, ...]
    messages: tuple[str, ...]
    origin: tuple[Any, ...]


def summarise(request: Request, origin: tuple[Any, ...]) -> Summary:
    """Returns the summary of a request asked at `origin` (stage, iteration, subject)."""
    digests = tuple(
        content_id("message", [message.role, message.content])[:DIGEST_LENGTH] for message in request.messages
    )
    return Summary(request.key, tuple(getattr(request, name) for name in SCALARS), digests, origin)


def describe_nearest(question: Question, known: Iterable[Summary], store: Store) -> str:
    """Returns a sentence on the recorded request nearest to the question, with its differences field by field."""
    nearest = find_nearest(question, known, store)
    if nearest is None:
        return "The cache holds no other record to compare it with."
    differences = "; ".join(differences_between(question.request, nearest.request)) or "nothing"
    return (
        f"The nearest recorded request to the first is {nearest.key[:12]} ({nearest.provenance.origin}), which differs "
        f"in: {differences}."
    )


def find_nearest(question: Question, known: Iterable[Summary], store: Store) -> Record | None:
    """Returns the record nearest to the question, None when there is none that can be read.

    First by how many fields, messages and parts of the origin are equal, then by the texts, then by key.
    """
    origin = question.origin
    wanted = summarise(question.request, (origin.stage, origin.iteration, origin.subject))
    shortlist = sorted(known, key=lambda summary: (-_equal_parts(wanted, summary), summary.key))[:SHORTLIST]
    records: list[Record] = []
    for summary in shortlist:
        try:
            record = store.read(summary.key)
        except CacheError:
            continue
        if record is not None:
            records.append(record)
    ranked = sorted(records, key=lambda record: (-_similarity(question.request, record.request), record.key))
    return ranked[0] if ranked else None


def differences_between(asked: Request, recorded: Request) -> list[str]:
    """Returns one phrase for each field in which two requests differ."""
    phrases = [
        f"{name}: asked {getattr(asked, name)!r}, recorded {getattr(recorded, name)!r}"
        for name in SCALARS
        if getattr(asked, name) != getattr(recorded, name)
    ]
    if len(asked.messages) != len(recorded.messages):
        phrases.append(f"messages: asked {len(asked.messages)}, recorded {len(recorded.messages)}")
    for index, (left, right) in enumerate(zip(asked.messages, recorded.messages, strict=False)):
        if left.role != right.role:
            phrases.append(f"messages[{index}].role: asked {left.role!r}, recorded {right.role!r}")
        if left.content != right.content:
            phrases.append(f"messages[{index}].content: {_text_difference(left.content, right.content)}")
    return phrases


def _text_difference(asked: str, recorded: str) -> str:
    left, right = asked.split("\n"), recorded.split("\n")
    line = _common_length(left, right)
    one, other = left[line : line + 1], right[line : line + 1]
    column = _common_length(one[0], other[0]) if one and other else 0
    return (
        f"first at line {line + 1}, asked {_excerpt(one, column)}, recorded {_excerpt(other, column)} "
        f"({len(left)} and {len(right)} lines)"
    )


def _common_length(left: Sequence[str], right: Sequence[str]) -> int:
    """Returns how many items two sequences have in common from their start."""
    pairs = enumerate(zip(left, right, strict=False))
    return next((index for index, (one, other) in pairs if one != other), min(len(left), len(right)))


def _excerpt(line: list[str], column: int) -> str:
    """Returns the part of a line around the first character that differs; no line at all is the end of the text."""
    if not line:
        return "the end"
    start = max(0, column - EXCERPT // 2)
    part = line[0][start : start + EXCERPT]
    return repr(f"{'...' if start else ''}{part}{'...' if start + EXCERPT < len(line[0]) else ''}")


def _equal_parts(wanted: Summary, other: Summary) -> int:
    fields = sum(one == two for one, two in zip(wanted.fields, other.fields, strict=True))
    messages = sum(one == two for one, two in zip(wanted.messages, other.messages, strict=False))
    origin = sum(one == two for one, two in zip(wanted.origin, other.origin, strict=True))
    return fields + 3 * messages + 2 * origin


def _similarity(asked: Request, recorded: Request) -> float:
    """Returns how alike two requests are: the texts count most, then the other fields."""
    left = [line for message in asked.messages for line in message.content.split("\n")]
    right = [line for message in recorded.messages for line in message.content.split("\n")]
    texts = difflib.SequenceMatcher(None, left, right, autojunk=False).ratio()
    equal = sum(getattr(asked, name) == getattr(recorded, name) for name in SCALARS)
    return texts + equal / (10 * len(SCALARS))
