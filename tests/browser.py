"""A headless Chromium, driven over a pipe by its DevTools protocol: what a page draws, asks for and complains about.

`PORSE_CHROMIUM` names the browser; else one on the `PATH` is taken.
"""

import base64
import fcntl
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from select import select
from typing import Any

CHROMIUM = os.environ.get("PORSE_CHROMIUM") or next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None
)
PATIENCE_S = 60.0
"""How long one answer may take: a machine may be busy."""


class Browser:
    """One page of a browser.

    Attributes:
        requests: addresses that were asked for, but for those within the page (`data:`).
        complaints: errors and warnings of the console, exceptions, and what the page's own policy refused.
    """

    def __init__(self, to: int, back: int) -> None:
        self._to, self._back = to, back
        self._number = 0
        self._session: dict[str, str] = {}
        self._left = b""
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._events: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = {
            "sessionId": self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"],
        }
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> Any:
        """Sends a command and returns its result."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params, **self._session}
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    def open(self, page: Path, width: int, height: int, *, phone: bool = False) -> None:
        """Opens a file in a window of that size, in units of its layout, and waits until it is loaded."""
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=phone,
        )  # fmt: skip
        self.requests.clear()
        self._events.clear()
        self.call("Page.navigate", url=page.resolve().as_uri())
        while "Page.loadEventFired" not in self._events:
            self._read()

    def value(self, expression: str) -> Any:
        """Returns what a JavaScript expression is worth on the page."""
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def picture(self, target: Path, clip: tuple[int, int, int, int] | None = None) -> None:
        """Writes what the window shows as .png, or the part (x, y, width, height) of the whole page."""
        options: dict[str, Any] = {}
        if clip:
            options = {
                "clip": {**dict(zip(("x", "y", "width", "height"), clip, strict=True)), "scale": 1},
                "captureBeyondViewport": True,
            }
        target.write_bytes(base64.b64decode(self.call("Page.captureScreenshot", **options)["data"]))

    def paper(self, target: Path) -> None:
        """Prints the page as .pdf."""
        target.write_bytes(base64.b64decode(self.call("Page.printToPDF", preferCSSPageSize=True)["data"]))

    def _read(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE_S
        while b"\0" not in self._left:
            ready, _, _ = select([self._back], [], [], max(0.0, end - time.monotonic()))
            assert ready, f"the browser said nothing for {PATIENCE_S:g} seconds"
            found = os.read(self._back, 2**20)
            assert found, "the browser ended"
            self._left += found
        text, self._left = self._left.split(b"\0", 1)
        message: dict[str, Any] = json.loads(text)
        self._note(message.get("method", ""), message.get("params", {}))
        return message

    def _note(self, event: str, params: dict[str, Any]) -> None:
        self._events.append(event)
        if event == "Network.requestWillBeSent" and not params["request"]["url"].startswith("data:"):
            self.requests.append(params["request"]["url"])
        elif event == "Runtime.exceptionThrown":
            self.complaints.append(str(params["exceptionDetails"]))
        elif event == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            self.complaints.append(params["entry"]["text"])
        elif event == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            self.complaints.append(str(params["args"]))


@contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """Starts a browser that reaches no host, and ends it."""
    own_read, its_write = os.pipe()
    its_read, own_write = os.pipe()
    command = [
        str(CHROMIUM), "--headless", "--no-sandbox", "--no-zygote", "--disable-gpu", "--hide-scrollbars",
        "--disable-dev-shm-usage", "--host-resolver-rules=MAP * ~NOTFOUND", "--remote-debugging-pipe",
        f"--user-data-dir={profile}",
    ]  # fmt: skip
    # The browser reads from 3 and writes to 4; ends with higher numbers are put there without treading on each other.
    its_ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (its_read, its_write)]
    place = "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); os.execv(sys.argv[3], sys.argv[3:])"
    process = subprocess.Popen(
        [sys.executable, "-c", place, *map(str, its_ends), *command], pass_fds=its_ends, stderr=subprocess.DEVNULL
    )
    for end in its_ends:
        os.close(end)
    os.close(its_read)
    os.close(its_write)
    try:
        yield Browser(own_write, own_read)
    finally:
        process.kill()
        process.wait()
        os.close(own_write)
        os.close(own_read)
