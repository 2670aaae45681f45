"""A command in a real terminal of a given size."""

import fcntl
import os
import pty
import struct
import subprocess
import termios
from collections.abc import Mapping, Sequence
from pathlib import Path


def on_a_terminal(
    command: Sequence[str | Path], rows: int, columns: int, env: Mapping[str, str], cwd: Path | None = None
) -> tuple[int, list[bytes]]:
    """Runs a command with a terminal for input, output and errors.

    Returns:
        Its exit code, and what it wrote, piece by piece.
    """
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    # Of its own size alone, whatever the terminal of the tests says of its own.
    own = {name: value for name, value in env.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen(command, cwd=cwd, env=own, stdin=its, stdout=its, stderr=its, start_new_session=True)
    os.close(its)
    pieces = []
    while True:
        try:
            piece = os.read(ours, 65536)
        except OSError:
            # Linux says so that nobody holds the other end any more.
            break
        if not piece:
            break
        pieces.append(piece)
    os.close(ours)
    return process.wait(), pieces
