"""Replaces one recorded reply on purpose; the old record stays beside the new one."""

import asyncio
import contextlib
from pathlib import Path

from porse.config import LlmParams
from porse.errors import CacheError, ParamsError
from porse.llm.completion import Completion, check_text
from porse.llm.index import Index
from porse.llm.pending import price_of
from porse.llm.record import Answer, Price, Provenance, Record, utc_now
from porse.llm.request import Question
from porse.llm.store import Store
from porse.llm.transport import Transport, transport_from_environment


def refresh_from_text(key: str, text: str, answered_by: str, store: Store) -> Path:
    """Replaces a reply by a text; returns the file that holds the old record.

    Raises:
        CacheError: there is no record of that key, or the text is empty.
    """
    old = _existing(key, store)
    if not text.strip():
        raise CacheError(f"Expected a text to replace the reply of {key[:12]}, found none. Nothing was changed.")
    check_text(text)
    provenance = Provenance(
        answered_by=answered_by,
        mode="refresh",
        profile=old.provenance.profile,
        endpoint="none",
        request_id="",
        recorded_at=utc_now(),
        origin=old.provenance.origin,
        price=old.provenance.price,
    )
    return _replace(Record(old.request, Answer(text, "stop", None, None), provenance), store)


def refresh_from_endpoint(key: str, params: LlmParams, store: Store) -> Path:
    """Asks the profile's endpoint the recorded request once more; returns the file that holds the old record.

    Raises:
        CacheError: there is no record of that key.
        ParamsError: the profile is of another model than the record's request, or has no endpoint.
        ProviderError: the endpoint gave no usable reply; nothing was changed.
    """
    from porse.llm.recording import make_record

    old = _existing(key, store)
    if params.model != old.request.model:
        raise ParamsError(
            f"Expected a profile of model {old.request.model!r}, which the record of {key[:12]} was asked of, found "
            f"profile {params.profile!r} of model {params.model!r}. Choose another by `--profile NAME`."
        )
    transport = transport_from_environment(params)
    price = price_of(params)
    completion = asyncio.run(_complete(old, transport, price, store))
    question = Question(old.request, old.provenance.origin)
    return _replace(make_record(question, completion, transport, price, mode="refresh"), store)


async def _complete(old: Record, transport: Transport, price: Price, store: Store) -> Completion:
    from porse.llm.provider import Provider
    from porse.llm.recording import open_account

    async with Provider(transport, open_account(store, transport, price)) as provider:
        return await provider.complete(old.request)


def _existing(key: str, store: Store) -> Record:
    record = store.read(key)
    if record is None:
        raise CacheError(f"Expected a recorded reply to refresh, found no {store.path(key)}. Record it first.")
    return record


def _replace(record: Record, store: Store) -> Path:
    """Replaces the record under its lock, so that two refreshes do not keep each other's old record."""
    with contextlib.closing(Index(store)) as index:
        if not index.try_lock(record.key):
            raise CacheError(
                f"Expected to replace the record of {record.key[:12]}, found another process recording it. Run the "
                "command again when that has ended; nothing was changed."
            )
        try:
            return store.supersede(record)
        finally:
            index.unlock(record.key)
