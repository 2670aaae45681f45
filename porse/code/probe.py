"""The child's side of the probe: `python -m porse.code.probe`, lines of JSON in and out.

It loads torch once, then forks for every function: what one function breaks ends with its own process.
"""

import json
import os
import select
import signal
import sys
import time
from pathlib import Path
from typing import Any

import torch

from porse.code.confine import confine, seal
from porse.code.limits import Limits
from porse.code.states import load_states
from porse.code.trial import try_function, warm_up
from porse.code.verdict import CodeError, Verdict
from porse.variables import Variable

_MAX_ANSWER = 100_000
_OUT_OF_MEMORY = 3


def main() -> None:
    """Serves requests from standard input until it ends."""
    torch.set_num_threads(1)
    limits = Limits(**json.loads(sys.stdin.buffer.readline())["limits"])
    answers = os.fdopen(os.dup(1), "wb", buffering=0)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    variables: list[Variable] = []
    values: dict[str, Any] = {}
    warm_up()
    seal()
    for line in sys.stdin.buffer:
        request = json.loads(line)
        if "states" in request:
            try:
                variables = [Variable(**{**v, "shape": tuple(v["shape"])}) for v in request["variables"]]
                values = load_states(Path(request["states"]), variables)
                answer: dict[str, Any] = {"ready": True}
            except Exception as error:  # noqa: BLE001 (whatever is wrong with the file is told to the parent)
                answer = {"ready": False, "error": str(error)}
        else:
            answer = _serve(request, variables, values, limits).__dict__
        answers.write(json.dumps(answer).encode() + b"\n")


def _serve(request: dict[str, Any], variables: list[Variable], values: dict[str, Any], limits: Limits) -> Verdict:
    """Returns the verdict of a process of its own on one function."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            confine(limits, keep=write_end)
            verdict = try_function(request["source"], request["kind"], variables, values)
            os.write(write_end, json.dumps(verdict.__dict__).encode()[:_MAX_ANSWER])
            code = 0
        except MemoryError:
            code = _OUT_OF_MEMORY
        finally:
            os._exit(code)
    os.close(write_end)
    text, in_time = _read(read_end, limits.wall_s)
    os.close(read_end)
    if not in_time:
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return _verdict(text, in_time, status, limits)


def _read(pipe: int, wall_s: float) -> tuple[bytes, bool]:
    """Returns what comes through a pipe until its end, and whether the end came in time."""
    text, end = b"", time.monotonic() + wall_s
    while True:
        left = end - time.monotonic()
        ready = select.select([pipe], [], [], max(left, 0.0))[0]
        if not ready:
            return text, False
        part = os.read(pipe, 65536)
        if not part or len(text) > _MAX_ANSWER:
            return text, True
        text += part


def _verdict(text: bytes, in_time: bool, status: int, limits: Limits) -> Verdict:
    """Returns the verdict that a process sent, or what its end says."""
    killed = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    if not in_time or killed in (signal.SIGXCPU, signal.SIGKILL):
        message = f"the function did not finish within {limits.wall_s:g} s; use tensor operations, not long loops"
        return Verdict(False, "time", message, 0)
    try:
        answer = json.loads(text)
        return Verdict(**{**answer, "names": tuple(answer["names"]), "rises": tuple(answer["rises"])})
    except (ValueError, TypeError, KeyError):
        if os.WIFEXITED(status) and os.WEXITSTATUS(status) == _OUT_OF_MEMORY:
            return Verdict(False, "memory", f"the function needs more than {limits.memory_mib} MiB of memory", 0)
        return Verdict(False, "crash", "the function ended its process", 0)


if __name__ == "__main__":
    try:
        main()
    except (CodeError, BrokenPipeError):
        sys.exit(1)
