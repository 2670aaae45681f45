"""A record, or an open request, as a conversation for people."""

import json

from porse.errors import CacheError
from porse.llm.pending import load_pending
from porse.llm.record import Record
from porse.llm.request import Origin, Question, Request
from porse.llm.store import Store
from porse.printing import visible


def conversation(prefix: str, store: Store) -> str:
    """Returns the conversation of the one recorded or open request whose key starts with `prefix`.

    Raises:
        CacheError: no key starts so, several do, or the record cannot be trusted.
    """
    waiting = [request for request in load_pending(store) if request.key.startswith(prefix)]
    if len(waiting) == 1:
        return open_conversation(waiting[0].question) + "\n\n(waits for an answer)"
    record = store.read(store.find(prefix))
    if record is None:
        raise CacheError(
            f"Expected the record of {prefix}, found that it has just been removed. Run the command again."
        )
    return f"{_asked(record.request, record.provenance.origin)}\n{_answered(record)}"


def open_conversation(question: Question) -> str:
    """Returns an unanswered request as a conversation."""
    return _asked(question.request, question.origin)


def _asked(request: Request, origin: Origin) -> str:
    sampling = {"temperature": request.temperature, "top_p": request.top_p}
    fields = [f"{name} {value:g}" for name, value in sampling.items() if value is not None]
    fields += [f"{request.limit} {request.max_tokens}", f"sample {request.sample}"]
    fields += [f"{name} {json.dumps(value, ensure_ascii=False)}" for name, value in request.extra.items()]
    head = f"key {request.key}\nasked in {origin}\n" + visible(f"model {request.model}, {', '.join(fields)}", keep="")
    turns = [f"\n--- {message.role} ---\n{message.content}" for message in request.messages]
    return "\n".join([head, *turns])


def _answered(record: Record) -> str:
    answer, provenance = record.answer, record.provenance
    cut = " (cut off by its limit)" if record.truncated else ""
    tokens = [count for count in (answer.prompt_tokens, answer.completion_tokens) if count is not None]
    counted = (
        f"{tokens[0]} + {tokens[1]} tokens, {record.cost_usd:.6f} USD" if len(tokens) == 2 else "tokens not counted"
    )
    head = visible(f"--- reply by {provenance.answered_by}{cut} ---", keep="")
    how = visible(
        f"(mode {provenance.mode}, profile {provenance.profile}, recorded {provenance.recorded_at}, {counted})", keep=""
    )
    return f"\n{head}\n{how}\n{answer.text}"
