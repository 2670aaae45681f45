"""Messages between the processes of a probe: one line of JSON each."""

import contextlib
import json
import os
import select
import time
from collections.abc import Mapping
from typing import Any

_MAX_MESSAGE = 4_000_000


def send(pipe: int, message: Mapping[str, Any]) -> None:
    """Writes a message."""
    text = json.dumps(message).encode() + b"\n"
    while text:
        text = text[os.write(pipe, text) :]


def receive(pipe: int, wall_s: float) -> dict[str, Any]:
    """Returns the next message of who is not trusted, {} when the pipe ends before, or holds something else.

    Raises:
        TimeoutError: no message came in time.
    """
    text, end = b"", time.monotonic() + wall_s
    while not text.endswith(b"\n") and len(text) <= _MAX_MESSAGE:
        if not select.select([pipe], [], [], max(end - time.monotonic(), 0.0))[0]:
            raise TimeoutError
        part = os.read(pipe, 65536)
        if not part:
            break
        text += part
    with contextlib.suppress(ValueError, RecursionError):
        found = json.loads(text)
        return found if isinstance(found, dict) else {}
    return {}
