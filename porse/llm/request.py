"""What is asked of a model, where in the run it is asked, and what comes back.

The key of a request is the hash of everything that the model sees and of every sampling field. Transport (endpoint,
API key, time-outs, retries) and the place in the run (`Origin`) stay out of it: they do not change what is asked.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, get_args

from porse.config import LlmParams
from porse.errors import ParamsError
from porse.identity import content_id
from porse.printing import visible

PLAIN_SCHEMA, DIALECT_SCHEMA = 1, 2
"""Versions of the request body: of a request in the common protocol, and of one in a model's dialect.

The version is part of the body and so of the key. What needs no dialect keeps version 1, and its key, for ever.
"""

PLAIN_LIMIT = "max_tokens"
"""What the common protocol calls the limit on a reply."""

OWN_FIELDS = frozenset({"model", "messages", "temperature", "top_p", "max_tokens", "stream", "n"})
"""What no extra field may name: a request has fields of its own for these, one reply, and no stream."""

LONGER_FACTOR = 2
"""A truncated reply is asked for once more with this many times the limit on its length."""

Role = Literal["system", "user", "assistant"]


@dataclass(frozen=True)
class Message:
    """One message of a conversation."""

    role: Role
    content: str


@dataclass(frozen=True)
class Request:
    """One request for one reply.

    Attributes:
        model: the model's name, as the endpoint knows it.
        messages: the conversation, at least one message.
        temperature: sampling temperature, in [0, 2]; None where the model takes none.
        top_p: nucleus sampling mass, in (0, 1]; None where the model takes none.
        max_tokens: limit on the reply's length, in tokens.
        sample: index of the sample, 0 and up: K samples of one prompt are K requests with K keys.
        limit: what the model calls `max_tokens`.
        extra: further fields that are sent as they are, JSON values by name.
    """

    model: str
    messages: tuple[Message, ...]
    temperature: float | None
    top_p: float | None
    max_tokens: int
    sample: int
    limit: str = PLAIN_LIMIT
    extra: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks every field.

        Raises:
            ParamsError: a field is out of its range or of the wrong type.
        """
        _check(isinstance(self.model, str) and self.model != "", "model", "a name", self.model)
        _check(len(self.messages) > 0, "messages", "at least one message", self.messages)
        for message in self.messages:
            _check(message.role in get_args(Role), "role", " or ".join(get_args(Role)), message.role)
            _check(isinstance(message.content, str), "content", "a text", message.content)
        heat, mass = self.temperature, self.top_p
        _check(heat is None or (_is_number(heat) and 0 <= heat <= 2), "temperature", "0 to 2", heat)
        _check(mass is None or (_is_number(mass) and 0 < mass <= 1), "top_p", "above 0, at most 1", mass)
        _check(_is_count(self.max_tokens) and self.max_tokens >= 1, "max_tokens", "a count from 1", self.max_tokens)
        _check(_is_count(self.sample) and self.sample >= 0, "sample", "an index from 0", self.sample)
        _check(isinstance(self.limit, str) and self.limit != "", "limit", "a name", self.limit)
        _check(isinstance(self.extra, Mapping), "extra", "JSON values by name", self.extra)
        clash = sorted((OWN_FIELDS | {self.limit}) & set(self.extra))
        _check(not clash, "extra", "free of the fields that have a place of their own", ", ".join(clash))
        own = self.limit != PLAIN_LIMIT and self.limit in OWN_FIELDS
        _check(not own, "limit", "a name that no other field has", self.limit)

    @property
    def is_plain(self) -> bool:
        """Whether the request is in the common protocol, without any dialect."""
        sampled = self.temperature is not None and self.top_p is not None
        return sampled and self.limit == PLAIN_LIMIT and not self.extra

    def body(self) -> dict[str, Any]:
        """Returns the canonical body: all that the key depends on, the schema version among it."""
        # The sum turns -0.0 into 0.0 and an int into a float, so that equal numbers give one key.
        sampling = {"temperature": self.temperature, "top_p": self.top_p}
        return {
            "schema": PLAIN_SCHEMA if self.is_plain else DIALECT_SCHEMA,
            "model": self.model,
            "messages": [{"role": message.role, "content": message.content} for message in self.messages],
            **{name: value + 0.0 for name, value in sampling.items() if value is not None},
            "max_tokens": self.max_tokens,
            "sample": self.sample,
            **({} if self.is_plain else {"limit": self.limit, "extra": dict(self.extra)}),
        }

    def wire_body(self) -> dict[str, Any]:
        """Returns what is sent to an endpoint: the canonical body without what only the key needs, in the dialect."""
        body = {
            name: value for name, value in self.body().items() if name not in ("schema", "sample", "limit", "extra")
        }
        body[self.limit] = body.pop(PLAIN_LIMIT)
        return {**body, **self.extra}

    @cached_property
    def key(self) -> str:
        """The request's key: 64 hexadecimal digits, the content id of `body()`.

        Raises:
            ParamsError: a text holds a lone surrogate, which no UTF-8 file can store.
        """
        try:
            return content_id("request", self.body())
        except UnicodeEncodeError as error:
            raise ParamsError(
                f"Expected messages that UTF-8 can store, found the character {error.object[error.start]!r} in a "
                "message. Remove it from the prompt or from the reply that the prompt quotes."
            ) from error

    def longer(self) -> "Request":
        """Returns the request that repairs a truncated reply: the same with `LONGER_FACTOR` times the limit."""
        return replace(self, max_tokens=self.max_tokens * LONGER_FACTOR)


def request_of(llm: LlmParams, messages: tuple[Message, ...], sample: int) -> Request:
    """Returns the request of a conversation to the chosen profile's model, in its dialect."""
    profile = llm.profiles[llm.profile]
    return Request(
        model=profile.model,
        messages=messages,
        temperature=None if "temperature" in profile.leave_out else llm.temperature,
        top_p=None if "top_p" in profile.leave_out else llm.top_p,
        max_tokens=llm.max_tokens,
        sample=sample,
        limit=profile.limit,
        extra=profile.extra,
    )


def request_from_body(body: Mapping[str, Any]) -> Request:
    """Returns the request of a canonical body.

    Raises:
        ParamsError: a field has a value that no request may have, or the schema is of another version.
        KeyError, TypeError: the body has other fields than a body has.
    """
    fields = dict(body)
    schema = fields.pop("schema")
    known = _is_count(schema) and schema in (PLAIN_SCHEMA, DIALECT_SCHEMA)
    _check(known, "schema", f"{PLAIN_SCHEMA} or {DIALECT_SCHEMA}", schema)
    messages = tuple(Message(**message) for message in fields.pop("messages"))
    if schema == DIALECT_SCHEMA:
        fields = {"temperature": None, "top_p": None, "limit": None, "extra": None, **fields}
    request = Request(messages=messages, **fields)
    _check(request.body()["schema"] == schema, "schema", f"{request.body()['schema']} for what it says", schema)
    return request


@dataclass(frozen=True)
class Origin:
    """Where in a run a request is asked: for messages, statistics and progress, never part of the key.

    Attributes:
        stage: the stage's name, "generate" say.
        iteration: 1 and up.
        subject: what the reply is for, in the stage's words: "reward 3".
    """

    stage: str
    iteration: int
    subject: str

    def __str__(self) -> str:
        """Returns the place in words, on one line, for messages."""
        return visible(f"{self.stage}, iteration {self.iteration}, {self.subject}", keep="")


@dataclass(frozen=True)
class Question:
    """A request and where it is asked."""

    request: Request
    origin: Origin


@dataclass(frozen=True)
class Reply:
    """What the search gets back for one question.

    When a truncated reply was asked for once more, this is the second reply, and the tokens and the cost are those of
    both.

    Attributes:
        key: key of the recorded reply.
        text: the reply.
        finish_reason: "stop", or "length" when even the longer reply was cut off.
        prompt_tokens: tokens read by the model; 0 when nobody counted them (answered from a file).
        completion_tokens: tokens written by the model; 0 when nobody counted them.
        answered_by: the model as the endpoint named it, or who answered in what way.
        cost_usd: cost in US dollars, by the prices at the time of recording; the same on every replay.
    """

    key: str
    text: str
    finish_reason: str
    prompt_tokens: int
    completion_tokens: int
    answered_by: str
    cost_usd: float


def _is_number(value: object) -> bool:
    # Compared: an int may be beyond any float, and nan is between no two numbers.
    return isinstance(value, int | float) and not isinstance(value, bool) and -math.inf < value < math.inf


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _check(holds: bool, field: str, expected: str, found: object) -> None:
    if not holds:
        raise ParamsError(
            f"Expected {field} of a request to be {expected}, found {found!r}. Correct the llm section of params.yaml "
            "or the code that composes the request."
        )
