"""`ask`: the one function through which every stage gets its replies, in all three modes.

Frozen mode and batch mode read files. Record mode first fills the cache and then reads it like frozen mode does, so
that a recorded run and its replay take the very same way.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from porse.config import LlmParams
from porse.errors import CacheMiss, RepliesPending
from porse.llm.index import summaries
from porse.llm.nearest import describe_nearest
from porse.llm.pending import add_pending, open_request, remove_pending
from porse.llm.record import Record
from porse.llm.request import Question, Reply, Request
from porse.llm.store import Store
from porse.llm.transport import mode_from_environment

MAX_NAMED = 5
"""An error names this many open requests and counts the others."""


def ask(questions: Sequence[Question], params: LlmParams, cache_dir: Path) -> list[Reply]:
    """Returns the replies to the questions, in their order.

    The mode comes from the environment variable `PORSE_LLM_MODE`: `frozen` (default) reads recorded replies and never
    opens a socket; `record` asks the profile's endpoint for what is missing; `batch` writes what is missing to
    `.porse/pending` beside the cache. A reply that was cut off by its limit is asked for once more with a larger one.

    Args:
        questions: what to ask and where in the run it is asked.
        params: the `llm` section of params.yaml.
        cache_dir: the directory of recorded replies.

    Raises:
        CacheMiss: frozen mode, and replies are missing; all of them are counted, the first few named.
        RepliesPending: batch mode, and requests wait for an answer.
        CacheError: a recorded reply cannot be trusted.
        ProviderError: record mode, and the endpoint gave no usable reply; what it gave is recorded.
        ParamsError: a field of a request or an environment variable is out of range.
    """
    store = Store(cache_dir)
    mode = mode_from_environment()
    if mode == "record":
        # Imported here: only record mode may load the client library, which takes a second and can open sockets.
        from porse.llm.recording import record_replies

        record_replies(questions, params, store)
    replies: list[Reply] = []
    missing: dict[str, Question] = {}
    for question in questions:
        found = resolve(question.request, store.read)
        if isinstance(found, Request):
            missing[found.key] = Question(found, question.origin)
        else:
            replies.append(found)
    if missing and mode == "batch":
        raise _replies_pending(list(missing.values()), params, store)
    if missing:
        raise _cache_miss(list(missing.values()), params, store)
    if mode != "frozen":
        remove_pending(store, [question.request.key for question in questions] + [reply.key for reply in replies])
    return replies


def ask_recorded(questions: Sequence[Question], params: LlmParams, cache_dir: Path) -> list[Reply | None]:
    """Returns what `ask` does, but in frozen mode None for each question without a recorded reply.

    Raises:
        CacheError: a recorded reply cannot be trusted; and, in the other modes, what else `ask` raises.
    """
    if mode_from_environment() != "frozen":
        return [*ask(questions, params, cache_dir)]
    store = Store(cache_dir)
    found = [resolve(question.request, store.read) for question in questions]
    return [reply if isinstance(reply, Reply) else None for reply in found]


def resolve(request: Request, read: Callable[[str], Record | None]) -> Reply | Request:
    """Returns the recorded reply to a request, or the request that must be asked next to get it.

    That is the request itself, or, when its reply was cut off, the same with a larger limit: once, no more.
    """
    record = read(request.key)
    if record is None:
        return request
    if not record.truncated:
        return _reply([record])
    longer = request.longer()
    repaired = read(longer.key)
    return longer if repaired is None else _reply([record, repaired])


def _reply(records: list[Record]) -> Reply:
    last = records[-1]
    return Reply(
        key=last.key,
        text=last.answer.text,
        finish_reason=last.answer.finish_reason,
        prompt_tokens=sum(record.answer.prompt_tokens or 0 for record in records),
        completion_tokens=sum(record.answer.completion_tokens or 0 for record in records),
        answered_by=last.provenance.answered_by,
        cost_usd=sum(record.cost_usd for record in records),
    )


def _cache_miss(missing: list[Question], params: LlmParams, store: Store) -> CacheMiss:
    profile = params.profiles[params.profile]
    if profile.base_url:
        key = f"{profile.key_variable}=... " if profile.key_variable else ""
        way = f"from profile {params.profile!r}"
        commands = [f"{key}PORSE_LLM_MODE=record porse repro"]
    else:
        way = f"in batch mode, since profile {params.profile!r} has no endpoint"
        commands = ["PORSE_LLM_MODE=batch porse repro", "porse llm export requests.jsonl"]
    lines = [
        f"Expected a recorded reply in {store.cache_dir} to every request, found none for {len(missing)}:",
        *_named(missing),
        describe_nearest(missing[0], summaries(store), store),
        "If the prompts or the llm parameters were changed by mistake, change them back.",
        f"To get new replies {way}, run:",
        *(f"  {command}" for command in commands),
        "To go on without a model, set llm.on_miss to grammar.",
    ]
    return CacheMiss("\n".join(lines))


def _replies_pending(missing: list[Question], params: LlmParams, store: Store) -> RepliesPending:
    add_pending(store, [open_request(question, params) for question in missing])
    lines = [
        f"Expected a recorded reply to every request, found none for {len(missing)}:",
        *_named(missing),
        f"They are written to {store.state_dir / 'pending'}. To go on, export them, have them answered, and import that:",
        "  porse llm export requests.jsonl",
        "  porse llm import answers.jsonl --answered-by TEXT --context fresh",
        "  PORSE_LLM_MODE=batch porse repro",
    ]
    return RepliesPending("\n".join(lines))


def _named(missing: list[Question]) -> list[str]:
    """Returns a line for each question, of many for the first."""
    named = [f"  {question.request.key} ({question.origin})" for question in missing[:MAX_NAMED]]
    more = len(missing) - MAX_NAMED
    return [*named, f"  and {more} more"] if more > 0 else named
