"""Runs stages without importing everything for each: `python warm_server.py SOCKET`. For tests.

A server imports what stages import, and computes nothing. For every request it forks a child that becomes the stage: a
process of its own, with the caller's folder, environment and output, that ends with the stage's exit code. What a stage
does is not changed by that, except for who waits for its imports. The server of candidates' processes
(`porse.training.population`) is shared in the same way.
"""

import importlib
import json
import multiprocessing.forkserver
import os
import runpy
import socket
import sys
import traceback
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from porse import numerics  # noqa: E402

numerics.apply("portable")

IMPORTED = (
    "porse.training.candidate", "porse.training.probing", "porse.training.evaluation", "porse.generation.brief",
    "porse.generation.candidates", "porse.generation.functions", "porse.generation.mutants", "porse.generation.states",
    "porse.report.summary", "porse.tasks.quadcopter", "porse.tasks.over",
)  # fmt: skip


def serve(path: str) -> None:
    for module in IMPORTED:
        importlib.import_module(module)
    candidates = multiprocessing.forkserver._forkserver
    candidates.set_forkserver_preload(["porse.training.server"])
    candidates.ensure_running()
    candidates.ensure_running = lambda: None  # stages are not its parent and could not ask whether it lives
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(path)
    listener.listen(64)
    print("ready", flush=True)
    while True:
        connection, _ = listener.accept()
        if os.fork():
            connection.close()
            while _reap():
                pass
            continue
        listener.close()
        if os.fork() == 0:
            _become_stage(connection)
        _, status = os.wait()
        connection.sendall(bytes([os.waitstatus_to_exitcode(status) & 0xFF]))
        os._exit(0)


def _reap() -> bool:
    try:
        return os.waitpid(-1, os.WNOHANG)[0] != 0
    except ChildProcessError:
        return False


def _become_stage(connection: socket.socket) -> None:
    """Takes over the caller's output, folder and environment, runs the stage, and ends."""
    message, descriptors, _, _ = socket.recv_fds(connection, 1 << 20, 2)
    request = json.loads(message)
    for target, descriptor in zip((1, 2), descriptors, strict=True):
        os.dup2(descriptor, target)
    os.chdir(request["folder"])
    os.environ.clear()
    # The variables of the profile are those that this process loaded its libraries with.
    os.environ.update({**request["environment"], **numerics.ENVIRONMENT["portable"]})
    # Who started the stage is this process.
    os.environ.pop("PORSE_PARENT", None)
    module, *arguments = request["arguments"]
    sys.argv = [module, *arguments]
    sys.path[:] = [str(request["folder"]), *(entry for entry in sys.path if entry != str(ROOT))]
    code = 0
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    serve(sys.argv[1])
