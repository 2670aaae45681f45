"""Trainings as processes of this machine: one process a candidate, one thread a process.

A training is forked from this process once that has imported what trainings need. It owns its torch, ends with this
process however that ends, and speaks through two pipes: what it has done, as a line of JSON for each epoch and one at the
end, and what it prints. So the pool goes on whatever becomes of it.
"""

import faulthandler
import gc
import json
import os
import select
import selectors
import signal
import sys
import time
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from porse import errors
from porse.config import Params
from porse.errors import PorseError
from porse.processes import die_with_parent, limit_memory
from porse.task_names import is_own
from porse.tasks import find_task
from porse.training.job import Ended, Job, Outcome, Report, Tell
from porse.training.limits import Limits
from porse.training.reason import last_words

_TICK_S = 0.5
"""Longest wait for news: how late a hang is noticed."""
_CHUNK, _PIPE_BYTES = 1 << 16, 1 << 20
_LAST_BYTES = 4096
"""How much of what a training prints is kept."""


class Local:
    """Trains in processes of this machine. See `porse.training.executor.Executor`.

    Args:
        limits: what the trainings may use.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits

    def run(self, jobs: Sequence[Job], params: Params, tell: Tell) -> None:
        """Trains every job once and tells of each epoch and of each end."""
        # Imported before the first fork, and not by every child; but code of one's own runs in the children alone.
        from porse.training.candidate import train_candidate

        if not is_own(params.task):
            find_task(params.task)

        # A child that looked through a million objects for garbage would copy the memory that it shares.
        gc.freeze()

        def train(job: Job, report: Callable[[int, float], None]) -> Outcome:
            return train_candidate(job, params, report)

        waiting = deque(jobs)
        running: list[_Training] = []
        before = time.monotonic()
        try:
            while waiting or running:
                while waiting and len(running) < self.room(len(waiting) + len(running)):
                    running.append(_start(waiting.popleft(), train, self._limits, running))
                _listen(running, tell)
                now = time.monotonic()
                # A pause of this very process, one key in a terminal, is nobody's silence.
                passed, before = min(now - before, 2 * _TICK_S), now
                for training in list(running):
                    outcome = training.outcome(passed, self._limits.silence_s)
                    if outcome is not None:
                        running.remove(training)
                        training.end()
                        tell(Ended(training.job.name, outcome))
        finally:
            for training in running:
                training.end()

    def room(self, left: int) -> int:
        """Returns how many may run at once when so many are left to be done.

        Five trainings on two CPUs are three rounds one after the other, and two and a half when the last three share:
        the system gives each its part.
        """
        return left if left <= self._limits.crowd else self._limits.workers


@dataclass
class _Training:
    """A training that runs, as this process knows it.

    Attributes:
        job: what is trained.
        process: its process.
        news: the reading end of its lines.
        output: the reading end of what it prints.
        epoch: the last epoch that it has reported; 0: none.
        silent_s: for how long it has not reported.
        closed: whether its lines have ended.
        mute: whether it prints no more.
        result: its last line.
        unread: the beginning of a line.
        printed: the end of what it has printed.
        status: how its process ended, as the system says it; None while it runs.
    """

    job: Job
    process: int
    news: int
    output: int
    epoch: int = 0
    silent_s: float = 0.0
    closed: bool = False
    mute: bool = False
    result: dict[str, Any] | None = None
    unread: bytes = b""
    printed: bytes = b""
    status: int | None = None

    def read_news(self, tell: Tell) -> None:
        """Takes in the lines that have come."""
        chunk = os.read(self.news, _CHUNK)
        self.closed = not chunk
        *lines, self.unread = (self.unread + chunk).split(b"\n")
        for line in lines:
            message = json.loads(line)
            self.silent_s = 0.0
            if "epoch" in message:
                self.epoch = message["epoch"]
                tell(Report(self.job.name, self.epoch, message["fitness"]))
            else:
                self.result = message

    def read_output(self) -> None:
        """Hands on what it has printed, and keeps the end of it."""
        chunk = os.read(self.output, _CHUNK)
        self.mute = not chunk
        self.printed = (self.printed + chunk)[-_LAST_BYTES:]
        sys.stderr.write(chunk.decode(errors="replace"))

    def outcome(self, passed_s: float, silence_s: float) -> Outcome | None:
        """Returns what the training left, None while it goes on.

        Args:
            passed_s: seconds since this was asked last.
            silence_s: seconds that it may take without a report.

        Raises:
            PorseError: the training found that the program cannot go on.
        """
        if self.result is not None:
            return received(self.result)
        self.silent_s += passed_s
        if self.status is None:
            process, status = os.waitpid(self.process, os.WNOHANG)
            self.status = status if process else None
        if self.status is not None:
            if _is_waiting(self.news) and not self.closed:
                return None  # its last line is still to be read
            self._drain()
            return Outcome([], f"{_ending(self.status)}{self._when()}{self._last_words()}", outside=True)
        if self.silent_s > silence_s:
            return Outcome(
                [], f"its process made no progress for {silence_s} s{self._when()}{self._last_words()}", outside=True
            )
        return None

    def end(self) -> None:
        """Ends its process, if it still runs, and closes its pipes."""
        if self.status is None:
            os.kill(self.process, signal.SIGKILL)
            os.waitpid(self.process, 0)
        self._drain()
        os.close(self.news)
        os.close(self.output)

    def _drain(self) -> None:
        """Reads what it has printed last. A pipe holds no more than this, and who else writes to it is not waited for."""
        for _ in range(_PIPE_BYTES // _CHUNK):
            if self.mute or not _is_waiting(self.output):
                return
            self.read_output()

    def _when(self) -> str:
        return f", after epoch {self.epoch}" if self.epoch else ", before it had done an epoch"

    def _last_words(self) -> str:
        words = last_words(self.printed.decode(errors="replace"))
        return f"; it printed last: {words}" if words else ""


def message_of(end: Outcome | PorseError) -> dict[str, Any]:
    """Returns how a training ended as plain data between processes."""
    if isinstance(end, PorseError):
        return {"error": type(end).__name__, "text": str(end)}
    return {"rows": end.rows, "failure": end.failure, "outside": end.outside}


def received(message: Mapping[str, Any]) -> Outcome:
    """Returns the outcome that a training has sent.

    Raises:
        PorseError: it has sent that the program cannot go on.
    """
    if "error" in message:
        kind = getattr(errors, message["error"], PorseError)
        raise kind(message["text"])
    rows = [(epoch, series, value) for epoch, series, value in message["rows"]]
    return Outcome(rows, message["failure"], message["outside"])


def _ending(status: int) -> str:
    code = os.waitstatus_to_exitcode(status)
    if code >= 0:
        return f"its process ended by itself with code {code}"
    try:
        return f"its process was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"its process was ended by signal {-code}"


def _listen(running: Sequence[_Training], tell: Tell) -> None:
    """Waits for news of the trainings, at most one tick, and takes it in."""
    with selectors.DefaultSelector() as selector:
        for training in running:
            if not training.closed:
                selector.register(training.news, selectors.EVENT_READ, training)
            if not training.mute:
                selector.register(training.output, selectors.EVENT_READ, training)
        for key, _ in selector.select(_TICK_S):
            training = key.data
            if key.fd == training.news:
                training.read_news(tell)
            else:
                training.read_output()


def _is_waiting(end: int) -> bool:
    """Returns whether a pipe has something to read, its end included."""
    return bool(select.select([end], [], [], 0.0)[0])


Train = Callable[[Job, Callable[[int, float], None]], Outcome]


def _start(job: Job, train: Train, limits: Limits, others: Sequence[_Training]) -> _Training:
    """Forks the process of a training."""
    news, telling = os.pipe()
    output, printing = os.pipe()
    # What is not flushed would be printed twice.
    sys.stdout.flush()
    sys.stderr.flush()
    parent = os.getpid()
    with warnings.catch_warnings():
        # Python 3.12 warns where there are threads. Those of Arrow are idle, and a training does not use it.
        warnings.simplefilter("ignore", DeprecationWarning)
        process = os.fork()
    if process == 0:
        _train_here(job, train, limits, parent, telling, printing, [news, output, *_ends(others)])
    os.close(telling)
    os.close(printing)
    return _Training(job, process, news, output, epoch=job.begun)


def _ends(others: Sequence[_Training]) -> list[int]:
    return [end for other in others for end in (other.news, other.output)]


def _train_here(
    job: Job, train: Train, limits: Limits, parent: int, telling: int, printing: int, foreign: Sequence[int]
) -> NoReturn:
    """Becomes a training and ends. Runs in the child."""
    code = 1
    try:
        die_with_parent(parent)
        # A key in the terminal reaches all of its processes: the parent decides.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        os.dup2(printing, 1)
        os.dup2(printing, 2)
        os.close(printing)
        # The caller's may lead elsewhere: to a notebook, to a test's record.
        faulthandler.disable()
        sys.stdout, sys.stderr = (os.fdopen(end, "w", buffering=1, errors="replace", closefd=False) for end in (1, 2))
        for end in foreign:
            os.close(end)
        limit_memory(limits.memory_mib)

        def send(message: dict[str, Any]) -> None:
            line = json.dumps(message).encode() + b"\n"
            while line:
                line = line[os.write(telling, line) :]

        try:
            outcome = train(job, lambda epoch, fitness: send({"epoch": epoch, "fitness": fitness}))
            send(message_of(outcome))
        except PorseError as error:
            send(message_of(error))
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            # Whatever became of the pipes, the child does not go on as its parent. To take PyTorch apart takes a second more.
            os._exit(code)
