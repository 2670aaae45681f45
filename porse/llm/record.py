"""The format of one recorded reply: request, reply and provenance in one readable JSON file.

Texts are stored as lists of lines, so that `git diff` shows what a model said line by line. The payload hash covers
everything in the file but itself, and the key is recomputed from the request at every read: an edited, truncated or
misnamed record never passes for a recorded reply.
"""

import json
from dataclasses import asdict, dataclass
from typing import Any, NoReturn

from porse.errors import CacheError, ParamsError
from porse.identity import content_id
from porse.llm.request import Origin, Request, request_from_body

RECORD_FORMAT = 1
"""Version of the file format. A reader refuses any other."""

TOKENS_PER_PRICE = 1_000_000
"""Prices are per million tokens."""


@dataclass(frozen=True)
class Price:
    """Prices at the time of recording, in US dollars."""

    usd_per_million_prompt_tokens: float
    usd_per_million_completion_tokens: float


@dataclass(frozen=True)
class Answer:
    """What a model, or a person, replied.

    Attributes:
        text: the reply, never empty.
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
        answered_by: the model as the endpoint named it, or who answered by hand.
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
        price = self.provenance.price
        prompt = (self.answer.prompt_tokens or 0) * price.usd_per_million_prompt_tokens
        completion = (self.answer.completion_tokens or 0) * price.usd_per_million_completion_tokens
        return (prompt + completion) / TOKENS_PER_PRICE

    def render(self) -> bytes:
        """Returns the bytes of the record's file."""
        payload = self._payload()
        document = {**payload, "payload_hash": content_id("record", payload)}
        return (json.dumps(document, indent=2, sort_keys=True, ensure_ascii=False) + "\n").encode()

    def _payload(self) -> dict[str, Any]:
        request = self.request.body()
        messages = [{**message, "content": message["content"].split("\n")} for message in request["messages"]]
        return {
            "format": RECORD_FORMAT,
            "key": self.key,
            "request": {**request, "messages": messages},
            "reply": {**asdict(self.answer), "text": self.answer.text.split("\n")},
            "provenance": asdict(self.provenance),
        }


def parse_record(data: bytes, key: str, where: str) -> Record:
    """Returns the record in `data` after recomputing its key and its payload hash.

    Args:
        data: bytes of a record file.
        key: the key that the file's name claims.
        where: the file's name, for messages.

    Raises:
        CacheError: the bytes are not a whole, unedited record of that key.
    """
    document = _parse_json(data, where)
    found_hash = document.pop("payload_hash", None)
    expected_hash = _payload_hash(document, where)
    if found_hash != expected_hash:
        _refuse(where, f"payload hash {expected_hash[:12]}", f"{str(found_hash)[:12]}: the file was edited")
    if document.get("format") != RECORD_FORMAT:
        _refuse(where, f"format {RECORD_FORMAT}", f"format {document.get('format')!r}")
    record = _build(document, where)
    if document["key"] != record.key:
        _refuse(where, f"key {record.key[:12]} by its request", f"key {str(document['key'])[:12]}")
    if record.key != key:
        _refuse(where, f"the record of key {key[:12]}", f"the record of {record.key[:12]}: the file is misnamed")
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
        request = dict(document["request"])
        request["messages"] = [{**item, "content": "\n".join(item["content"])} for item in request["messages"]]
        reply = dict(document["reply"])
        reply["text"] = "\n".join(reply["text"])
        provenance = dict(document["provenance"])
        provenance["origin"] = Origin(**provenance["origin"])
        provenance["price"] = Price(**provenance["price"])
        expected = {"format", "key", "request", "reply", "provenance"}
        if set(document) != expected:
            _refuse(where, f"the fields {sorted(expected)}", str(sorted(document)))
        return Record(request_from_body(request), Answer(**reply), Provenance(**provenance))
    except (KeyError, TypeError, ParamsError) as error:
        raise CacheError(_message(where, f"a record of format {RECORD_FORMAT}", repr(error))) from error


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a JSON number")


def _refuse(where: str, expected: str, found: str) -> NoReturn:
    raise CacheError(_message(where, expected, found))


def _message(where: str, expected: str, found: str) -> str:
    return (
        f"The recorded reply {where} cannot be trusted: expected {expected}, found {found}. Restore the file from git "
        f"(`git checkout -- {where}`), or delete it and record the reply again."
    )
