"""Reads what an endpoint says: a completion, or an error, and whether another attempt can help.

Endpoints that speak OpenAI's protocol differ in everything that the protocol leaves open. What can be read without doubt
is read; what must not be recorded (no text, filtered, another model's) is refused.
"""

import json
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from porse.errors import ProviderError
from porse.llm.record import Answer, is_token_count

FINISH_REASONS = {
    "stop": ("stop", "eos", "eos_token", "end_turn", "stop_sequence", "end", "complete", "completed"),
    "length": ("length", "max_tokens", "max_output_tokens", "max_completion_tokens", "model_length"),
}
"""What a record says, and what endpoints call it, in any letter case."""

RETRIED_STATUS = frozenset({408, 409, 425, 429})
"""These and all from 500 are tried again."""

STATUS_OF_CODE = {
    "invalid_api_key": 401,
    "authentication_error": 401,
    "permission_error": 403,
    "timeout": 408,
    "rate_limit_exceeded": 429,
    "rate_limit_error": 429,
    "server_error": 500,
    "internal_server_error": 500,
    "api_error": 500,
    "overloaded": 503,
    "overloaded_error": 503,
}
"""The status that an error inside a reply of status 200 has, when it is named and not numbered."""

HARD_QUOTA_CODES = frozenset(
    {"insufficient_quota", "billing_hard_limit_reached", "billing_not_active", "insufficient_balance"}
)
"""What waiting does not mend. A quota of so much a minute has other names, `quota_exceeded` among them."""

SHOWN_CHARACTERS = 300

DIALECT_WORDS = re.compile(r"max_tokens|max_completion_tokens|temperature|top_p|unsupported parameter", re.IGNORECASE)

_DATE = re.compile(
    r"[-@](?:"
    r"20\d\d-?(?:0[1-9]|1[0-2])-?(?:0[1-9]|[12]\d|3[01])"  # 2024-07-18, 20240718
    r"|(?:0[1-9]|1[0-2])-?(?:0[1-9]|[12]\d|3[01])"  # 0613, 06-13
    r"|(?:0[1-9]|1[0-2])-20\d\d"  # 08-2024
    r"|2\d(?:0[1-9]|1[0-2])"  # 2411
    r")"
)


class HopelessError(ProviderError):
    """No other request can succeed either: a refused key, an exhausted quota, a spent budget."""


class RetriableError(Exception):
    """An attempt failed in a way that another attempt may not.

    Attributes:
        retry_after_s: how long the server asked to wait, None when it did not say.
    """

    def __init__(self, reason: str, retry_after_s: float | None = None) -> None:
        super().__init__(reason)
        self.retry_after_s = retry_after_s


@dataclass(eq=False)
class EndpointError(Exception):
    """An error that an endpoint reported, by its status or inside a reply of status 200.

    Attributes:
        status: the HTTP status, or the one that the error inside names; 0 when it names none.
        code: the endpoint's word for the error, "" when it has none.
        message: its text, on one line.
    """

    status: int
    code: str
    message: str

    def __str__(self) -> str:
        """Returns the error in words."""
        status = f"status {self.status}" if self.status else "an error"
        return f"{status}: {self.message[:SHOWN_CHARACTERS]}"

    def judged(self, retry_after_s: float | None) -> Exception:
        """Returns what the error means for this request and for the others."""
        if self.status == 402 or self.code in HARD_QUOTA_CODES:
            return HopelessError(f"the quota is exhausted, {self}")
        if self.status in (401, 403):
            return HopelessError(f"the API key was refused, {self}")
        if self.status in RETRIED_STATUS or self.status >= 500:
            return RetriableError(str(self), retry_after_s)
        hint = ""
        if self.status in (400, 422) and DIALECT_WORDS.search(self.message):
            hint = "; what a model calls its limit and which parameters it refuses, say `limit` and `leave_out` of its profile"
        return ProviderError(f"{self}{hint}")


@dataclass(frozen=True)
class Completion:
    """A usable reply as it came from an endpoint.

    Attributes:
        answer: text, finish reason and token counts.
        model: the model as the endpoint names it, "" when it does not.
        request_id: the endpoint's id of the completion, "" when it gave none.
    """

    answer: Answer
    model: str
    request_id: str

    def check_model(self, asked: str, aliases: Collection[str]) -> None:
        """Checks that the model asked for is the one that replied: by name, as a dated snapshot, or under an alias.

        Raises:
            ProviderError: another model replied: the record would be false evidence.
        """
        if self.model in ("", asked, *aliases):
            return
        if self.model.startswith(asked) and _DATE.fullmatch(self.model[len(asked) :]):
            return
        raise ProviderError(
            f"expected a reply of model {asked!r}, found one of {self.model!r}; if that is the same model, list this name "
            "under `aliases` of the profile"
        )


def parse_body(body: bytes) -> Any:
    """Returns the JSON in a body, without what servers put around it: comments and marks of an event stream.

    Raises:
        ProviderError: there is no JSON, or more than one value.
    """
    try:
        text = body.decode("utf-8-sig").lstrip()
        while text.startswith((":", "event:", "id:", "retry:")):
            text = text.partition("\n")[2].lstrip()
        text = text.removeprefix("data:").lstrip()
        document, end = json.JSONDecoder().raw_decode(text)
        rest = [line for line in text[end:].split("\n") if line.strip() and not line.startswith(":")]
        if [line.strip() for line in rest] not in ([], ["data: [DONE]"], ["data:[DONE]"]):
            raise ValueError("more than one value")
    except (ValueError, RecursionError) as error:
        raise ProviderError(f"expected a JSON body, found {len(body)} bytes that do not parse") from error
    return document


def read_completion(body: Any) -> Completion:
    """Returns the one reply in the body of a chat completion.

    Raises:
        EndpointError: the body reports an error.
        ProviderError: the body has no choice, no text, or a filtered one.
    """
    if not isinstance(body, dict):
        raise ProviderError(f"expected a chat completion, found {type(body).__name__}")
    if body.get("error"):
        raise read_error(0, body)
    choices = body.get("choices")
    if not isinstance(choices, list) or not choices or not isinstance(choices[0], dict):
        raise ProviderError("expected a chat completion with one choice, found none")
    choice = choices[0]
    if choice.get("error") or choice.get("finish_reason") == "error":
        raise read_error(0, choice, default_status=500)
    message = choice.get("message")
    text = _content(message.get("content") if isinstance(message, dict) else None)
    finish_reason = _finish_reason(choice.get("finish_reason"))
    if not text.strip():
        if finish_reason != "length":
            raise ProviderError(f"expected a reply with a text, found none (finish_reason {finish_reason})")
        # The model thought until its limit was reached: cut off before the first letter.
        text = ""
    check_text(text)
    answer = Answer(text, finish_reason, *token_counts(body))
    return Completion(answer, _word(body, "model"), _word(body, "id"))


def token_counts(body: Any) -> tuple[int | None, int | None]:
    """Returns the prompt and completion tokens that a body counts, None for what it does not count."""
    usage = body.get("usage") if isinstance(body, dict) else None
    counts = usage if isinstance(usage, dict) else {}
    prompt, completion = counts.get("prompt_tokens"), counts.get("completion_tokens")
    return (prompt if is_token_count(prompt) else None), (completion if is_token_count(completion) else None)


def read_error(status: int, body: Any, default_status: int = 0) -> EndpointError:
    """Returns the error in a parsed body, in whichever of the known forms it has.

    Args:
        status: the HTTP status; 0 where the error came inside a reply of status 200.
        body: what was parsed, or the text that did not parse.
        default_status: the status of an error that names none.
    """
    document = body[0] if isinstance(body, list) and body else body
    error = document.get("error") or document if isinstance(document, Mapping) else document
    if not isinstance(error, Mapping):
        return EndpointError(status or default_status, "", _one_line(error))
    words = [str(error[name]) for name in ("code", "type", "status") if isinstance(error.get(name), str | int)]
    code = next((word for word in words if word in HARD_QUOTA_CODES or word in STATUS_OF_CODE), "")
    numbers = [int(word) for word in words if re.fullmatch(r"[1-5]\d\d", word)]
    named = numbers[0] if numbers else STATUS_OF_CODE.get(code, default_status)
    # Some name the text otherwise, and some have none.
    texts = [error[name] for name in ("message", "detail", "error") if error.get(name)]
    return EndpointError(status or named, code, _one_line(texts[0] if texts else document))


def check_text(text: str) -> None:
    """Checks that a file can hold the reply.

    Raises:
        ProviderError: the reply holds half of a surrogate pair.
    """
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise ProviderError(
            f"expected a reply that UTF-8 can store, found {error.object[error.start]!r} in it"
        ) from error


def _content(content: Any) -> str:
    """Returns the text of a message: itself, or its parts without those that only show how the model thought."""
    if not isinstance(content, list):
        return content if isinstance(content, str) else ""
    texts: list[str] = []
    for part in content:
        kind = part.get("type", "text") if isinstance(part, dict) else "text"
        text = part.get("text") if isinstance(part, dict) else part
        if kind in ("text", "output_text") and isinstance(text, str):
            texts.append(text)
        elif kind not in ("thinking", "reasoning", "redacted_thinking"):
            raise ProviderError(f"expected a reply of texts, found a part of type {kind!r}")
    return "".join(texts)


def _finish_reason(found: Any) -> str:
    if found is None:
        return "stop"
    for reason, names in FINISH_REASONS.items():
        if isinstance(found, str) and found.lower() in names:
            return reason
    raise ProviderError(f"expected finish_reason stop or length, found {found!r}")


def _one_line(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
    return " ".join(text.split())


def _word(body: dict[str, Any], name: str) -> str:
    value = body.get(name)
    return value if isinstance(value, str) else ""
