"""Record mode: asks the endpoint for every reply that is missing, once, and writes each down as soon as it is there."""

import asyncio
import contextlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass

from porse.config import LlmParams
from porse.errors import CacheError, ProviderError
from porse.llm.completion import Completion, HopelessError
from porse.llm.index import Index
from porse.llm.ledger import Account
from porse.llm.pending import price_of
from porse.llm.provider import Provider
from porse.llm.record import Price, Provenance, Record, utc_now
from porse.llm.request import Origin, Question, Request
from porse.llm.store import Store
from porse.llm.transport import Transport, transport_from_environment

FIRST_WAIT_S = 0.02
LONGEST_WAIT_S = 0.5
"""While another process asks for the same key, this one looks again after a wait that doubles between these two."""

MAX_NAMED = 5

logger = logging.getLogger(__name__)


def record_replies(questions: Sequence[Question], params: LlmParams, store: Store) -> None:
    """Asks for every missing reply, the longer ones of truncated replies among them, and records them.

    One failure does not stop the others: what an endpoint has answered is paid for and recorded.

    Raises:
        ProviderError: some requests got no usable reply, or the time of the stage is over.
        ParamsError: the profile has no endpoint or no API key, or a limit is out of range.
        CacheError: a record cannot be trusted, or the index cannot be written.
    """
    distinct = list({question.request.key: question for question in questions}.values())
    if all(_is_answered(question.request, store) for question in distinct):
        return
    transport = transport_from_environment(params)
    with contextlib.closing(Index(store)) as index:
        recorder = _Recorder(store, index, transport, price_of(params))
        failures = asyncio.run(recorder.record_all(distinct))
    unexpected = [error for _, error in failures if not isinstance(error, ProviderError)]
    if unexpected:
        raise unexpected[0]
    if failures:
        raise _provider_error(failures, len(distinct), transport)


def open_account(store: Store, transport: Transport, price: Price) -> Account:
    """Returns the checkout's account, with the budgets of the environment."""
    return Account(store, price, transport.max_usd, transport.max_requests)


def make_record(
    question: Question, completion: Completion, transport: Transport, price: Price, mode: str = "record"
) -> Record:
    """Returns the record of a reply that an endpoint gave."""
    provenance = Provenance(
        answered_by=completion.model or question.request.model,
        mode=mode,
        profile=transport.profile,
        endpoint="override" if transport.overridden else "profile",
        request_id=completion.request_id,
        recorded_at=utc_now(),
        origin=question.origin,
        price=price,
    )
    return Record(question.request, completion.answer, provenance)


@dataclass
class _Recorder:
    """The work of one call of `record_replies`, in one event loop."""

    store: Store
    index: Index
    transport: Transport
    price: Price
    hopeless: HopelessError | None = None

    async def record_all(self, questions: list[Question]) -> list[tuple[Origin, Exception]]:
        """Records all replies; returns the failures in the order of the questions."""
        slots = asyncio.Semaphore(self.transport.concurrency)
        async with Provider(self.transport, open_account(self.store, self.transport, self.price)) as provider:
            tasks = [asyncio.ensure_future(self._record_whole(question, provider, slots)) for question in questions]
            _, late = await asyncio.wait(tasks, timeout=self.transport.stage_timeout_s)
            for task in late:
                task.cancel()
            outcomes = await asyncio.gather(*tasks, return_exceptions=True)
        failures: list[tuple[Origin, Exception]] = []
        for question, outcome in zip(questions, outcomes, strict=True):
            if isinstance(outcome, asyncio.CancelledError):
                limit_s = self.transport.stage_timeout_s
                failures.append((question.origin, ProviderError(f"the {limit_s:g} s of the stage are over")))
            elif isinstance(outcome, Exception):
                failures.append((question.origin, outcome))
            elif outcome is not None:
                raise outcome
        return failures

    async def _record_whole(self, question: Question, provider: Provider, slots: asyncio.Semaphore) -> None:
        async with slots:
            record = await self._record_one(question, provider)
            if record.truncated:
                await self._record_one(Question(question.request.longer(), question.origin), provider)

    async def _record_one(self, question: Question, provider: Provider) -> Record:
        """Returns the record of one key; whoever gets the key's lock first asks, all others wait for the file."""
        key = question.request.key
        wait_s = FIRST_WAIT_S
        while (record := self.store.read(key)) is None:
            if self.hopeless is not None:
                raise self.hopeless
            if self.index.try_lock(key):
                try:
                    return await self._ask(question, provider)
                finally:
                    self.index.unlock(key)
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)
        return record

    async def _ask(self, question: Question, provider: Provider) -> Record:
        # Somebody else may have recorded the reply between the look at the file and the lock.
        known = self.store.read(question.request.key)
        if known is not None:
            return known
        try:
            completion = await provider.complete(question.request)
        except HopelessError as error:
            self.hopeless = error
            raise
        record = make_record(question, completion, self.transport, self.price)
        if self.transport.api_key and self.transport.api_key.encode() in record.render():
            raise CacheError(
                f"Expected a reply without secrets for {question.origin}, found the API key itself in the request or "
                "the reply. Nothing was recorded: remove the key from the prompt."
            )
        self.store.write(record)
        logger.info("%s: recorded, %d characters", question.origin, len(record.answer.text))
        return record


def _is_answered(request: Request, store: Store) -> bool:
    record = store.read(request.key)
    return record is not None and (not record.truncated or store.read(request.longer().key) is not None)


def _provider_error(failures: list[tuple[Origin, Exception]], asked: int, transport: Transport) -> ProviderError:
    named = "; ".join(f"{origin}: {error}" for origin, error in failures[:MAX_NAMED])
    more = f"; and {len(failures) - MAX_NAMED} more" if len(failures) > MAX_NAMED else ""
    return ProviderError(
        f"Expected a usable reply to each of {asked} requests from profile {transport.profile!r}, found "
        f"{len(failures)} failures: {named}{more}. All other replies are recorded; fix the cause and run the same "
        "command again, which asks only for what is missing."
    )
