"""The parent's side of the probe: one child process that loads torch once, a verdict for each reply, and their messages."""

import contextlib
import json
import os
import signal
import socket
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from subprocess import DEVNULL, Popen
from typing import Any, get_args

from porse.errors import PorseError
from porse.functions.read.confine import Limits
from porse.functions.verdict import Check, Kind, Verdict
from porse.numerics import ENVIRONMENT

_LARGE_PAGES = {"PYTHONMALLOC": "malloc", "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}
"""Python's memory from the C library, and that in pages of 2 MiB: a fork then takes a third of the time."""


class ProbeError(PorseError):
    """The probe process could not start or could not get the states to try functions on."""


class Sandbox(contextlib.ExitStack):
    """A running probe, which ends with its context. It starts at once, so that torch loads while the caller prepares states.

    The child gets a scrubbed environment, an empty working directory, a session of its own and no open file but the
    socket to its parent. What each function may use is limited in `porse.functions.read.confine`.
    """

    def __init__(self, limits: Limits, module: str = "porse.functions.read.probe") -> None:
        """Starts the child process.

        Args:
            limits: what one function may use.
            module: the program of the child, which calls `porse.functions.read.probe.serve`.
        """
        super().__init__()
        self._limits = limits
        self._module = module
        self._request: dict[str, Any] = {}
        self._start()

    def _start(self) -> None:
        folder = self.enter_context(tempfile.TemporaryDirectory(prefix="porse-probe-"))
        clean = {**ENVIRONMENT["portable"], **_LARGE_PAGES, "PYTHONHASHSEED": "0", "PYTHONDONTWRITEBYTECODE": "1"}
        clean |= {"LC_ALL": "C.UTF-8", "HOME": folder, "TMPDIR": folder}
        clean["PYTHONPATH"] = str(Path(__file__).resolve().parents[3])
        command = [sys.executable, "-P", "-s", "-m", self._module, json.dumps(asdict(self._limits))]
        ours, its = socket.socketpair()
        self._peer = self.enter_context(ours)
        process = Popen(
            command, stdin=its.fileno(), stdout=DEVNULL, stderr=DEVNULL, cwd=folder, env=clean, start_new_session=True
        )
        its.close()
        self._process = self.enter_context(process)
        self.callback(self._kill)

    def _kill(self) -> None:
        """Ends the child process and all that it started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def prepare(self, request: dict[str, Any]) -> None:
        """Makes the child get its states as its program does.

        Raises:
            ProbeError: it could not.
        """
        self._request = request
        send(self._peer, request)
        answer = receive(self._peer, self._limits.startup_s) or {}
        if "ready" not in answer:
            found = answer.get("error") or "the process that tries functions out ended, or did not start in time"
            raise ProbeError(str(found))

    def judge(self, reply: str, kind: Kind) -> tuple[Verdict, str]:
        """Returns the verdict on one reply and the source of the function in it, "" when it did not pass."""
        send(self._peer, {"reply": reply, "kind": kind})
        answer = receive(self._peer, self._limits.wall_s + 10.0) or {}
        try:
            verdict = _verdict(answer)
            return verdict, str(answer["source"]) if verdict.passed else ""
        except (KeyError, TypeError, ValueError, OverflowError):
            self.close()
            self._start()
            self.prepare(self._request)
            return Verdict(False, "crash", "the probe process ended while it ran this function", 0), ""


def _verdict(found: Mapping[str, Any]) -> Verdict:
    """Returns the verdict that an answer holds, each part as what it should be: it comes from who ran a function."""
    return Verdict(
        passed="program" in found,
        check=found["check"] if found["check"] in get_args(Check) else "crash",
        message=str(found["message"])[:4000],
        line=int(found.get("line", 0)),
        names=tuple(map(str, found.get("names", ()))),
        rises=tuple(map(bool, found.get("rises", ()))),
        warning=str(found.get("warning", ""))[:4000],
        program=str(found.get("program", "")),
    )


def send(peer: socket.socket, message: Mapping[str, Any]) -> None:
    """Sends a message, to nobody where the peer has ended."""
    with contextlib.suppress(ConnectionError):
        peer.sendall(json.dumps(message).encode() + b"\n")


def receive(peer: socket.socket, wall_s: float) -> dict[str, Any] | None:
    """Returns the next message of an untrusted peer, {} where it ends, sends anything else or 4 MB, None where it is late."""
    peer.settimeout(wall_s)
    try:
        with peer.makefile("rb") as messages:
            found = json.loads(messages.readline(4_000_000))
            return found if isinstance(found, dict) else {}
    except TimeoutError:
        return None
    except (ConnectionError, ValueError, RecursionError):
        return {}
