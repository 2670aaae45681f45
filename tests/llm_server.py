"""A chat completions endpoint on loopback that misbehaves on request: the tests of record mode talk to it."""

import json
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

Behaviour = Callable[[BaseHTTPRequestHandler, dict[str, Any]], None]


class ChatServer:
    """Serves scripted behaviours in turn and, when there are none left, good replies."""

    def __init__(self, delay_s: float = 0.0) -> None:
        self.delay_s = delay_s
        self.script: list[Behaviour] = []
        self.requests: list[dict[str, Any]] = []
        self.times: list[float] = []
        self.headers: list[dict[str, str]] = []
        self.busy = 0
        self.most_busy = 0
        self.lock = threading.Lock()
        chat = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_POST(self) -> None:
                body = json.loads(self.rfile.read(int(self.headers["content-length"])))
                with chat.lock:
                    chat.requests.append({"path": self.path, "body": body})
                    chat.times.append(time.monotonic())
                    chat.headers.append({name.lower(): value for name, value in self.headers.items()})
                    behaviour = chat.script.pop(0) if chat.script else good
                    chat.busy += 1
                    chat.most_busy = max(chat.most_busy, chat.busy)
                time.sleep(chat.delay_s)
                try:
                    behaviour(self, body)
                except (BrokenPipeError, ConnectionResetError):
                    self.close_connection = True
                finally:
                    with chat.lock:
                        chat.busy -= 1

            def log_message(self, format: str, *args: object) -> None:
                return

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            request_queue_size = 256

            def handle_error(self, request: object, client_address: object) -> None:
                """Keeps quiet about connections that the client, or a misbehaviour, has dropped."""
                error = sys.exc_info()[1]
                if not isinstance(error, ConnectionError | ValueError):
                    super().handle_error(request, client_address)

        self.server = Server(("127.0.0.1", 0), Handler)
        self.thread = threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)

    @property
    def authorizations(self) -> list[str]:
        """The key that came with each request, "" for none."""
        return [headers.get("authorization", "") for headers in self.headers]

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.server_address[1]}/v1"

    def __enter__(self) -> "ChatServer":
        self.thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.server.shutdown()
        self.thread.join()
        self.server.server_close()


def completion(body: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Returns a good chat completion; the text repeats the last message, so that a test can tell replies apart."""
    document = {
        "id": "chatcmpl-1",
        "object": "chat.completion",
        "created": 1,
        "model": body["model"],
        "choices": [
            {
                "index": 0,
                "message": {"role": "assistant", "content": f"reply to {body['messages'][-1]['content']}"},
                "finish_reason": "stop",
            }
        ],
        "usage": {"prompt_tokens": 100, "completion_tokens": 10, "total_tokens": 110},
    }
    return {**document, **changes}


def send(handler: BaseHTTPRequestHandler, status: int, data: bytes, headers: dict[str, str] | None = None) -> None:
    handler.send_response(status)
    handler.send_header("Content-Type", "application/json")
    handler.send_header("Content-Length", str(len(data)))
    for name, value in (headers or {}).items():
        handler.send_header(name, value)
    handler.end_headers()
    handler.wfile.write(data)


def good(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
    send(handler, 200, json.dumps(completion(body)).encode())


def replying(text: str | list[Any] | None, finish_reason: str | None = "stop", **changes: Any) -> Behaviour:
    """Returns a behaviour: a well-formed completion with this text and finish reason."""

    def behave(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
        choice = {"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": finish_reason}
        send(handler, 200, json.dumps(completion(body, **{"choices": [choice], **changes})).encode())

    return behave


def failing(status: int, code: str = "", message: str = "no", headers: dict[str, str] | None = None) -> Behaviour:
    """Returns a behaviour: an HTTP error in OpenAI's form."""

    def behave(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
        error = {"message": message, "type": code or None, "param": None, "code": code or None}
        send(handler, status, json.dumps({"error": error}).encode(), headers)

    return behave


def raw(data: bytes) -> Behaviour:
    """Returns a behaviour: status 200 and these bytes."""
    return lambda handler, body: send(handler, 200, data)


def half_a_body(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
    data = json.dumps(completion(body)).encode()
    handler.send_response(200)
    handler.send_header("Content-Length", str(len(data)))
    handler.end_headers()
    handler.wfile.write(data[: len(data) // 2])
    handler.close_connection = True


def slow_headers(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
    """Sends one byte of a header at a time: every read succeeds, and the reply never comes."""
    handler.wfile.write(b"HTTP/1.1 200 OK\r\nX-Slow: ")
    for _ in range(100):
        handler.wfile.write(b"x")
        handler.wfile.flush()
        time.sleep(0.05)
    handler.close_connection = True


def reset(handler: BaseHTTPRequestHandler, body: dict[str, Any]) -> None:
    """Drops the connection with a TCP reset."""
    handler.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    handler.connection.shutdown(socket.SHUT_RD)
    handler.connection.close()
    handler.close_connection = True
