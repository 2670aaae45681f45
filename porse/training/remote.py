"""Trainings on other machines: every job an order, and a machine that is lost is replaced.

What a candidate does to itself is its own failure here as with `porse.training.local`, word by word: on its machine it *is* a
local training. A machine, or a process of Ray's, that is lost says nothing about the candidate: the order is given again, and
the training goes on after its last checkpoint.
"""

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from porse.config import Params, document_of
from porse.errors import PorseError
from porse.training.job import Ended, Job, Report, Tell
from porse.training.limits import MEMORY_VARIABLE, SILENCE_VARIABLE, Limits
from porse.training.local import received
from porse.training.node import job_document

LOSSES = 5
"""So many machines may be lost under one training; who loses more finds no good one."""

_TICK_S = 0.5
_FORWARDED = (MEMORY_VARIABLE, SILENCE_VARIABLE, "PYTHONPATH")
"""What this process's environment says to those on other machines, where it says it."""


class LostError(Exception):
    """What ran an order is gone, and nobody will answer it. Its text says how, as far as that is known."""


@dataclass(frozen=True)
class Errand:
    """A process to be run on some machine: plain data.

    Attributes:
        command: its words; the first is a path that is the same everywhere.
        folder: the folder that it starts in.
        environment: what is added to the few variables that it gets of the machine's own.
        stdin: what it reads.
        stderr: the file for what it prints.
        gpus: GPUs that it has to itself.
        cpus: CPUs that it is reckoned with.
    """

    command: Sequence[str]
    folder: str
    environment: dict[str, str]
    stdin: str
    stderr: str
    gpus: int = 0
    cpus: int = 1


def stdout_of(answer: Mapping[str, str]) -> str:
    """Returns what an errand wrote to stdout, from its answer: {"stdout": ...}, {"lost": why} or {"refused": why}.

    Raises:
        LostError: it was lost before it was done.
        PorseError: it could not be started.
    """
    if "refused" in answer:
        raise PorseError(answer["refused"])
    if "lost" in answer:
        raise LostError(answer["lost"])
    return answer["stdout"]


class Machines(Protocol):
    """Machines that run errands."""

    def start(self, errand: Errand) -> Any:
        """Starts an errand as soon as there is room, and returns a handle to it, which is hashable.

        Raises:
            PorseError: no machine will ever have room for it.
        """
        ...

    def ended(self, handles: Sequence[Any], timeout_s: float) -> Sequence[Any]:
        """Returns those that have ended, after some have or the time is over."""
        ...

    def answer(self, handle: Any) -> str:
        """Returns what an ended one wrote to stdout.

        Raises:
            LostError: it was lost before it was done.
            PorseError: it could not be started.
        """
        ...

    def stop(self, handle: Any) -> None:
        """Ends one."""
        ...


Open = Callable[[], AbstractContextManager[Machines]]
"""Connects to machines, for as long as they are needed."""


class Remote:
    """Trains on the machines of a cluster. See `porse.training.executor.Executor`.

    Args:
        limits: what this machine's trainings may use. Others count their own; what the environment sets holds everywhere.
        every_s: seconds of training from one checkpoint to the next.
        machines: where trainings run.
    """

    def __init__(self, limits: Limits, every_s: int, machines: Open) -> None:
        self._limits, self._every_s, self._machines = limits, every_s, machines

    def run(self, jobs: Sequence[Job], params: Params, tell: Tell) -> None:
        """Trains every job once and tells of each epoch and of each end."""
        if not jobs:
            return
        with self._machines() as machines, _folders(jobs) as folders:
            running: dict[Any, _Training] = {}
            try:
                for job, folder in zip(jobs, folders, strict=True):
                    training = _Training(job, folder)
                    running[machines.start(training.errand(params, self._every_s))] = training
                while running:
                    ended = machines.ended([*running], _TICK_S)
                    for training in running.values():
                        training.hear(tell)
                    for handle in ended:
                        training = running.pop(handle)
                        try:
                            answer = machines.answer(handle)
                        except LostError as lost:
                            training.lose(lost)
                            running[machines.start(training.errand(params, self._every_s))] = training
                        else:
                            training.end(answer, tell)
            finally:
                for handle in running:
                    machines.stop(handle)


@contextmanager
def _folders(jobs: Sequence[Job]) -> Iterator[list[Path]]:
    """Makes an empty folder for the parts of each job, beside the file that it is to write, and takes it away at the end."""
    folders = [job.finish.with_name(f"{job.finish.stem}.parts").absolute() for job in jobs]
    try:
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
        yield folders
    finally:
        for folder in folders:
            shutil.rmtree(folder, ignore_errors=True)


class _Training:
    """A training that runs somewhere, as this process knows it.

    Args:
        job: what is trained.
        folder: where its parts are.
    """

    def __init__(self, job: Job, folder: Path) -> None:
        self._job, self._folder = job, folder
        self._attempt = 0
        self._read, self._unread, self._told = 0, b"", 0

    def errand(self, params: Params, every_s: int) -> Errand:
        """Returns the process that makes the next attempt."""
        job = {**job_document(self._job), "finish": str(self._file("end.safetensors"))}
        order = {
            "job": job,
            "params": document_of(params),
            "folder": str(self._folder),
            "news": str(self._file("news.txt")),
            "attempt": self._attempt,
            "every_s": every_s,
        }
        given = {name: os.environ[name] for name in _FORWARDED if os.environ.get(name)}
        command = (sys.executable, "-m", "porse.training.node")
        # A training that is on a GPU has it to itself.
        gpus = int(is_on_gpu(params.device))
        return Errand(command, str(Path.cwd()), given, json.dumps(order), str(self._file("stderr.txt")), gpus=gpus)

    def hear(self, tell: Tell) -> None:
        """Takes in what the attempt at work has told, and tells what is new: an epoch is done again after a loss."""
        try:
            with self._file("news.txt").open("rb") as news:
                news.seek(self._read)
                chunk = news.read()
        except FileNotFoundError:
            return
        self._read += len(chunk)
        *lines, self._unread = (self._unread + chunk).split(b"\n")
        for message in map(json.loads, lines):
            if message["epoch"] > self._told:
                self._told = message["epoch"]
                tell(Report(self._job.name, self._told, message["fitness"]))

    def lose(self, lost: LostError) -> None:
        """Makes the next attempt another one.

        Raises:
            PorseError: this happens too often.
        """
        self._attempt += 1
        self._read, self._unread = 0, b""
        if self._attempt > LOSSES:
            raise PorseError(
                f"expected a machine that trains {self._job.name} to its end, found that {self._attempt} were lost under it, "
                f"the last one so: {lost}; look at `ray status` and the machines' memory, then run this again"
            )

    def end(self, answer: str, tell: Tell) -> None:
        """Takes in how it ended, and puts its checkpoint in its place.

        Raises:
            PorseError: the training found that the program cannot go on.
        """
        self.hear(tell)
        printed = self._file("stderr.txt")
        if printed.is_file():
            sys.stderr.write(printed.read_text(encoding="utf-8", errors="replace"))
        outcome = received(json.loads(answer))
        if not outcome.failure:
            self._file("end.safetensors").replace(self._job.finish)
        tell(Ended(self._job.name, outcome))

    def _file(self, name: str) -> Path:
        return self._folder / f"{self._attempt}-{name}"


def is_on_gpu(device: str) -> bool:
    """Returns whether a device, as `params.yaml` names it, is a GPU."""
    return device.startswith("cuda")
