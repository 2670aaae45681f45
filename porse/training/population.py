"""Trains a pool of candidates side by side: one process a candidate, one thread a process.

A candidate's process is forked from a server that has imported everything and computed nothing, so that the result
depends neither on the number of workers nor on what ran before it, and starting one costs milliseconds, not seconds.
"""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Lock
from threading import Thread

from porse.config import Params
from porse.errors import ParamsError
from porse.processes import die_with_parent
from porse.task_names import class_name, is_own
from porse.training.job import Job, Outcome, Report

WORKERS_VARIABLE = "PORSE_WORKERS"


def workers() -> int:
    """Returns how many candidates are trained at once: PORSE_WORKERS, or the CPUs that this process may use.

    Raises:
        ParamsError: PORSE_WORKERS is no positive number.
    """
    text = os.environ.get(WORKERS_VARIABLE, "")
    if not text:
        return len(os.sched_getaffinity(0))
    if not text.isdecimal() or int(text) < 1:
        raise ParamsError(
            f"expected {WORKERS_VARIABLE} to be a number of processes, 1 or more, found {text!r} in the environment; set or unset it"
        )
    return int(text)


def train_pool(jobs: Sequence[Job], params: Params, on_report: Callable[[Report], None]) -> list[Outcome]:
    """Trains all jobs and returns their outcomes, in the order of the jobs.

    Raises:
        CheckpointError: a start is missing or damaged.
    """
    if not jobs:
        return []
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["porse.training.server", _task_module(params.task)])
    receiver, sender = context.Pipe(duplex=False)
    line = _Line(sender, context.Lock())
    with (
        _told(receiver, line, on_report),
        ProcessPoolExecutor(
            max_workers=max(1, min(workers(), len(jobs))),
            mp_context=context,
            initializer=_remember,
            initargs=(line,),
            max_tasks_per_child=1,
        ) as pool,
    ):
        futures: list[Future[Outcome]] = [pool.submit(_run, job, params) for job in jobs]
        return [future.result() for future in futures]


def _task_module(task: str) -> str:
    """Returns the module that children of a run import for its task; code of one's own runs in the children alone."""
    return "porse.tasks.base" if is_own(task) else class_name(task).partition(":")[0]


@dataclass(frozen=True)
class _Line:
    """Where children report to. When the process that listens has died, the next report ends its child."""

    sender: Connection
    lock: Lock

    def send(self, report: Report | None) -> None:
        with self.lock:
            self.sender.send(report)


@contextmanager
def _told(receiver: Connection, line: _Line, on_report: Callable[[Report], None]) -> Iterator[None]:
    """Calls `on_report` for everything that arrives while the block runs."""

    def listen() -> None:
        while (report := receiver.recv()) is not None:
            on_report(report)

    listener = Thread(target=listen, daemon=True)
    listener.start()
    try:
        yield
    finally:
        line.send(None)
        listener.join()
        receiver.close()
        line.sender.close()


_line: _Line | None = None
"""The parent's line, in a child."""


def _remember(line: _Line) -> None:
    global _line
    die_with_parent()
    _line = line


def _run(job: Job, params: Params) -> Outcome:
    """Runs in the child: trains one candidate."""
    # Only children import torch; the parent stays light, and forking it is never needed.
    from porse.training.candidate import train_candidate

    def report(epoch: int, fitness: float) -> None:
        if _line is not None:
            _line.send(Report(job.name, epoch, fitness))

    return train_candidate(job, params, report)
