"""The child's side of the sandbox: `python -m porse.functions.read.probe`, lines of JSON in and out.

It loads torch once, then forks twice for every reply: one process reads it, runs it as Python and leaves an operator list; the
other tries the list and judges. What one function breaks ends with its own process.
"""

import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

import torch

from porse.functions.read.confine import confine, seal
from porse.functions.read.limits import Limits
from porse.functions.read.reply import read_reply, warm_up
from porse.functions.read.states import load_states
from porse.functions.read.trial import make_sleef, try_program
from porse.functions.verdict import Check, Verdict
from porse.variables import Variable

_MAX_ANSWER = 2_000_000
_OUT_OF_MEMORY = 3
_ending: list[int] = []
"""Processes that have answered and have been told to end."""


Load = Callable[[dict[str, Any]], tuple[Sequence[Variable], Mapping[str, Any]]]
"""From the request that prepares a probe to the variables of a task and their values in real states."""


def serve(load: Load) -> None:
    """Serves requests from standard input until it ends: first the limits, then states, then functions."""
    torch.set_num_threads(1)
    limits = Limits(**json.loads(sys.stdin.buffer.readline())["limits"])
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)

    def say(message: dict[str, Any]) -> None:
        answers.write(json.dumps(message).encode() + b"\n")

    variables: Sequence[Variable] = []
    values: Mapping[str, Any] = {}
    make_sleef()
    try_program(*warm_up(), line=0)
    seal()
    for line in sys.stdin.buffer:
        request = json.loads(line)
        if "reply" in request:
            say(_serve(request, variables, values, limits))
            continue
        try:
            variables, values = load(request)
            say({"ready": True, "variables": [asdict(variable) for variable in variables]})
        except Exception as error:  # whatever is wrong with the states is told to the parent
            say({"ready": False, "error": str(error)})


def _load_file(request: dict[str, Any]) -> tuple[Sequence[Variable], Mapping[str, Any]]:
    """Reads the states from the file that the request names."""
    variables = [Variable(**{**v, "shape": tuple(v["shape"])}) for v in request["variables"]]
    return variables, load_states(Path(request["states"]), variables)


def _serve(
    request: dict[str, Any], variables: Sequence[Variable], values: Mapping[str, Any], limits: Limits
) -> dict[str, Any]:
    """Returns the verdict on one reply, and the source that it holds, "" where it did not pass."""

    def read() -> dict[str, Any]:
        return asdict(read_reply(request["reply"], request["kind"], variables, values))

    found = _in_process(read, limits)
    if isinstance(found, Verdict):
        return {"verdict": asdict(found), "source": ""}
    if not found["program"]:
        return {"verdict": asdict(_refusal(found)), "source": ""}
    text, line = str(found["program"]), int(found["line"])
    judged = _in_process(lambda: asdict(try_program(text, values, line)), limits)
    if isinstance(judged, Verdict):
        return {"verdict": asdict(judged), "source": ""}
    return {"verdict": judged, "source": str(found["source"]) if judged["passed"] else ""}


def _refusal(found: Mapping[str, Any]) -> Verdict:
    check: Check = found["check"] if found["check"] in get_args(Check) else "crash"
    return Verdict(False, check, str(found["message"])[:4000], int(found["line"]))


def _in_process(work: Callable[[], dict[str, Any]], limits: Limits) -> dict[str, Any] | Verdict:
    """Returns what a confined process of its own made, or the verdict on its end."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            confine(limits, keep=write_end)
            _write(write_end, json.dumps(work()).encode() + b"\n")
            code = 0
        except MemoryError:
            code = _OUT_OF_MEMORY
        finally:
            os._exit(code)
    os.close(write_end)
    text, in_time = _read(read_end, limits.wall_s)
    os.close(read_end)
    found = _parse(text)
    os.kill(child, signal.SIGKILL)
    if found is None:
        _, status = os.waitpid(child, 0)
        return _verdict_of_end(in_time, status, limits)
    _ending.append(child)  # taking it apart takes longer than the function did, and nobody needs to wait for it
    _ending[:] = [process for process in _ending if os.waitpid(process, os.WNOHANG)[0] == 0]
    return found


def _write(pipe: int, text: bytes) -> None:
    while text:
        text = text[os.write(pipe, text) :]


def _read(pipe: int, wall_s: float) -> tuple[bytes, bool]:
    """Returns what comes through a pipe up to the end of a line, and whether it or the end came in time."""
    text, end = b"", time.monotonic() + wall_s
    while not text.endswith(b"\n") and len(text) <= _MAX_ANSWER:
        ready = select.select([pipe], [], [], max(end - time.monotonic(), 0.0))[0]
        if not ready:
            return text, False
        part = os.read(pipe, 65536)
        if not part:
            break
        text += part
    return text, True


def _parse(text: bytes) -> dict[str, Any] | None:
    """Returns what a process sent, None when it sent nothing of the kind."""
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _verdict_of_end(in_time: bool, status: int, limits: Limits) -> Verdict:
    """Returns the verdict on a function whose process ended without one."""
    killed = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    if not in_time or killed == signal.SIGXCPU:
        message = f"the function did not finish within {limits.wall_s:g} s; use tensor operations, not long loops"
        return Verdict(False, "time", message, 0)
    if killed == signal.SIGKILL or (os.WIFEXITED(status) and os.WEXITSTATUS(status) == _OUT_OF_MEMORY):
        return Verdict(False, "memory", "the function needs more memory than it may use", 0)
    return Verdict(False, "crash", "the function ended its process", 0)


if __name__ == "__main__":
    serve(_load_file)
