"""What this checkout has spent, and the budgets that a recording stays below.

`.porse/llm-ledger.jsonl` is a journal with two lines for each request that goes to an endpoint. Before it is sent, a line
reserves the most that it can cost; when its outcome is known, a second line says what it did cost. A budget counts both,
so requests that run side by side, in this process or another, cannot pass it together. What was sent and never settled
(a time-out, a killed process) may have been paid for, and stays reserved.

A replay adds nothing. What the recorded replies cost when they were recorded is in the records themselves.
"""

import asyncio
import contextlib
import errno
import fcntl
import json
import logging
import os
import uuid
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from io import FileIO
from pathlib import Path
from typing import Any

from porse.errors import CacheError
from porse.llm.completion import HopelessError
from porse.llm.record import Price, Record, cost_usd
from porse.llm.request import Request
from porse.llm.store import Store

TOKENS_AROUND_A_MESSAGE = 16
"""More than any chat template puts around one message."""

LOOK_AGAIN_S = 0.02

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Spending:
    """What one reply, or several together, cost.

    Attributes:
        replies: number of replies.
        prompt_tokens: tokens read by models.
        completion_tokens: tokens written by models.
        cost_usd: cost in US dollars, by the prices at the time of recording.
    """

    replies: int
    prompt_tokens: int
    completion_tokens: int
    cost_usd: float

    @classmethod
    def of(cls, record: Record) -> "Spending":
        """Returns what one recorded reply cost."""
        answer = record.answer
        return cls(1, answer.prompt_tokens or 0, answer.completion_tokens or 0, record.cost_usd)

    def __add__(self, other: "Spending") -> "Spending":
        """Returns the sum of both."""
        return Spending(
            self.replies + other.replies,
            self.prompt_tokens + other.prompt_tokens,
            self.completion_tokens + other.completion_tokens,
            self.cost_usd + other.cost_usd,
        )


NOTHING = Spending(0, 0, 0, 0.0)


@dataclass
class Totals:
    """The sum of a ledger.

    Attributes:
        spending: what replies did cost.
        requests: requests that were sent, or are about to be.
        reserved: request's id -> the most that it may yet cost, in US dollars.
    """

    spending: Spending = NOTHING
    requests: int = 0
    reserved: dict[str, float] = field(default_factory=dict)

    @property
    def usd(self) -> float:
        """What is spent, and what may yet have been."""
        return self.spending.cost_usd + sum(self.reserved.values())

    def add(self, line: dict[str, Any]) -> None:
        """Counts one line.

        Raises:
            TypeError, ValueError: it is no line of a ledger.
        """
        name = line.get("request")
        if "reserved_usd" in line:
            self.reserved[str(name)] = float(line["reserved_usd"])
            self.requests += 1
            return
        fields = {key: value for key, value in line.items() if key != "request"}
        self.spending += Spending(**fields)
        # Ledgers of earlier versions have one line for each reply, and no reservations.
        self.requests += 1 if name is None else 0
        self.reserved.pop(str(name), None)


def ledger_path(store: Store) -> Path:
    """Returns the file of the ledger."""
    return store.state_dir / "llm-ledger.jsonl"


def totals(store: Store) -> Totals:
    """Returns what this checkout has spent and reserved; a line that was cut off by a crash is left out."""
    try:
        data = ledger_path(store).read_bytes()
    except FileNotFoundError:
        return Totals()
    found = Totals()
    _add_lines(found, data)
    return found


def most_tokens(request: Request) -> int:
    """Returns a bound on the tokens of a prompt: each token is at least one byte of text."""
    return sum(len(message.content.encode()) + TOKENS_AROUND_A_MESSAGE for message in request.messages)


class Account:
    """The ledger as one recording process uses it."""

    def __init__(self, store: Store, price: Price, max_usd: float | None, max_requests: int | None) -> None:
        """Prepares to write; nothing is written yet.

        Args:
            store: the records, whose checkout the ledger is of.
            price: what a reply costs now.
            max_usd: what the ledger may come to, in US dollars; None for no limit.
            max_requests: how many requests it may come to; None for no limit.
        """
        self._path = ledger_path(store)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._price = price
        self._max_usd = max_usd
        self._max_requests = max_requests
        self._totals = Totals()
        self._read = 0
        self._is_whole = True
        self._under_way: dict[str, float] = {}

    async def reserve(self, request: Request) -> str:
        """Returns the name of a reservation for one request, as soon as the budget has room for the most it can cost.

        While other requests of this process are under way, which may cost less than was reserved for them, it waits.

        Raises:
            HopelessError: there is no room and will be none.
            CacheError: the ledger cannot be written.
        """
        most_usd = cost_usd(self._price, most_tokens(request), request.max_tokens)
        while True:
            with self._locked() as file:
                lacking = self._lacking(most_usd)
                if not lacking:
                    name = uuid.uuid4().hex
                    self._append(file, {"request": name, "reserved_usd": most_usd})
                    self._under_way[name] = most_usd
                    return name
            if not self._under_way:
                raise HopelessError(lacking)
            await asyncio.sleep(LOOK_AGAIN_S)

    def settle(self, name: str, tokens: tuple[int | None, int | None]) -> None:
        """Says that a request had a reply, of these prompt and completion tokens.

        Where somebody did not count them, the reply counts with the most that it can have cost. So it does where the ledger
        cannot be written: the reply is worth more than its line, and a warning says so.
        """
        most_usd = self._under_way.pop(name)
        prompt, completion = (count or 0 for count in tokens)
        cost = most_usd if None in tokens else cost_usd(self._price, prompt, completion)
        self._finish(name, Spending(1, prompt, completion, cost))

    def release(self, name: str) -> None:
        """Says that a request had no reply, which costs nothing; where the ledger cannot be written, it stays reserved."""
        del self._under_way[name]
        self._finish(name, NOTHING)

    def abandon(self, name: str) -> None:
        """Leaves a reservation as it is: nobody knows whether the request was answered, and so paid for."""
        del self._under_way[name]

    def _finish(self, name: str, spending: Spending) -> None:
        try:
            with self._locked() as file:
                self._append(file, {"request": name, **asdict(spending)})
        except CacheError as error:
            logger.warning("%s What was reserved for the request counts as spent.", error)

    def _lacking(self, most_usd: float) -> str:
        """Returns which budget has no room for one more request; "" when all have."""
        found = self._totals
        if self._max_requests is not None and found.requests + 1 > self._max_requests:
            return (
                f"llm.max_requests of params.yaml is {self._max_requests}, and {found.requests} requests are sent by "
                f"{self._path}; raise it to go on"
            )
        if self._max_usd is not None and found.usd + most_usd > self._max_usd:
            spent, reserved = found.spending.cost_usd, sum(found.reserved.values())
            return (
                f"llm.max_usd of params.yaml is {self._max_usd:g}, {spent:.6f} USD are spent and {reserved:.6f} may have been by "
                f"{self._path}, and one more request costs up to {most_usd:.6f}; raise it to go on"
            )
        return ""

    @contextlib.contextmanager
    def _locked(self) -> Iterator[FileIO]:
        """Yields the ledger with all lines read, locked against other processes and threads.

        Raises:
            CacheError: it cannot be read or written, as on a full disk.
        """
        try:
            # Without a buffer: what a full disk did not take must not be written when the file is closed.
            with self._path.open("a+b", buffering=0) as file:
                fcntl.flock(file, fcntl.LOCK_EX)
                file.seek(self._read)
                data = file.readall()
                self._read += len(data)
                _add_lines(self._totals, data)
                self._is_whole = data.endswith(b"\n") if data else self._is_whole
                yield file
        except OSError as error:
            raise CacheError(
                f"Expected to write the ledger {self._path}, found: {error}. Make room, or make the file one that can be written, "
                "and run the command again: it goes on with what is missing."
            ) from error

    def _append(self, file: FileIO, line: dict[str, Any]) -> None:
        # After a line that a crash or a full disk cut off, a new one must not be its end.
        data = (b"" if self._is_whole else b"\n") + json.dumps(line, sort_keys=True).encode() + b"\n"
        if file.write(data) < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._read += len(data)
        self._is_whole = True
        _add_lines(self._totals, data)


def _add_lines(found: Totals, data: bytes) -> None:
    for line in data.split(b"\n"):
        with contextlib.suppress(ValueError, TypeError, AttributeError):
            found.add(json.loads(line))
