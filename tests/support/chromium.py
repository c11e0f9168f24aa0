"""A page in headless Chromium, driven by the DevTools protocol over a pipe: no port, no library."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any, BinaryIO

import pytest

FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe")
READS, WRITES = 3, 4
"""The browser's descriptors for commands and for answers."""
LONGEST_S = 60
Json = dict[str, Any]


class Page:
    """One tab. complaints: warnings and errors of its console, and exceptions."""

    def __init__(self, commands: BinaryIO, answers: BinaryIO) -> None:
        self._commands, self._answers, self._session, self._turn = commands, answers, "", 0
        self.complaints: list[Json] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "DOM"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Json:
        """One command; its result."""
        self._turn += 1
        command: Json = {"id": self._turn, "method": method, "params": parameters}
        command |= {"sessionId": self._session} if self._session else {}
        self._commands.write(json.dumps(command).encode() + b"\0")
        self._commands.flush()
        while True:
            answer = self._next()
            if answer.get("id") == self._turn:
                assert "error" not in answer, (method, answer)
                return dict(answer["result"])

    def _next(self) -> Json:
        """The next answer or event."""
        found = bytearray()
        while (byte := self._answers.read(1)) != b"\0":
            assert byte, "the browser ended"
            found += byte
        event: Json = json.loads(found)
        if event.get("method") in (
            "Runtime.consoleAPICalled",
            "Runtime.exceptionThrown",
            "Log.entryAdded",
        ):
            self.complaints.append(event["params"])
        return event

    def open(self, url: str) -> None:
        """Show a page; returns when it is loaded."""
        self.call("Page.navigate", url=url)
        while self._next().get("method") != "Page.loadEventFired":
            pass

    def value(self, script: str) -> Any:
        """What a script is worth; a promise is waited for."""
        result = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait_for(self, condition: str) -> Any:
        """Wait, in the page, until a condition holds; returns its value."""
        return self.value(
            f"new Promise((done, fail) => {{ const until = Date.now() + {1000 * LONGEST_S};"
            f" (function look() {{ const found = {condition}; if (found) done(found);"
            " else if (Date.now() > until) fail(new Error(document.body.innerText));"
            " else setTimeout(look, 20); })(); })"
        )

    def choose(self, selector: str, *files: Path) -> None:
        """Files for an input."""
        root = self.call("DOM.getDocument")["root"]["nodeId"]
        node = self.call("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.call("DOM.setFileInputFiles", nodeId=node, files=[str(one) for one in files])

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """The left button pressed at one place and released at another."""
        for kind, (x, y) in (("Pressed", start), ("Moved", end), ("Released", end)):
            place: Json = {"x": x, "y": y, "button": "left", "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", **place)

    def screenshot(self, path: Path, width: int, height: int) -> None:
        """A picture of the whole page on a screen of this width."""
        size: Json = {
            "width": width,
            "height": height,
            "deviceScaleFactor": 1,
            "mobile": width < 600,
        }
        self.call("Emulation.setDeviceMetricsOverride", mobile=width < 600, **size)
        whole = self.call("Page.captureScreenshot", captureBeyondViewport=True)
        path.write_bytes(b64decode(whole["data"]))


@contextmanager
def page() -> Iterator[Page]:
    """A new tab of a browser of its own; the test skips where Chromium is not installed."""
    if shutil.which("chromium") is None:
        pytest.skip("the page is opened in chromium: apt-get install chromium")
    from_us, commands = os.pipe()
    answers, to_us = os.pipe()
    begin = f'exec chromium "$@" {READS}<&{from_us} {WRITES}>&{to_us}'
    words = ["bash", "-c", begin, "bash", *FLAGS]
    process = subprocess.Popen(
        words, pass_fds=(from_us, to_us), stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )
    os.close(from_us)
    os.close(to_us)
    with os.fdopen(commands, "wb") as writes, os.fdopen(answers, "rb") as reads:
        try:
            yield Page(writes, reads)
        finally:
            process.terminate()
            process.wait(LONGEST_S)


class _Quiet(SimpleHTTPRequestHandler):
    """Files, without a log."""

    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a folder on this machine."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=folder)) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
            thread.join()
