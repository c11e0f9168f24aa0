"""Chromium without a window, driven through a pair of pipes: JSON messages that end with a zero."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="chromium is not installed"
)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--remote-debugging-pipe",
)
TROUBLES = ("error", "warning")
LONGEST_S = 120.0
"""A browser that says nothing for so long is stuck."""


class Tab:
    """One page. problems: errors and warnings of its console."""

    def __init__(self, to_browser: int, from_browser: int) -> None:
        self._out, self._in = os.fdopen(to_browser, "wb"), os.fdopen(from_browser, "rb")
        self._count, self._rest, self._session = 0, b"", ""
        self.problems: list[str] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """A command of the DevTools protocol, and its result."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": params}
        message |= {"sessionId": self._session} if self._session else {}
        self._out.write(json.dumps(message).encode() + b"\0")
        self._out.flush()
        while (answer := self._next()).get("id") != self._count:
            self._note(answer)
        assert "error" not in answer, answer
        result: dict[str, Any] = answer["result"]
        return result

    def open(self, url: str, width: int, height: int, *, dark: bool = False) -> None:
        """Go to a page at a window's size in CSS pixels."""
        phone = width < 600
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=2 if phone else 1,
            mobile=phone,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Page.navigate", url=url)

    def value(self, expression: str) -> Any:
        """Of a JavaScript expression; a promise is waited for."""
        answer = self.call(
            "Runtime.evaluate",
            expression=expression,
            awaitPromise=True,
            returnByValue=True,
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_until(self, condition: str) -> Any:
        """Until a JavaScript expression is true, as the page changes; its value."""
        return self.value(
            f"""new Promise((done) => {{
                const look = () => {{ let v = null; try {{ v = {condition}; }} catch (e) {{ }}
                    if (v) done(v); else setTimeout(look, 20); }};
                look(); }})"""
        )

    def choose(self, selector: str, *files: Path) -> None:
        """Files for an input."""
        root = self.call("DOM.getDocument")["root"]["nodeId"]
        node = self.call("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
        self.call(
            "DOM.setFileInputFiles", nodeId=node, files=[str(one) for one in files]
        )

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press the left button at one place of the window and release it at another."""
        for kind, (x, y) in (("Pressed", start), ("Moved", end), ("Released", end)):
            place = {"x": x, "y": y, "button": "left", "clickCount": 1}
            self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", **place)

    def screenshot(self, path: Path, *, whole: bool = True) -> None:
        """The page as a PNG file."""
        made = self.call("Page.captureScreenshot", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(made["data"]))

    def close(self) -> None:
        """End the browser."""
        self._session = ""
        self.call("Browser.close")
        self._out.close()
        self._in.close()

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            came = select.select([self._in], [], [], LONGEST_S)[0]
            data = os.read(self._in.fileno(), 1 << 16) if came else b""
            assert data, "chromium ended, or what was waited for never came"
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\0")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _note(self, answer: dict[str, Any]) -> None:
        params = answer.get("params", {})
        if answer.get("method") == "Runtime.exceptionThrown":
            self.problems.append(
                str(params["exceptionDetails"].get("exception", params))
            )
        if (
            answer.get("method") == "Log.entryAdded"
            and params["entry"]["level"] in TROUBLES
        ):
            self.problems.append(
                f"{params['entry']['text']} {params['entry'].get('url', '')}"
            )
        if (
            answer.get("method") == "Runtime.consoleAPICalled"
            and params["type"] in TROUBLES
        ):
            self.problems.append(str(params["args"]))


@contextmanager
def browser(profile: Path) -> Iterator[Tab]:
    """A tab of a new chromium. profile: a folder for what it leaves."""
    (theirs_in, to_browser), (from_browser, theirs_out) = os.pipe(), os.pipe()
    command = f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}'
    words = [str(CHROMIUM), *FLAGS, f"--user-data-dir={profile}"]
    with subprocess.Popen(
        ["bash", "-c", command, "bash", *words],
        pass_fds=(theirs_in, theirs_out),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        os.close(theirs_in)
        os.close(theirs_out)
        try:
            tab = Tab(to_browser, from_browser)
            yield tab
            tab.close()
        except BaseException:
            process.kill()
            raise


class _Quiet(SimpleHTTPRequestHandler):
    """Files, without a log."""

    def log_message(self, format: str, *args: Any) -> None:
        pass


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a folder on this machine."""
    with ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(_Quiet, directory=folder)
    ) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/"
        finally:
            server.shutdown()
            thread.join()
