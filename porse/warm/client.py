"""A stage's side: the process that DVC started has another one do its work, and ends as that one ends.

Imported before anything else by every stage, so it imports next to nothing.
"""

import json
import os
import signal
import socket
import sys

VARIABLE = "PORSE_WARM"
"""Names the socket of the server."""
STARTED = b"started\n"


def hand_over() -> None:
    """Has the warm server run the stage that this process was started for, and ends with its exit code.

    Returns at once where there is no server, and where it has ended: the stage then starts cold. A stage that has been
    started is never started twice.
    """
    address = os.environ.pop(VARIABLE, "")
    # sys.argv knows the module only once it runs.
    started_as = sys.orig_argv[1:3]
    if not address or started_as[:1] != ["-m"] or not started_as[-1].startswith("stages."):
        return
    request = {
        "arguments": sys.orig_argv[2:],
        "folder": os.getcwd(),
        "environment": dict(os.environ),
        "prefix": os.path.realpath(sys.prefix),
        "umask": _umask(),
    }
    # When a key in the terminal ends this process, the server ends the stage.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    with socket.socket(socket.AF_UNIX) as connection:
        try:
            connection.connect(address)
            socket.send_fds(connection, [len(content := json.dumps(request).encode()).to_bytes(8, "big")], [1, 2])
            connection.sendall(content)
            answer = connection.makefile("rb")
            started = answer.readline()
        except OSError:
            started = b""
        if started != STARTED:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            return
        code = answer.readline()
    if not code:
        sys.stderr.write(
            "Error: expected the warm server to say how the stage ended, found that it has ended itself; run this again\n"
        )
        _end(1)
    if int(code) >= 0:
        _end(int(code))
    # As the stage ended, so does this process: DVC then sees what it would have seen. Python ignores some signals.
    os.kill(os.getpid(), -int(code))
    _end(128 - int(code))


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _end(code: int) -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
