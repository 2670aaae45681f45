"""Starts the warm server for as long as a block runs."""

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from porse.numerics import Profile
from porse.warm.client import VARIABLE
from porse.warm.sameness import libraries_see

_KEPT = ("HOME", "LANG", "LC_ALL", "LC_CTYPE", "PATH", "TMPDIR")


@contextmanager
def warm_server(profile: Profile) -> Iterator[dict[str, str]]:
    """Gives the environment variables by which stages find a warm server, which ends with the block or this process.

    The server starts while the block goes on; who comes early waits for it. What it cannot serve starts cold: another
    numeric profile, sources that differ from those that it has imported, a system that is not Linux.

    Args:
        profile: the numeric profile of the run.
    """
    if not sys.platform.startswith("linux"):
        yield {}
        return
    # A folder of its own, which only this user may enter.
    with tempfile.TemporaryDirectory(prefix="porse-") as folder:
        address = str(Path(folder) / "warm")
        with socket.socket(socket.AF_UNIX) as listener:
            try:
                listener.bind(address)
            except OSError:
                # A name that is too long for a socket, say: no server, and nothing is wrong but the time it takes.
                yield {}
                return
            listener.listen(64)
            server = _started(listener, profile)
        try:
            yield {VARIABLE: address}
        finally:
            server.kill()
            server.wait()


def _started(listener: socket.socket, profile: Profile) -> subprocess.Popen[bytes]:
    """Returns the server's process."""
    # No key reaches the server: nothing of the environment does but what libraries read.
    environment = {name: os.environ[name] for name in _KEPT if name in os.environ} | libraries_see(os.environ)
    command = [sys.executable, "-m", "porse.warm.server", str(listener.fileno()), profile, str(os.getpid())]
    return subprocess.Popen(
        command,
        cwd=Path(__file__).resolve().parents[2],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        # What goes wrong in it goes wrong in a cold stage, too, which says so.
        stderr=subprocess.DEVNULL,
        pass_fds=(listener.fileno(),),
        # A session of its own: a key in the terminal reaches the stages' callers, and through them the stages.
        start_new_session=True,
    )
