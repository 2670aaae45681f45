"""The child's side of the sandbox: `python -m porse.functions.read.probe LIMITS`, lines of JSON in and out.

It loads torch once, and forks a confined process for every reply, which reads it, runs it as Python, and tries the operator
list that comes of that. What one function breaks ends with its process, which answers with one document; that is data.
"""

import json
import multiprocessing
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
from porse.functions.read.sandbox import receive, send
from porse.functions.read.states import unpacked
from porse.functions.read.trace import trace
from porse.functions.read.trial import try_program
from porse.functions.run.program import read_program
from porse.functions.run.shapes import TOO_MUCH
from porse.functions.verdict import CodeError

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
    values: Mapping[str, Any] = {"x": torch.linspace(-1.0, 1.0, 48).reshape(16, 3), "num_envs": 16}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for reply in ("def compute_reward(x:\n", _WARM.replace("q.sum()", "q.sum().item()"), _WARM):
            _answer({"reply": reply, "kind": "reward"}, values)
    seal()
    with socket.socket(fileno=0) as parent, parent.makefile("rb") as requests:
        for line in requests:
            request = json.loads(line)
            if "reply" in request:
                send(parent, _judged(request, values, limits))
                continue
            try:
                values = load(request)
                send(parent, {"ready": True})
            except Exception as error:  # whatever is wrong with the states is told to the parent
                send(parent, {"error": str(error)})


def _judged(request: Mapping[str, Any], values: Mapping[str, Any], limits: Limits) -> dict[str, Any]:
    """Returns the parts of the verdict on a reply, and the source in it: what a confined process says, and that alone."""
    ours, its = socket.socketpair()
    process = multiprocessing.get_context("fork").Process(target=_serve_one, args=(its, request, values, limits))
    process.start()
    its.close()
    with ours:
        found = receive(ours, limits.wall_s)
    if found == {}:
        process.join(1.0)  # it has let go of its socket, so it ends
    ended = process.exitcode if found is not None else None
    process.kill()  # to end takes longer than its work did; nobody waits for one that has answered
    if found and "program" in found:
        try:
            program = read_program(str(found["program"]))
            return {**found, "check": "ok", "message": "", "names": program.names, "rises": program.rises}
        except CodeError as error:
            return {"check": error.check, "message": str(error)}
    late = (
        f"the function did not finish within {limits.cpu_s} s of processor time; use tensor operations, not long loops"
    )
    reasons = {None: ("time", late), -signal.SIGXCPU: ("time", late), -signal.SIGKILL: ("memory", TOO_MUCH)}
    check, message = reasons.get(ended, ("crash", "the function ended its process"))
    return found or {"check": check, "message": message}


def _serve_one(pipe: socket.socket, request: Mapping[str, Any], values: Mapping[str, Any], limits: Limits) -> None:
    """Answers one request, in a process that can do nothing else."""
    keep = pipe.fileno()
    try:
        with open(keep, "wb", closefd=False) as answers:
            confine(limits, keep)
            answers.write(json.dumps(_answer(request, values)).encode() + b"\n")
    finally:
        os._exit(0)


def _answer(request: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the operator list of the function in a reply, its own text, and a warning; or why there is none."""
    line = 0
    try:
        source = extract(request["reply"], request["kind"])
        check_source(source, values)
        program = trace(source, request["kind"], values)
        line = source.last_line  # what is wrong with a list is wrong with all of its function
        return {"program": program.text, "source": source.text, "warning": try_program(program, values)}
    except CodeError as error:
        return {"check": error.check, "message": str(error), "line": error.line or line}
    except MemoryError:
        return {"check": "memory", "message": TOO_MUCH}


if __name__ == "__main__":
    serve(unpacked)
