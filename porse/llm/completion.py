"""Reads the body of a chat completion, and refuses every one that must not be recorded."""

from dataclasses import dataclass
from typing import Any

from porse.errors import ProviderError
from porse.llm.record import Answer


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

    def check_model(self, asked: str) -> None:
        """Checks that the model asked for is the one that replied; a dated snapshot of it is the same model.

        Raises:
            ProviderError: another model replied: the record would be false evidence.
        """
        if self.model and self.model != asked and not self.model.startswith(f"{asked}-"):
            raise ProviderError(
                f"expected a reply of model {asked!r}, found one of {self.model!r}; name the model in the profile as "
                "the endpoint does"
            )


def read_completion(body: Any) -> Completion:
    """Returns the one reply in the body of a chat completion.

    Raises:
        ProviderError: the body has no choice, no text, or a filtered one.
    """
    if not isinstance(body, dict):
        raise ProviderError(f"expected a chat completion, found {type(body).__name__}")
    if body.get("error"):
        raise ProviderError(f"expected a chat completion, found an error: {str(body['error'])[:200]}")
    choices = body.get("choices")
    if not isinstance(choices, list) or not choices or not isinstance(choices[0], dict):
        raise ProviderError("expected a chat completion with one choice, found none")
    finish_reason = choices[0].get("finish_reason")
    if finish_reason not in ("stop", "length"):
        raise ProviderError(f"expected finish_reason stop or length, found {finish_reason!r}")
    message = choices[0].get("message")
    text = message.get("content") if isinstance(message, dict) else None
    if not isinstance(text, str) or not text.strip():
        raise ProviderError(f"expected a reply with a text, found none (finish_reason {finish_reason})")
    check_text(text)
    answer = Answer(text, finish_reason, _tokens(body, "prompt_tokens"), _tokens(body, "completion_tokens"))
    return Completion(answer, _text(body, "model"), _text(body, "id"))


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


def _tokens(body: dict[str, Any], name: str) -> int | None:
    usage = body.get("usage")
    count = usage.get(name) if isinstance(usage, dict) else None
    return count if isinstance(count, int) and not isinstance(count, bool) and count >= 0 else None


def _text(body: dict[str, Any], name: str) -> str:
    value = body.get(name)
    return value if isinstance(value, str) else ""
