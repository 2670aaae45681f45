"""The format of one recorded reply: request, reply and provenance in one readable JSON file.

Texts are stored as lists of lines, so that `git diff` shows what a model said line by line. The payload hash covers
everything in the file but itself, and the key is recomputed from the request at every read: an edited, truncated or
misnamed record never passes for a recorded reply.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, NoReturn

from porse.errors import CacheError, ParamsError
from porse.identity import content_id
from porse.llm.request import Origin, Request, request_from_body

TEXT_FORMAT, EMPTY_FORMAT = 1, 2
"""Versions of the file format: of a reply with a text, and of one that was cut off before its first letter."""

MOST_TOKENS = 2**53
"""A count beyond this is none: no table could hold the sum of two."""

MOST_USD_PER_MILLION = 1e9
"""A price beyond this is none: no model costs as much, and a sum of costs stays finite."""

TOKENS_PER_PRICE = 1_000_000
"""Prices are per million tokens."""


@dataclass(frozen=True)
class Price:
    """Prices at the time of recording, in US dollars."""

    usd_per_million_prompt_tokens: float
    usd_per_million_completion_tokens: float


def cost_usd(price: Price, prompt_tokens: int, completion_tokens: int) -> float:
    """Returns what so many tokens cost, in US dollars."""
    prompt = prompt_tokens * price.usd_per_million_prompt_tokens
    completion = completion_tokens * price.usd_per_million_completion_tokens
    return (prompt + completion) / TOKENS_PER_PRICE


@dataclass(frozen=True)
class Answer:
    """What was replied.

    Attributes:
        text: the reply; empty only where the limit cut it off before its first letter.
        finish_reason: "stop" or "length".
        prompt_tokens: as the endpoint counted; None when nobody counted.
        completion_tokens: as the endpoint counted; None when nobody counted.
    """

    text: str
    finish_reason: str
    prompt_tokens: int | None
    completion_tokens: int | None


@dataclass(frozen=True)
class Provenance:
    """Where a reply comes from. Nothing here ever reaches a stage's output but `answered_by` and the cost.

    Attributes:
        answered_by: the model as the endpoint named it, or who answered in what way (`answerer`).
        mode: "record", "batch" or "refresh".
        profile: name of the profile in params.yaml.
        endpoint: "profile", "override" (PORSE_LLM_BASE_URL) or "none" (answered from a file).
        request_id: the endpoint's id of the completion, "" when it gave none.
        recorded_at: UTC time of recording, ISO 8601 to the second.
        origin: the place in the run that asked first.
        price: prices at that time.
    """

    answered_by: str
    mode: str
    profile: str
    endpoint: str
    request_id: str
    recorded_at: str
    origin: Origin
    price: Price


CONTEXTS = {
    "fresh": "one fresh context per reply",
    "shared": "several replies in one context",
    "unknown": "contexts unknown",
}
"""What an answerer had seen before each reply: nothing but its question, other questions and replies, or nobody knows."""


def answerer(who: str, way: str, context: str, is_api_model: bool) -> str:
    """Returns how provenance names whoever answered without an endpoint of ours.

    Args:
        who: "a language model, offline", say.
        way: how the answers came, "batch mode" say.
        context: a key of `CONTEXTS`.
        is_api_model: whether the answers come from a model behind a public API.
    """
    return f"{who}, through {way}, {CONTEXTS[context]}; {'an' if is_api_model else 'not an'} API model"


def utc_now() -> str:
    """Returns the time in UTC, ISO 8601, to the second: for provenance, no stage ever writes it."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True)
class Record:
    """One recorded reply."""

    request: Request
    answer: Answer
    provenance: Provenance

    @property
    def key(self) -> str:
        """The request's key."""
        return self.request.key

    @property
    def truncated(self) -> bool:
        """Whether the reply was cut off by its limit."""
        return self.answer.finish_reason == "length"

    @property
    def cost_usd(self) -> float:
        """The cost in US dollars, by the recorded prices; uncounted tokens cost nothing."""
        answer = self.answer
        return cost_usd(self.provenance.price, answer.prompt_tokens or 0, answer.completion_tokens or 0)

    def render(self) -> bytes:
        """Returns the bytes of the record's file."""
        payload = self._payload()
        document = {**payload, "payload_hash": content_id("record", payload)}
        return (json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False) + "\n").encode()

    def _payload(self) -> dict[str, Any]:
        request = self.request.body()
        messages = [{**message, "content": message["content"].split("\n")} for message in request["messages"]]
        text = self.answer.text
        return {
            "format": TEXT_FORMAT if text else EMPTY_FORMAT,
            "key": self.key,
            "request": {**request, "messages": messages},
            "reply": {**asdict(self.answer), "text": text.split("\n") if text else []},
            "provenance": asdict(self.provenance),
        }


def parse_record(data: bytes, key: str, where: str) -> Record:
    """Returns the record in `data` after recomputing its key, its payload hash and its bytes.

    Args:
        data: bytes of a record file.
        key: the key that the file's name claims.
        where: the file's name, for messages.

    Raises:
        CacheError: the bytes are not those that the program writes for a record of that key.
    """
    document = _parse_json(data, where)
    found_hash = document.pop("payload_hash", None)
    expected_hash = _payload_hash(document, where)
    if found_hash != expected_hash:
        _refuse(where, f"payload hash {expected_hash[:12]}", f"{str(found_hash)[:12]}: the file was edited")
    if document.get("format") not in (TEXT_FORMAT, EMPTY_FORMAT):
        _refuse(where, f"format {TEXT_FORMAT} or {EMPTY_FORMAT}", f"format {document.get('format')!r}")
    record = _build(document, where)
    if document["key"] != record.key:
        _refuse(where, f"key {record.key[:12]} by its request", f"key {str(document['key'])[:12]}")
    if record.key != key:
        _refuse(where, f"the record of key {key[:12]}", f"the record of {record.key[:12]}: the file is misnamed")
    # A field that stands twice, `true` for 1, a line with a break in it: other bytes that say the same.
    if record.render() != data:
        _refuse(where, "the very bytes that the program writes", "another layout of the same record")
    return record


def _parse_json(data: bytes, where: str) -> dict[str, Any]:
    try:
        document = json.loads(data.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        _refuse(where, "a JSON record", f"{len(data)} bytes that do not parse ({error})")
    if not isinstance(document, dict):
        _refuse(where, "a JSON record", f"a {type(document).__name__}")
    return document


def _payload_hash(document: dict[str, Any], where: str) -> str:
    try:
        return content_id("record", document)
    except (ValueError, RecursionError) as error:
        # A number beyond any float or half of a surrogate pair: JSON can spell them, no record holds them.
        _refuse(where, "values that a record can hold", str(error))


def _build(document: dict[str, Any], where: str) -> Record:
    """Builds the dataclasses; the payload hash was right, so a failure here means another program wrote the file."""
    try:
        expected = {"format", "key", "request", "reply", "provenance"}
        if set(document) != expected:
            _refuse(where, f"the fields {sorted(expected)}", str(sorted(document)))
        request = dict(document["request"])
        request["messages"] = [{**item, "content": _text(item["content"])} for item in request["messages"]]
        reply = dict(document["reply"])
        reply["text"] = _text(reply["text"])
        provenance = dict(document["provenance"])
        provenance["origin"] = Origin(**provenance["origin"])
        provenance["price"] = Price(**provenance["price"])
        record = Record(request_from_body(request), Answer(**reply), Provenance(**provenance))
    except (KeyError, TypeError, ValueError, ParamsError) as error:
        raise CacheError(_message(where, f"a record of format {document['format']}", repr(error))) from error
    _check_values(record, document["format"], where)
    return record


def _check_values(record: Record, version: int, where: str) -> None:
    """Refuses what no endpoint, and no command of ours, can have given."""
    answer, provenance = record.answer, record.provenance
    origin, price = provenance.origin, provenance.price
    named = [
        ("finish_reason", answer.finish_reason, "stop or length", _is_one_of("stop", "length")),
        ("prompt_tokens", answer.prompt_tokens, "a count or null", is_token_count),
        ("completion_tokens", answer.completion_tokens, "a count or null", is_token_count),
        ("answered_by", provenance.answered_by, "a text", _is_text),
        ("mode", provenance.mode, "record, batch or refresh", _is_one_of("record", "batch", "refresh")),
        ("profile", provenance.profile, "a text", _is_text),
        ("endpoint", provenance.endpoint, "profile, override or none", _is_one_of("profile", "override", "none")),
        ("request_id", provenance.request_id, "a text", _is_text),
        ("recorded_at", provenance.recorded_at, "a text", _is_text),
        ("stage", origin.stage, "a text", _is_text),
        ("iteration", origin.iteration, "a count", lambda value: value is not None and is_token_count(value)),
        ("subject", origin.subject, "a text", _is_text),
        ("usd_per_million_prompt_tokens", price.usd_per_million_prompt_tokens, "a price", _is_price),
        ("usd_per_million_completion_tokens", price.usd_per_million_completion_tokens, "a price", _is_price),
    ]
    for name, value, expected, holds in named:
        if not holds(value):
            _refuse(where, f"{name} to be {expected}", repr(value)[:80])
    empty = answer.text == ""
    if empty != (version == EMPTY_FORMAT) or (empty and not record.truncated):
        _refuse(where, f"a text, or in format {EMPTY_FORMAT} a reply cut off before its first letter", "another reply")


def is_token_count(value: object) -> bool:
    """Returns whether a value is a count of tokens that a table can hold, or null."""
    return value is None or (isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MOST_TOKENS)


def _is_price(value: object) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and 0 <= value <= MOST_USD_PER_MILLION  # type: ignore[operator]


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_one_of(*words: str) -> Callable[[object], bool]:
    return lambda value: isinstance(value, str) and value in words


def _text(lines: Any) -> str:
    if not isinstance(lines, list) or not all(isinstance(line, str) for line in lines):
        raise TypeError(f"a text is a list of lines, and not {repr(lines)[:80]}")
    return "\n".join(lines)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")


def _refuse(where: str, expected: str, found: str) -> NoReturn:
    raise CacheError(_message(where, expected, found))


def _message(where: str, expected: str, found: str) -> str:
    return (
        f"The recorded reply {where} cannot be trusted: expected {expected}, found {found}. Restore the file from git "
        f"(`git checkout -- {where}`), or delete it and record the reply again."
    )
