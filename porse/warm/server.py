"""The server's side: `python -m porse.warm.server LISTENER PROFILE PARENT`, started by `porse.warm.start` alone.

It imports what stages import and computes nothing. For every request it forks a child that becomes the stage: a process
with the caller's folder, environment and output, that ends as the stage ends. When the caller ends, its stage is ended;
when the server ends, all are. The server never reads a request, so it never holds a key of the caller's environment.
"""

import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import sys
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from porse import numerics
from porse.processes import die_with_parent
from porse.warm.client import STARTED, VARIABLE
from porse.warm.sameness import declared_profile, libraries_see, sources

IMPORTED = (
    "porse.training.candidate", "porse.training.evaluation", "porse.training.executor", "porse.training.rung",
    "porse.training.start", "porse.generation.states", "porse.sim.physics", "porse.stage", "porse.steps.begin", "porse.steps.eliminate",
    "porse.steps.evaluate", "porse.steps.fuse", "porse.steps.generate", "porse.steps.mutate", "porse.steps.summarise",
    "porse.steps.train_population", "porse.steps.validate_code",
)  # fmt: skip
"""What stages import. The Gaussian process is not here: it takes a second to import, and one method needs it."""


@dataclass(frozen=True)
class _Stage:
    """A stage that runs, and the connection of the process that waits for it."""

    process: int
    connection: socket.socket


@dataclass(frozen=True)
class _Origin:
    """What the server was made from, and what a caller must agree with."""

    profile: numerics.Profile
    sources: str
    libraries: dict[str, str]


def serve(listener: socket.socket, profile: numerics.Profile, parent: int) -> NoReturn:
    """Serves those who connect to `listener` until the parent ends. They may come early: they wait for the imports."""
    die_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    root = Path(__file__).resolve().parents[2]
    before = sources(root)
    numerics.apply(profile)
    # Before the imports: libraries set variables of their own.
    switches = libraries_see(os.environ)
    for module in IMPORTED:
        importlib.import_module(module)
    if sources(root) != before:
        # Which of the two was imported is not known: whoever waits starts cold.
        os._exit(1)
    # A child that looked through a million objects for garbage would copy the memory that it shares.
    gc.collect()
    gc.freeze()
    origin = _Origin(profile, before, switches)
    # A child that ends wakes the poll.
    woken, waking = socket.socketpair()
    for end in (woken, waking):
        end.setblocking(False)
    signal.set_wakeup_fd(waking.fileno(), warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    stages: list[_Stage] = []
    poll = select.poll()
    poll.register(listener, select.POLLIN)
    poll.register(woken, select.POLLIN)
    while True:
        ready = {descriptor for descriptor, _ in poll.poll()}
        if woken.fileno() in ready:
            woken.recv(4096)
        for stage in list(stages):
            status = _status(stage, hung_up=stage.connection.fileno() in ready)
            if status is not None:
                poll.unregister(stage.connection)
                stages.remove(stage)
                _answer(stage, status)
        if listener.fileno() in ready:
            connection, _ = listener.accept()
            server = os.getpid()
            process = os.fork()
            if process == 0:
                for other in (listener, woken, waking, *(stage.connection for stage in stages)):
                    other.close()
                _become_stage(connection, origin, server)
            stages.append(_Stage(process, connection))
            # What the caller sends is for the child; its end is for the server.
            poll.register(connection, select.POLLRDHUP)


def _status(stage: _Stage, hung_up: bool) -> int | None:
    """Returns how a stage ended, None while it runs. Ends it when its caller has ended."""
    process, status = os.waitpid(stage.process, os.WNOHANG)
    if process:
        return status
    if not hung_up:
        return None
    os.kill(stage.process, signal.SIGKILL)
    return os.waitpid(stage.process, 0)[1]


def _answer(stage: _Stage, status: int) -> None:
    try:
        stage.connection.sendall(b"%d\n" % os.waitstatus_to_exitcode(status))
    except OSError:
        pass  # the caller has ended
    finally:
        stage.connection.close()


def _become_stage(connection: socket.socket, origin: _Origin, server: int) -> NoReturn:
    """Takes over the caller's output, folder and environment, runs the stage, and ends. Runs in the child."""
    code = 1
    try:
        die_with_parent(server)
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        request = _received(connection)
        os.umask(request["umask"])
        os.chdir(request["folder"])
        connection.sendall(STARTED)
        connection.close()
        os.environ.clear()
        os.environ.update(request["environment"])
        if not _agrees(request, origin):
            # The stage starts cold, as this very process: its caller still waits for it, and still ends it.
            os.execv(sys.executable, [sys.executable, "-m", *request["arguments"]])
        os.environ.update(numerics.ENVIRONMENT[origin.profile])
        code = _run_stage(request["arguments"])
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _received(connection: socket.socket) -> dict[str, Any]:
    """Returns the request, with the caller's output as this process's own."""
    size, descriptors, _, _ = socket.recv_fds(connection, 8, 2)
    for target, descriptor in zip((1, 2), descriptors, strict=True):
        os.dup2(descriptor, target)
        os.close(descriptor)
    wanted, content = int.from_bytes(size, "big"), bytearray()
    while len(content) < wanted:
        chunk = connection.recv(wanted - len(content))
        if not chunk:
            os._exit(1)  # the caller has ended
        content += chunk
    request: dict[str, Any] = json.loads(content)
    return request


def _agrees(request: dict[str, Any], origin: _Origin) -> bool:
    """Returns whether the stage would import the very same things, under the same switches."""
    folder = Path(request["folder"])
    seen = libraries_see({**request["environment"], **numerics.ENVIRONMENT[origin.profile]})
    return (
        request["prefix"] == os.path.realpath(sys.prefix)
        and seen == origin.libraries
        and declared_profile(folder) == origin.profile
        and sources(folder) == origin.sources
    )


def _run_stage(arguments: list[str]) -> int:
    module, *rest = arguments
    sys.argv = [module, *rest]
    # As `python -m` begins it; the server's own folder is not the caller's.
    sys.path[:] = [os.getcwd(), *(entry for entry in sys.path[1:] if entry)]
    try:
        runpy.run_module(module, run_name="__main__", alter_sys=True)
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


if __name__ == "__main__":
    os.environ.pop(VARIABLE, None)
    serve(socket.socket(fileno=int(sys.argv[1])), "fast" if sys.argv[2] == "fast" else "portable", int(sys.argv[3]))
