"""Asks an endpoint that speaks OpenAI's protocol: one request, one whole reply, retried where that can help.

The client library's own retries are switched off: it would also retry an exhausted quota, and its time-out restarts
with every byte, so a server that sends one byte a minute would never be given up.
"""

import asyncio
import email.utils
import json
import logging
import time
from typing import Any

import httpx2
import openai

from porse.errors import ProviderError
from porse.llm.completion import Completion, read_completion
from porse.llm.request import Request
from porse.llm.transport import Transport
from porse.llm.wire import wire_body

REPLY_LIMIT_BYTES = 4 * 2**20
"""A body beyond this is refused: no limit on tokens gives that much, and it would stay in the repository for ever."""

FIRST_DELAY_S = 0.5
LONGEST_DELAY_S = 60.0

RETRIED_STATUS = frozenset({408, 409, 429})
"""These and all from 500 are retried."""

QUOTA_CODES = frozenset({"insufficient_quota", "billing_hard_limit_reached", "quota_exceeded", "insufficient_balance"})

logger = logging.getLogger(__name__)


class HopelessError(ProviderError):
    """No other request can succeed either: a bad key or an exhausted quota."""


class _RetriableError(Exception):
    """An attempt failed in a way that another attempt may not.

    Attributes:
        retry_after_s: how long the server asked to wait, None when it did not say.
    """

    def __init__(self, reason: str, retry_after_s: float | None = None) -> None:
        super().__init__(reason)
        self.retry_after_s = retry_after_s


class Provider:
    """One endpoint. Use it as an asynchronous context manager, in one event loop."""

    def __init__(self, transport: Transport) -> None:
        """Prepares a client; nothing is sent yet."""
        self._transport = transport
        self._client = openai.AsyncOpenAI(
            api_key=transport.api_key, base_url=transport.base_url, max_retries=0, timeout=transport.timeout_s
        )

    async def __aenter__(self) -> "Provider":
        """Returns itself."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Closes the connections."""
        await self._client.close()

    async def complete(self, request: Request) -> Completion:
        """Returns the endpoint's reply to one request.

        Raises:
            HopelessError: the key is refused or the quota is exhausted.
            ProviderError: the reply cannot be used, or no attempt succeeded.
        """
        attempts = self._transport.attempts
        for attempt in range(1, attempts + 1):
            try:
                completion = await self._attempt(request)
                completion.check_model(request.model)
                return completion
            except _RetriableError as error:
                if attempt == attempts:
                    raise ProviderError(f"{attempts} attempts failed, the last one: {error}") from error
                delay_s = back_off_s(attempt) if error.retry_after_s is None else error.retry_after_s
                if delay_s > self._transport.stage_timeout_s:
                    raise ProviderError(f"the server asks to wait {delay_s:g} s: {error}") from error
                logger.warning("attempt %d of %d: %s; again in %.1f s", attempt, attempts, error, delay_s)
                await asyncio.sleep(delay_s)
        raise AssertionError("unreachable: the last attempt returns or raises")

    async def _attempt(self, request: Request) -> Completion:
        timeout_s = self._transport.timeout_s
        try:
            async with asyncio.timeout(timeout_s):
                return read_completion(_parse_body(await self._body(request)))
        except TimeoutError as error:
            raise _RetriableError(f"no whole reply within {timeout_s:g} s") from error
        except openai.APIStatusError as error:
            raise self._judge(error) from error
        except (openai.APIConnectionError, httpx2.RequestError) as error:
            raise _RetriableError(f"the connection broke ({_cause(error)})") from error

    async def _body(self, request: Request) -> bytes:
        """Returns the whole body of the endpoint's answer; it is read in pieces, so that no answer fills the memory."""
        body = bytearray()
        create = self._client.chat.completions.with_streaming_response.create
        async with create(**wire_body(request), stream=False) as response:
            async for piece in response.iter_bytes():
                body += piece
                if len(body) > REPLY_LIMIT_BYTES:
                    raise ProviderError(f"expected a reply of at most {REPLY_LIMIT_BYTES} bytes, found a longer one")
        return bytes(body)

    def _judge(self, error: openai.APIStatusError) -> Exception:
        """Returns the exception that an HTTP status becomes, without the API key that some servers repeat in it."""
        message = error.message.replace(self._transport.api_key, "***")
        reason = f"status {error.status_code}: {' '.join(message.split())[:300]}"
        if error.status_code in (401, 403):
            return HopelessError(f"the API key was refused, {reason}")
        if error.status_code == 402 or error.code in QUOTA_CODES or error.type in QUOTA_CODES:
            return HopelessError(f"the quota is exhausted, {reason}")
        if error.status_code in RETRIED_STATUS or error.status_code >= 500:
            return _RetriableError(reason, retry_after_s(error.response.headers))
        return ProviderError(reason)


def back_off_s(attempt: int) -> float:
    """Returns the seconds to wait after the given attempt, 1 and up, when the server does not say how long."""
    return min(FIRST_DELAY_S * 2 ** (attempt - 1), LONGEST_DELAY_S)


def retry_after_s(headers: Any) -> float | None:
    """Returns the seconds that a `Retry-After` header asks to wait, None when there is no readable one."""
    text = headers.get("retry-after", "")
    try:
        seconds = float(text)
    except ValueError:
        moment = email.utils.parsedate_to_datetime(text) if _is_date(text) else None
        seconds = moment.timestamp() - time.time() if moment is not None else float("nan")
    return max(seconds, 0.0) if seconds == seconds and seconds != float("inf") else None


def _is_date(text: str) -> bool:
    return email.utils.parsedate(text) is not None


def _parse_body(body: bytes) -> Any:
    try:
        return json.loads(body)
    except (ValueError, RecursionError) as error:
        raise ProviderError(f"expected a JSON body, found {len(body)} bytes that do not parse") from error


def _cause(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    return type(error).__name__
