"""Asks an endpoint that speaks OpenAI's protocol: one request, one whole reply, tried again where that can help.

The request is one POST of a JSON body with the headers named here. No client library stands between: one would take
organisation, project, headers and keys from the environment and send them to whatever endpoint the profile names, would
retry an exhausted quota, and would begin its time-out anew with every byte.
"""

import asyncio
import email.utils
import logging
import ssl
import time
from typing import Any

import httpx2

from porse import __version__
from porse.errors import ParamsError, ProviderError
from porse.llm.completion import (
    Completion,
    EndpointError,
    HopelessError,
    RetriableError,
    parse_body,
    read_completion,
    read_error,
    token_counts,
)
from porse.llm.ledger import Account
from porse.llm.request import Request
from porse.llm.transport import Transport
from porse.printing import visible

REPLY_LIMIT_BYTES = 4 * 2**20
"""A body beyond this is refused: no limit on tokens gives that much, and it would stay in the repository for ever."""

FIRST_DELAY_S = 0.5
LONGEST_DELAY_S = 60.0

NEVER_SENT = (httpx2.ConnectError, httpx2.ConnectTimeout, httpx2.PoolTimeout, httpx2.ProxyError)
"""Failures before a request was sent: nothing can have been paid for."""

logger = logging.getLogger(__name__)


class Provider:
    """One endpoint. Use it as an asynchronous context manager, in one event loop."""

    def __init__(self, transport: Transport, account: Account) -> None:
        """Prepares a client; nothing is sent yet.

        Raises:
            ParamsError: the endpoint's address, the proxy or the file of certificates cannot be used.
        """
        self._transport = transport
        self._account = account
        self._url = _endpoint(transport.base_url)
        self._client = _client(transport)

    async def __aenter__(self) -> "Provider":
        """Returns itself."""
        return self

    async def __aexit__(self, *_: object) -> None:
        """Closes the connections."""
        await self._client.aclose()

    async def complete(self, request: Request) -> Completion:
        """Returns the endpoint's reply to one request.

        Raises:
            HopelessError: the key is refused, the quota is exhausted, or the budget is spent.
            ProviderError: the reply cannot be used, or no attempt succeeded.
        """
        attempts = self._transport.attempts
        for attempt in range(1, attempts + 1):
            try:
                completion = await self._attempt(request)
                completion.check_model(request.model, self._transport.aliases)
                return completion
            except RetriableError as error:
                if attempt == attempts:
                    raise ProviderError(f"{attempts} attempts failed, the last one: {error}") from error
                delay_s = back_off_s(attempt) if error.retry_after_s is None else error.retry_after_s
                if delay_s > self._transport.stage_timeout_s:
                    raise ProviderError(f"the server asks to wait {delay_s:g} s: {error}") from error
                said = visible(str(error), keep="")
                logger.warning("attempt %d of %d: %s; again in %.1f s", attempt, attempts, said, delay_s)
                await asyncio.sleep(delay_s)
        raise AssertionError("unreachable: the last attempt returns or raises")

    async def _attempt(self, request: Request) -> Completion:
        timeout_s = self._transport.timeout_s
        reservation = await self._account.reserve(request)
        try:
            async with asyncio.timeout(timeout_s):
                response, body = await self._send(request)
        except BaseException as error:
            if isinstance(error, NEVER_SENT):
                self._account.release(reservation)
            else:
                self._account.abandon(reservation)
            if isinstance(error, TimeoutError):
                raise RetriableError(f"no whole reply within {timeout_s:g} s") from error
            # Some failures below the client, of a proxy's port say, reach us as they are.
            if isinstance(error, httpx2.RequestError | OSError | ExceptionGroup):
                raise _broken(error) from error
            raise
        try:
            completion = self._read(response, body)
        except EndpointError as error:
            self._account.release(reservation)
            error.message = error.message.replace(self._transport.api_key or "\n", "***")
            raise error.judged(retry_after_s(response.headers)) from error
        except ProviderError:
            # It cannot be used, and is paid for all the same.
            self._account.settle(reservation, _counted(body))
            raise
        answer = completion.answer
        self._account.settle(reservation, (answer.prompt_tokens, answer.completion_tokens))
        return completion

    async def _send(self, request: Request) -> tuple[httpx2.Response, bytes]:
        """Returns the answer with its whole body; it is read in pieces, so that no answer fills the memory."""
        body = bytearray()
        async with self._client.stream(
            "POST", self._url, json={**request.wire_body(), "stream": False}, headers=_headers(self._transport)
        ) as response:
            async for piece in response.aiter_bytes():
                body += piece
                if len(body) > REPLY_LIMIT_BYTES:
                    raise ProviderError(f"expected a reply of at most {REPLY_LIMIT_BYTES} bytes, found a longer one")
        return response, bytes(body)

    def _read(self, response: httpx2.Response, body: bytes) -> Completion:
        """Returns the completion in an answer.

        Raises:
            EndpointError: the answer is an error, by its status or inside.
            ProviderError: it is a reply that cannot be used.
        """
        status = response.status_code
        if status == 200:
            return read_completion(parse_body(body))
        if response.is_redirect:
            target = response.headers.get("location", "")
            raise EndpointError(
                status, "", f"moved to {target}; correct the endpoint's address, a key goes nowhere else"
            )
        try:
            error = parse_body(body)
        except ProviderError:
            error = body.decode(errors="replace")
        raise read_error(status, error)


def _endpoint(base_url: str) -> httpx2.URL:
    """Returns the address that completions are asked from; a query stays at its end.

    Raises:
        ParamsError: it is no address of HTTP.
    """
    try:
        url = httpx2.URL(base_url)
    except httpx2.InvalidURL as error:
        raise ParamsError(_wrong_address(repr(base_url), str(error))) from error
    if url.userinfo:
        raise ParamsError(
            _wrong_address("one", "a name or a password in it; name the variable of a key in the profile")
        )
    if url.scheme not in ("http", "https") or not url.host:
        raise ParamsError(_wrong_address(repr(base_url), "no address of HTTP"))
    if url.port is not None and not 0 < url.port < 65536:
        raise ParamsError(_wrong_address(repr(base_url), f"the port {url.port}"))
    return url.copy_with(path=f"{url.path.rstrip('/')}/chat/completions")


def _wrong_address(shown: str, found: str) -> str:
    return (
        f"Expected an endpoint like https://host/v1 in base_url of the profile or in PORSE_LLM_BASE_URL, found {shown}: "
        f"{found}. Correct it there."
    )


def _client(transport: Transport) -> httpx2.AsyncClient:
    """Returns the client; proxies and certificates come from the environment, as a way to the endpoint.

    Raises:
        ParamsError: they cannot be used.
    """
    try:
        return httpx2.AsyncClient(timeout=transport.timeout_s, follow_redirects=False)
    except (ImportError, ValueError, httpx2.InvalidURL) as error:
        raise ParamsError(
            "Expected a proxy that can be used in HTTP_PROXY, HTTPS_PROXY or ALL_PROXY, found: "
            f"{' '.join(str(error).split())} Unset the variable, name an HTTP proxy, add the endpoint's host to NO_PROXY, "
            "or, for a SOCKS proxy, run `pip install socksio`."
        ) from error
    except (OSError, ssl.SSLError) as error:
        raise ParamsError(
            f"Expected a readable file of certificates in SSL_CERT_FILE or SSL_CERT_DIR, found: {error}. Correct the "
            "variable or unset it."
        ) from error


def _headers(transport: Transport) -> dict[str, str]:
    """Returns all headers that a request has beside those of the connection."""
    key = {"Authorization": f"Bearer {transport.api_key}"} if transport.api_key else {}
    return {"Accept": "application/json", "User-Agent": f"porse/{__version__}", **key}


def _broken(error: Exception) -> Exception:
    """Returns what a failed connection means: a certificate that is not trusted will not be trusted next time."""
    cause: BaseException = error
    while cause.__cause__ is not None or cause.__context__ is not None:
        cause = cause.__cause__ or cause.__context__ or cause
        if isinstance(cause, ssl.SSLCertVerificationError):
            return HopelessError(
                f"the endpoint's certificate is not trusted ({cause.verify_message}); see SSL_CERT_FILE and SSL_CERT_DIR"
            )
    return RetriableError(f"the connection broke ({type(error).__name__})")


def _counted(body: bytes) -> tuple[int | None, int | None]:
    """Returns the tokens that an unusable reply counts, None for what it does not."""
    try:
        return token_counts(parse_body(body))
    except ProviderError:
        return None, None


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
