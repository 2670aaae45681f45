"""The child's side of the sandbox: `python -m porse.functions.read.probe LIMITS`, lines of JSON in and out.

It loads torch once, then forks twice for every reply: one process reads it, runs it as Python and leaves an operator list; the
other tries the list and judges. What one function breaks ends with its own process.
"""

import json
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from porse.functions.read.confine import confine, seal
from porse.functions.read.limits import Limits
from porse.functions.read.messages import receive, send
from porse.functions.read.reply import read_reply, warm_up
from porse.functions.read.states import load_states
from porse.functions.read.trial import make_sleef, try_program
from porse.variables import Variable

_OUT_OF_MEMORY = 3
_ending: list[int] = []
"""Processes that have answered and have been told to end."""


def serve(load: Callable[[dict[str, Any]], tuple[Sequence[Variable], Mapping[str, Any]]]) -> None:
    """Serves requests from standard input until it ends: states, then functions. Its limits are its argument.

    Args:
        load: from the request for states to the variables of a task and their values in real states.
    """
    torch.set_num_threads(1)
    limits = Limits(**json.loads(sys.argv[1]))
    answers = os.dup(1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    variables: Sequence[Variable] = []
    values: Mapping[str, Any] = {}
    make_sleef()
    try_program(*warm_up(), line=0)
    seal()
    for line in sys.stdin.buffer:
        request = json.loads(line)
        if "reply" in request:
            send(answers, _judged(request, variables, values, limits))
            continue
        try:
            variables, values = load(request)
            send(answers, {"ready": True})
        except Exception as error:  # whatever is wrong with the states is told to the parent
            send(answers, {"error": str(error)})


def _load_file(request: dict[str, Any]) -> tuple[Sequence[Variable], Mapping[str, Any]]:
    """Reads the states from the file that the request names."""
    variables = [Variable(**{**v, "shape": tuple(v["shape"])}) for v in request["variables"]]
    return variables, load_states(Path(request["states"]), variables)


def _judged(
    request: dict[str, Any], variables: Sequence[Variable], values: Mapping[str, Any], limits: Limits
) -> dict[str, Any]:
    """Returns the fields of the verdict on one reply, and the source that it holds, "" where it did not pass."""
    reply, kind = request["reply"], request["kind"]
    found = _in_process(lambda: asdict(read_reply(reply, kind, variables, values)), limits)
    text, line = str(found.get("program", "")), int(found.get("line", 0))
    if not text:
        return {**found, "passed": False, "source": ""}
    tried = _in_process(lambda: asdict(try_program(text, values, line)), limits)
    return {**tried, "source": found.get("source") if tried.get("passed") else ""}


def _in_process(work: Callable[[], dict[str, Any]], limits: Limits) -> dict[str, Any]:
    """Returns what a confined process of its own made, or the check and the message of a refusal where it made nothing."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            confine(limits, keep=write_end)
            send(write_end, work())
            code = 0
        except MemoryError:
            code = _OUT_OF_MEMORY
        finally:
            os._exit(code)
    os.close(write_end)
    found, in_time = {}, True
    try:
        found = receive(read_end, limits.wall_s)
    except TimeoutError:
        in_time = False
    os.close(read_end)
    os.kill(child, signal.SIGKILL)
    if found:
        _ending.append(child)  # taking it apart takes longer than the function did, and nobody needs to wait for it
        _ending[:] = [process for process in _ending if os.waitpid(process, os.WNOHANG)[0] == 0]
        return found
    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if not in_time or ended == -signal.SIGXCPU:
        message = f"the function did not finish within {limits.wall_s:g} s; use tensor operations, not long loops"
        return {"check": "time", "message": message}
    if ended in (-signal.SIGKILL, _OUT_OF_MEMORY):
        return {"check": "memory", "message": "the function needs more memory than it may use"}
    return {"check": "crash", "message": "the function ended its process"}


if __name__ == "__main__":
    serve(_load_file)
