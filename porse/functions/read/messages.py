"""Messages between the processes of a probe: one line of JSON each."""

import contextlib
import json
from collections.abc import Mapping
from socket import socket
from typing import Any

_MAX_MESSAGE = 4_000_000


def send(peer: socket, message: Mapping[str, Any]) -> None:
    """Sends a message, to nobody where the peer has ended."""
    with contextlib.suppress(ConnectionError):
        peer.sendall(json.dumps(message).encode() + b"\n")


def receive(peer: socket, wall_s: float) -> dict[str, Any] | None:
    """Returns the next message of an untrusted peer, {} where it ends or sends something else, None where it is late."""
    peer.settimeout(wall_s)
    try:
        with peer.makefile("rb") as messages:
            found = json.loads(messages.readline(_MAX_MESSAGE))
            return found if isinstance(found, dict) else {}
    except TimeoutError:
        return None
    except (ConnectionError, ValueError, RecursionError):
        return {}
