"""The child's side of the sandbox: `python -m porse.functions.read.probe LIMITS`, lines of JSON in and out.

It loads torch once. Two confined processes serve every reply: one reads it, runs it as Python and leaves an operator list;
the other tries the list and judges. What one function breaks ends with its own process. They are forked before they are
needed, so that the next two come into being while the present ones work.
"""

import json
import multiprocessing
import os
import signal
import socket
import sys
import warnings
from collections.abc import Callable, Mapping
from multiprocessing.context import ForkProcess
from typing import Any

import torch

from porse.functions.read.check import check_source
from porse.functions.read.confine import Limits, confine, seal
from porse.functions.read.extract import extract
from porse.functions.read.messages import receive, send
from porse.functions.read.states import unpacked
from porse.functions.read.trace import trace
from porse.functions.read.trial import try_program
from porse.functions.run.shapes import TOO_MUCH
from porse.functions.verdict import CodeError, Kind

_WARM = """
def compute_reward(x):
    d = torch.norm(x, dim=-1) + torch.norm(x, p=2, dim=1) + torch.norm(x) + torch.einsum('ij,ij->i', x, x)
    p, q = torch.split(x, [1, 2], dim=-1)
    s = torch.split(x, 1, dim=-1)[0] + F.normalize(x, dim=-1) + torch.cdist(x[:9], x[:9]).sum()
    u, v = torch.broadcast_tensors(x, x)
    y, functions = x * x * 0.4 + 0.1, (torch.acos, torch.asin, torch.atan, torch.tan, torch.log10)
    s = s + sum([f(y.to(t)).sum() for f in functions for t in (torch.float32, torch.float64)])
    s = s + F.softplus(x) + F.huber_loss(x, q.sum()) + F.gelu(x) + torch.special.expit(x)
    return torch.exp(-d) + p.sum() + s.sum() + u.sum() + torch.atleast_1d(x).sum(-1), {f'd_{0.5:.1f}': d}
"""
"""A function after which Python and torch have prepared what they prepare once: later no file can be read."""


def serve(load: Callable[[dict[str, Any]], Mapping[str, Any]]) -> None:
    """Serves requests from its parent until that ends: states, then replies. Its limits are its argument.

    Args:
        load: from the request for states to the values of a task's variables in them.
    """
    torch.set_num_threads(1)
    limits = Limits(**json.loads(sys.argv[1]))
    _warm_up()
    seal()
    pool = _Pool(limits, {})
    with socket.socket(fileno=0) as parent, parent.makefile("rb") as requests:
        for line in requests:
            request = json.loads(line)
            if "reply" in request:
                send(parent, _judged(request, pool))
                continue
            try:
                pool = _Pool(limits, load(request))
                send(parent, {"ready": True})
            except Exception as error:  # whatever is wrong with the states is told to the parent
                send(parent, {"error": str(error)})


def _warm_up() -> None:
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
    source = extract(reply, kind)
    check_source(source, values)
    program = trace(source, kind, values)
    return {"program": program.text, "source": source.text, "line": source.last_line}


class _Pool:
    """Confined processes that wait, each for one piece of work, after which it ends.

    Args:
        limits: what one of them may use.
        values: the values of a task's variables in real states.
    """

    def __init__(self, limits: Limits, values: Mapping[str, Any]) -> None:
        self._limits, self._values = limits, values
        self._waiting: list[tuple[ForkProcess, socket.socket]] = []

    def done(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Returns what comes of a request, or the check and the message of a refusal where nothing does."""
        process, peer = self._waiting.pop(0) if self._waiting else self._forked()
        send(peer, request)
        while len(self._waiting) < 2:
            self._waiting.append(self._forked())
        with peer:
            try:
                found, in_time = receive(peer, self._limits.wall_s), True
            except TimeoutError:
                found, in_time = {}, False
        if found:
            process.kill()  # to end takes longer than its work did; nobody waits for it
            return found
        if not in_time:
            process.kill()
        process.join()
        if not in_time or process.exitcode == -signal.SIGXCPU:
            seconds = f"{self._limits.wall_s:g} s"
            message = f"the function did not finish within {seconds}; use tensor operations, not long loops"
            return {"check": "time", "message": message}
        if process.exitcode == -signal.SIGKILL:
            return {"check": "memory", "message": TOO_MUCH}
        return {"check": "crash", "message": "the function ended its process"}

    def _forked(self) -> tuple[ForkProcess, socket.socket]:
        """Returns a new process, and the pipe to it."""
        ours, its = socket.socketpair()
        process = multiprocessing.get_context("fork").Process(target=self._serve_one, args=(its,))
        process.start()
        its.close()
        return process, ours

    def _serve_one(self, pipe: socket.socket) -> None:
        """Answers one request, in a process that can do nothing else."""
        keep = pipe.fileno()
        try:
            with open(keep, "rb", closefd=False) as requests, open(keep, "wb", closefd=False) as answers:
                confine(self._limits, keep)
                answers.write(json.dumps(_done(json.loads(requests.readline()), self._values)).encode() + b"\n")
        finally:
            os._exit(0)


if __name__ == "__main__":
    serve(unpacked)
