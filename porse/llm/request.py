"""What is asked of a model, where in the run it is asked, and what comes back.

The key of a request is the hash of everything that the model sees and of every sampling field. Transport (endpoint,
API key, time-outs, retries) and the place in the run (`Origin`) stay out of it: they do not change what is asked.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, get_args

from porse.errors import ParamsError
from porse.identity import content_id

REQUEST_SCHEMA = 1
"""Version of the request body. It is part of the body, so a new version gives every request a new key."""

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
        temperature: sampling temperature, in [0, 2].
        top_p: nucleus sampling mass, in (0, 1].
        max_tokens: limit on the reply's length, in tokens.
        sample: index of the sample, 0 and up: K samples of one prompt are K requests with K keys.
    """

    model: str
    messages: tuple[Message, ...]
    temperature: float
    top_p: float
    max_tokens: int
    sample: int

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
        _check(_is_number(self.temperature) and 0 <= self.temperature <= 2, "temperature", "0 to 2", self.temperature)
        _check(_is_number(self.top_p) and 0 < self.top_p <= 1, "top_p", "above 0, at most 1", self.top_p)
        _check(_is_count(self.max_tokens) and self.max_tokens >= 1, "max_tokens", "a count from 1", self.max_tokens)
        _check(_is_count(self.sample) and self.sample >= 0, "sample", "an index from 0", self.sample)

    def body(self) -> dict[str, Any]:
        """Returns the canonical body: all that the key depends on, the schema version among it."""
        return {
            "schema": REQUEST_SCHEMA,
            "model": self.model,
            "messages": [{"role": message.role, "content": message.content} for message in self.messages],
            # The sum turns -0.0 into 0.0 and an int into a float, so that equal numbers give one key.
            "temperature": self.temperature + 0.0,
            "top_p": self.top_p + 0.0,
            "max_tokens": self.max_tokens,
            "sample": self.sample,
        }

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


def request_from_body(body: Mapping[str, Any]) -> Request:
    """Returns the request of a canonical body.

    Raises:
        ParamsError: a field has a value that no request may have, or the schema is of another version.
        KeyError, TypeError: the body has other fields than a body has.
    """
    fields = dict(body)
    schema = fields.pop("schema")
    _check(schema == REQUEST_SCHEMA, "schema", str(REQUEST_SCHEMA), schema)
    messages = tuple(Message(**message) for message in fields.pop("messages"))
    return Request(messages=messages, **fields)


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
        """Returns the place in words, for messages."""
        return f"{self.stage}, iteration {self.iteration}, {self.subject}"


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
        prompt_tokens: tokens read by the model; 0 when nobody counted them (a person answered).
        completion_tokens: tokens written by the model; 0 when nobody counted them.
        answered_by: the model as the endpoint named it, or who answered by hand.
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
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _check(holds: bool, field: str, expected: str, found: object) -> None:
    if not holds:
        raise ParamsError(
            f"Expected {field} of a request to be {expected}, found {found!r}. Correct the llm section of params.yaml "
            "or the code that composes the request."
        )
