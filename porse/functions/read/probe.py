"""The child's side of the sandbox: `python -m porse.functions.read.probe LIMITS`, lines of JSON in and out.

It loads torch once. Two confined processes serve every reply: one reads it, runs it as Python and leaves an operator list;
the other tries the list and judges. What one function breaks ends with its own process. They are forked before they are
needed, so that the next two come into being while the present ones work.
"""

import contextlib
import json
import os
import signal
import socket
import sys
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import torch

from porse.functions.read.check import check_source
from porse.functions.read.confine import Limits, confine, seal
from porse.functions.read.extract import extract
from porse.functions.read.messages import receive, send
from porse.functions.read.source import parse
from porse.functions.read.states import unpacked
from porse.functions.read.trace import trace
from porse.functions.read.trial import make_sleef, try_program
from porse.functions.run.shapes import TOO_MUCH
from porse.functions.verdict import CodeError, Kind

_WARM = """
def compute_reward(x):
    d = torch.norm(x, dim=-1) + torch.norm(x, p=2, dim=1) + torch.norm(x) + torch.einsum('ij,ij->i', x, x)
    p, q = torch.split(x, [1, 2], dim=-1)
    s = torch.split(x, 1, dim=-1)[0] + F.normalize(x, dim=-1) + torch.cdist(x[:9], x[:9]).sum()
    u, v = torch.broadcast_tensors(x, x)
    s = s + F.softplus(x) + F.huber_loss(x, q.sum()) + F.gelu(x) + torch.special.expit(x)
    return torch.exp(-d) + p.sum() + s.sum() + u.sum() + torch.atleast_1d(x).sum(-1), {f'd_{0.5:.1f}': d}
"""
"""A function after which Python and torch have prepared what they prepare once: later no file can be read."""


def serve(load: Callable[[dict[str, Any]], Mapping[str, Any]]) -> None:
    """Serves requests from standard input until it ends: states, then replies. Its limits are its argument.

    Args:
        load: from the request for states to the values of a task's variables in them.
    """
    torch.set_num_threads(1)
    limits = Limits(**json.loads(sys.argv[1]))
    answers = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    _warm_up()
    seal()
    pool = _Pool(limits)
    for line in sys.stdin.buffer:
        request = json.loads(line)
        if "reply" in request:
            send(answers, _judged(request, pool))
            continue
        try:
            pool.renew(load(request))
            send(answers, {"ready": True})
        except Exception as error:  # whatever is wrong with the states is told to the parent
            send(answers, {"error": str(error)})


def _warm_up() -> None:
    make_sleef()
    values = {"x": torch.linspace(-1.0, 1.0, 48).reshape(16, 3), "num_envs": 16}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for reply in ("def compute_reward(x:\n", _WARM.replace("q.sum()", "q.sum().item()"), _WARM):
            found = _done({"reply": reply, "kind": "reward"}, values)
        _done(found, values)


def _judged(request: Mapping[str, Any], pool: "_Pool") -> dict[str, Any]:
    """Returns the parts of the verdict on one reply, and the source that it holds, "" where it did not pass."""
    read = pool.done(request)
    if "check" in read:
        return {**read, "passed": False, "source": ""}
    text = str(read.get("program"))
    tried = pool.done({"program": text})
    if "check" in tried:
        line = read.get("line") if "line" in tried else 0  # of a process that has ended nobody knows it
        return {**tried, "passed": False, "line": line, "source": ""}
    return {**tried, "passed": True, "check": "ok", "message": "", "program": text, "source": read.get("source")}


def _done(request: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns what comes of a reply, or of a list: a list with its source, or the parts of a verdict."""
    try:
        if "reply" in request:
            return _read(request["reply"], request["kind"], values)
        return try_program(request["program"], values)
    except CodeError as error:
        return {"check": error.check, "message": str(error), "line": error.line}
    except MemoryError:
        return {"check": "memory", "message": TOO_MUCH, "line": 0}


def _read(reply: str, kind: Kind, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the operator list of the function in a reply, its own text, and the line that a verdict is about."""
    extracted = extract(reply, kind)
    try:
        source = parse(extracted.source)
        check_source(source, values)
        program = trace(source, kind, values)
    except CodeError as error:
        raise CodeError(error.check, str(error), extracted.line_of(error.line)) from None
    return {"program": program.text, "source": extracted.source, "line": extracted.line_of(source.last_line)}


class _Pool:
    """Confined processes that wait, each for one piece of work, after which it ends; `limits` is what one may use."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._values: Mapping[str, Any] = {}
        self._waiting: list[tuple[int, int]] = []
        self._ending: list[int] = []

    def renew(self, values: Mapping[str, Any]) -> None:
        """Has other states from now on, the values of a task's variables."""
        self._values = values
        while self._waiting:
            self._end(*self._waiting.pop())

    def done(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Returns what comes of a request, or the check and the message of a refusal where nothing does."""
        process, pipe = self._waiting.pop(0) if self._waiting else self._forked()
        found, in_time = {}, True
        with contextlib.suppress(BrokenPipeError):
            send(pipe, request)
        while len(self._waiting) < 2:
            self._waiting.append(self._forked())
        try:
            found = receive(pipe, self._limits.wall_s)
        except TimeoutError:
            in_time = False
        self._end(process, pipe)
        if found:
            return found
        ended = os.waitstatus_to_exitcode(os.waitpid(self._ending.pop(), 0)[1])
        if not in_time or ended == -signal.SIGXCPU:
            seconds = f"{self._limits.wall_s:g} s"
            message = f"the function did not finish within {seconds}; use tensor operations, not long loops"
            return {"check": "time", "message": message}
        if ended == -signal.SIGKILL:
            return {"check": "memory", "message": TOO_MUCH}
        return {"check": "crash", "message": "the function ended its process"}

    def _forked(self) -> tuple[int, int]:
        """Returns a new process, and the pipe to it."""
        ours, its = socket.socketpair()
        process = os.fork()
        if process == 0:
            try:
                with open(its.fileno(), "rb", closefd=False) as requests:
                    confine(self._limits, keep=its.fileno())
                    send(its.fileno(), _done(json.loads(requests.readline()), self._values))
            finally:
                os._exit(0)
        its.close()
        return process, ours.detach()

    def _end(self, process: int, pipe: int) -> None:
        """Ends a process, and waits for those alone that are gone: to take one apart takes longer than its work did."""
        os.close(pipe)
        os.kill(process, signal.SIGKILL)
        self._ending = [earlier for earlier in self._ending if os.waitpid(earlier, os.WNOHANG)[0] == 0]
        self._ending.append(process)


if __name__ == "__main__":
    serve(unpacked)
