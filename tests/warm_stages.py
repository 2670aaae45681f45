"""Projects whose stages are run by a warm server, so that a tiny `dvc repro` takes seconds. For tests."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SERVER = Path(__file__).resolve().parent / "warm_server.py"

CLIENT = """#!{python} -IS
import json, os, socket, sys
assert sys.argv[1] == "-m", sys.argv
connection = socket.socket(socket.AF_UNIX)
connection.connect({socket!r})
request = {{"arguments": sys.argv[2:], "folder": os.getcwd(), "environment": dict(os.environ)}}
socket.send_fds(connection, [json.dumps(request).encode()], [1, 2])
sys.exit((connection.recv(1) or b"\\x01")[0])
"""


@contextmanager
def warm_stages(folder: Path) -> Iterator[Path]:
    """Gives a folder that serves as a project's `.venv` while the block runs: its `bin/python` asks the server."""
    address = folder / "socket"
    command = [sys.executable, str(SERVER), str(address)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            assert server.stdout.readline() == "ready\n"
            python = folder / "bin" / "python"
            python.parent.mkdir()
            python.write_text(CLIENT.format(python=sys.executable, socket=str(address)))
            python.chmod(0o755)
            yield folder
        finally:
            server.terminate()
