"""Batch mode's files: open requests out, answers in, accepted whole or not at all.

Out goes OpenAI's batch format, one request a line. In come that format's output lines, or lines that are written with
ease: `{"custom_id": KEY, "text": "..."}`, `text` being a text or a list of lines.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from porse.errors import AnswersError, ProviderError
from porse.llm.completion import Completion, EndpointError, check_text, read_completion, read_error
from porse.llm.pending import OpenRequest, remove_pending
from porse.llm.record import Answer, Provenance, Record, answerer, utc_now
from porse.llm.store import KEY_PATTERN, Store

BATCH_URL = "/v1/chat/completions"


@dataclass(frozen=True)
class Answerer:
    """Who answered a file of requests, as the records will say.

    Attributes:
        who: "a language model, offline", say.
        context: what it had seen before each reply, a key of `porse.llm.record.CONTEXTS`.
        is_api_model: whether it is a model behind a public API.
    """

    who: str
    context: str
    is_api_model: bool

    def of(self, model: str) -> str:
        """Returns the text for one reply; `model` is what the reply itself names, "" for none."""
        who = self.who.strip()
        return answerer(f"{model} by {who}" if model else who, "batch mode", self.context, self.is_api_model)


@dataclass(frozen=True)
class Accepted:
    """One line of an import's report.

    Attributes:
        record: the record made of the answer.
        fresh: False when the very same answer was recorded before.
    """

    record: Record
    fresh: bool


def export_lines(requests: Iterable[OpenRequest]) -> str:
    """Returns the open requests as OpenAI batch JSONL, one line each, in ASCII: a terminal may be where they go."""
    lines = [
        json.dumps(
            {
                "custom_id": request.key,
                "method": "POST",
                "url": BATCH_URL,
                "body": request.question.request.wire_body(),
            }
        )
        for request in requests
    ]
    return "".join(line + "\n" for line in lines)


def answer_lines(source: Path) -> list[tuple[str, str]]:
    """Returns the answers in a JSONL file, or in a directory of texts named `<key>.md` or `<key>.txt`.

    Returns:
        One pair for each answer: a label for messages, "line 3" or the text's name, and a line of JSON.

    Raises:
        AnswersError: the source cannot be read as UTF-8, or is a directory without such a text.
    """
    if source.is_dir():
        paths = sorted(path for path in source.iterdir() if path.suffix in (".md", ".txt"))
        if not paths:
            raise AnswersError(
                f"Expected texts named <key>.md or <key>.txt in the directory {source}, found none. Nothing was recorded: "
                "name the directory of the answers, or a JSONL file."
            )
        return [(path.name, json.dumps({"custom_id": path.stem, "text": answer_text(path)})) for path in paths]
    lines = enumerate(answer_text(source).split("\n"), start=1)
    return [(f"line {number}", line) for number, line in lines if line.strip()]


def answer_text(path: Path) -> str:
    """Returns the text in a file, without the byte order mark and the last newline that editors add.

    Raises:
        AnswersError: the file cannot be read as UTF-8.
    """
    try:
        # Some editors put a mark at the start and a newline at the end.
        return path.read_bytes().decode("utf-8-sig").removesuffix("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise AnswersError(f"Expected UTF-8 in {path}, found: {error}. Nothing was recorded.") from error


def import_answers(
    lines: list[tuple[str, str]], where: str, answered_by: Answerer, requests: Iterable[OpenRequest], store: Store
) -> list[Accepted]:
    """Records all the answers or none; returns them in their order.

    Args:
        lines: labels and lines of JSON, one answer each.
        where: the name of the file or directory, for messages.
        answered_by: who answered, for the records' provenance.
        requests: the open requests.
        store: where the answers are recorded.

    Raises:
        AnswersError: a line is no answer, its id is not open, stands twice, or is recorded with another reply; every
            such line is named.
    """
    if not answered_by.who.strip():
        raise AnswersError("Expected a text that says who answered, found none. Pass it by `--answered-by TEXT`.")
    known = {request.key: request for request in requests}
    accepted: list[Accepted] = []
    problems: list[str] = []
    labels: dict[str, str] = {}
    for label, line in lines:
        try:
            key, answer = _parse_line(line)
            if key in labels:
                raise ValueError(f"id {key[:12]} stands in {labels[key]} already")
            labels[key] = label
            accepted.append(_accept(key, answer, answered_by, known, store))
        except (ValueError, ProviderError, EndpointError) as error:
            problems.append(f"{label}: {error}")
    if not lines:
        problems.append("no answer at all")
    if problems:
        raise AnswersError(
            f"Expected one answer to one open request in every line of {where}, found {len(problems)} wrong: "
            f"{'; '.join(problems)}. Nothing was recorded: correct these lines and import the file again."
        )
    store.write_all([item.record for item in accepted])
    remove_pending(store, [item.record.key for item in accepted])
    return accepted


def _parse_line(line: str) -> tuple[str, Completion]:
    try:
        document = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"expected JSON, found text that does not parse ({error})") from error
    key = document.get("custom_id") if isinstance(document, dict) else None
    if not isinstance(key, str):
        raise ValueError("expected an object with a custom_id, found none")
    if not KEY_PATTERN.fullmatch(key):
        raise ValueError(f"no open request has the id {key[:80]!r}; `porse llm pending` lists them")
    if document.get("error") is not None:
        raise ValueError(f"{key[:12]} came back as {read_error(0, document)}")
    if "response" in document:
        return key, _parse_response(key, document["response"])
    text = document.get("text")
    if isinstance(text, list) and all(isinstance(item, str) for item in text):
        text = "\n".join(text)
    if not isinstance(text, str) or not text.strip():
        raise ValueError(f"expected a text for {key[:12]}, found {'none' if text is None else repr(text)[:40]}")
    finish_reason = document.get("finish_reason", "stop")
    if finish_reason not in ("stop", "length"):
        raise ValueError(f"expected finish_reason stop or length for {key[:12]}, found {finish_reason!r}")
    check_text(text)
    return key, Completion(Answer(text, finish_reason, None, None), "", "")


def _parse_response(key: str, response: Any) -> Completion:
    if not isinstance(response, dict):
        raise ValueError(f"expected a response object for {key[:12]}, found {response!r}")
    status, body = response.get("status_code", 200), response.get("body")
    if status != 200:
        raise ValueError(f"{key[:12]} came back with {read_error(status, body)}")
    return read_completion(body)


def _accept(
    key: str, completion: Completion, answered_by: Answerer, known: dict[str, OpenRequest], store: Store
) -> Accepted:
    recorded = store.read(key)
    if recorded is not None:
        if recorded.answer.text != completion.answer.text:
            raise ValueError(f"{key[:12]} is recorded with a different reply; `porse llm refresh` replaces it")
        return Accepted(recorded, fresh=False)
    if key not in known:
        raise ValueError(f"no open request has the id {key[:12]}; `porse llm pending` lists them")
    request = known[key]
    completion.check_model(request.question.request.model, request.aliases)
    provenance = Provenance(
        answered_by=answered_by.of(completion.model),
        mode="batch",
        profile=request.profile,
        endpoint="none",
        request_id=completion.request_id,
        recorded_at=utc_now(),
        origin=request.question.origin,
        price=request.price,
    )
    return Accepted(Record(request.question.request, completion.answer, provenance), fresh=True)
