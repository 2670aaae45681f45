"""The parent's side of the probe: one child process that loads torch once, and a verdict for each source sent to it."""

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from porse.errors import PorseError
from porse.functions.read.limits import Limits
from porse.functions.verdict import Kind, Verdict
from porse.numerics import ENVIRONMENT
from porse.variables import Variable

_MAX_ANSWER = 4_000_000
_LARGE_PAGES = {"PYTHONMALLOC": "malloc", "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}
"""Python's memory from the C library, and that in pages of 2 MiB: a fork then takes a third of the time."""


class ProbeError(PorseError):
    """The probe process could not start or could not get the states to try functions on."""


class Sandbox:
    """A running probe. It starts at once, so that torch loads while the caller prepares states.

    The child gets a scrubbed environment, an empty working directory, a session of its own and no open files but its
    two pipes. What each function may use is limited in `porse.functions.read.confine`.
    """

    def __init__(self, limits: Limits, module: str = "porse.functions.read.probe") -> None:
        """Starts the child process.

        Args:
            limits: what one function may use.
            module: the program of the child, which calls `porse.functions.read.probe.serve`.
        """
        self._limits = limits
        self._module = module
        self._request: dict[str, Any] | None = None
        self._start()

    def _start(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="porse-probe-")
        root = str(Path(__file__).resolve().parents[3])
        environment = {**ENVIRONMENT["portable"], "PYTHONPATH": root, "LC_ALL": "C.UTF-8", "HOME": self._folder.name}
        environment |= {
            "TMPDIR": self._folder.name,
            "PYTHONHASHSEED": "0",
            "PYTHONDONTWRITEBYTECODE": "1",
            **_LARGE_PAGES,
        }
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-s", "-m", self._module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=self._folder.name,
            env=environment,
            start_new_session=True,
        )
        self._send({"limits": asdict(self._limits)})

    def __enter__(self) -> Self:
        """Returns itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Ends the child process and all that it started."""
        self.close()

    def close(self) -> None:
        """Ends the child process and all that it started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        self._folder.cleanup()

    def load(self, states: Path, variables: Sequence[Variable]) -> None:
        """Makes the child read real states of a task from a file; waits until it has.

        Raises:
            ProbeError: the child did not start, or cannot read the file.
        """
        self.prepare({"states": str(states.resolve()), "variables": [asdict(variable) for variable in variables]})

    def prepare(self, request: dict[str, Any]) -> list[Variable]:
        """Makes the child get its states as its program does, and returns the variables that they are of.

        Raises:
            ProbeError: it could not.
        """
        self._request = request
        self._send(request)
        answer = self._receive(self._limits.startup_s)
        if answer.get("ready") is not True:
            found = answer.get("error") or "the process that tries functions out ended, or did not start in time"
            raise ProbeError(str(found))
        return [Variable(**{**v, "shape": tuple(v["shape"])}) for v in answer["variables"]]

    def judge(self, reply: str, kind: Kind) -> tuple[Verdict, str]:
        """Returns the verdict on one reply and the source of the function in it, "" when it did not pass."""
        self._send({"reply": reply, "kind": kind})
        answer = self._receive(2 * self._limits.wall_s + 10.0)
        try:
            found = answer["verdict"]
            verdict = Verdict(
                passed=bool(found["passed"]),
                check=found["check"],
                message=str(found["message"])[:4000],
                line=int(found["line"]),
                names=tuple(str(name) for name in found["names"]),
                rises=tuple(bool(rise) for rise in found["rises"]),
                warning=str(found["warning"])[:4000],
                program=str(found["program"]),
            )
            return verdict, str(answer["source"])
        except (KeyError, TypeError, ValueError):
            self._restart()
            return Verdict(False, "crash", "the probe process ended while it ran this function", 0), ""

    def _restart(self) -> None:
        """Starts a new child in place of one that is of no use any more."""
        self.close()
        self._start()
        if self._request is not None:
            self.prepare(self._request)

    def _send(self, message: dict[str, Any]) -> None:
        assert self._process.stdin is not None  # it was opened as a pipe
        with contextlib.suppress(BrokenPipeError):  # a child that has ended is noticed when it does not answer
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()

    def _receive(self, timeout_s: float) -> dict[str, Any]:
        """Returns the next line of the child as JSON, {} when there is none in time."""
        assert self._process.stdout is not None  # it was opened as a pipe
        ready, _, _ = select.select([self._process.stdout], [], [], timeout_s)
        line = self._process.stdout.readline(_MAX_ANSWER) if ready else b""
        try:
            answer = json.loads(line) if line else {}
        except ValueError:
            return {}
        return answer if isinstance(answer, dict) else {}
