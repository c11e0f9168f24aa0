"""The live page over HTTP: its files, its stream of events, the last 30 s, and its actions.

    GET /[TOKEN/]              the page, and its scripts and style
    GET /[TOKEN/]events        server-sent events (stream.py)
    GET /[TOKEN/]save          the last 30 s
    POST /[TOKEN/]do/NAME      an action that the page offers, such as mark

A browser that takes nothing for STALLED_S is disconnected; it comes back by itself.

The last 30 s are saved as a zipped folder in the form of a recorded trial.

    holdfast-20261123-031512/tactile.csv     Time, X1 .. Zn, sequence, valid1 .. validn
                             meta.json       unit; the bias is taken off already
                             events.jsonl    marks

`holdfast replay MODEL FOLDER` reads it as it is.
"""

from __future__ import annotations

import hmac
import io
import json
import socket
import struct
import time
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from socketserver import ThreadingMixIn
from threading import BoundedSemaphore
from typing import Any
from urllib.parse import urlsplit

from holdfast.core.trial_layout import EVENTS, META, TACTILE
from holdfast.live.page.stream import LiveStream

Message = dict[str, Any]


def zipped(
    samples: list[Message], marks: list[Message], about: Message, name: str
) -> bytes:
    """A zip archive with one folder. samples: at least one."""
    # times count from the first saved sample, as in every recorded trial
    first_ns = samples[0]["t_ns"]
    meta = {"unit": about["unit"], "bias_removed": True, "model": about.get("model")}
    meta["seconds"] = 1e-9 * (samples[-1]["t_ns"] - first_ns)

    events = ""
    for mark in marks:
        # a mark is at a sample, so whole microseconds tell any two apart
        t_s = round(1e-9 * (mark["t_ns"] - first_ns), 6)
        label = f"mark {mark['number']}"
        events += json.dumps({"t_s": t_s, "mark": label, "provenance": "page"}) + "\n"

    content = {
        TACTILE: _table(samples),
        META: json.dumps(meta) + "\n",
        EVENTS: events,
    }

    # in memory: 30 s are small, and the process has no folder to write to
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for part, text in content.items():
            file.writestr(f"{name}/{part}", text)

    return archive.getvalue()


def _table(samples: list[Message]) -> str:
    first = samples[0]
    sensors = range(1, len(first["v"]) + 1)
    axes = [f"{axis}{k}" for k in sensors for axis in "XYZ"]
    valid = [f"valid{k}" for k in sensors]
    lines = [",".join(["Time", *axes, "sequence", *valid])]
    for sample in samples:
        # whole numbers: as a float, a time of many hours would lose its nanoseconds
        seconds, rest_ns = divmod(sample["t_ns"] - first["t_ns"], 10**9)
        cells = [f"{seconds}.{rest_ns:09d}"]
        # repr keeps every digit, so that the file replays to the same answers
        cells += map(repr, sample["x"])
        cells.append(str(sample["n"]))
        cells += map(str, sample["v"])
        lines.append(",".join(cells))

    return "\n".join(lines) + "\n"


FOLDER = Path(__file__).resolve().parent
FILES = {
    "": ("page.html", "text/html; charset=utf-8"),
    "page.css": ("page.css", "text/css; charset=utf-8"),
    "page.js": ("page.js", "text/javascript; charset=utf-8"),
    "hand.js": ("hand.js", "text/javascript; charset=utf-8"),
    "plot.js": ("plot.js", "text/javascript; charset=utf-8"),
}
"""Paths of the files of the page; nothing else is read from the disk."""
MOST_CONNECTIONS = 64
"""Connections at a time; further ones are closed at once."""
STALLED_S = 5.0
"""A browser that takes nothing for so long is disconnected."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Connection": "close",
}
RESET = struct.pack("ii", 1, 0)
"""Closing sends no more data."""
TEXT = "text/plain; charset=utf-8"
EVENT_STREAM = "text/event-stream"
ZIP = "application/zip"
REFUSED = "not allowed: open the address that the command printed\n"


@dataclass(frozen=True)
class Access:
    """Who may ask: with a token, requests that begin with it; without, those for one of hosts."""

    token: str
    hosts: tuple[str, ...]

    def path_of(self, path: str, host: str) -> str | None:
        """The path below the address of the page; None where the request is not allowed.

        path: of the request line. host: its Host header.
        """
        # what stands after a question mark never decides who may ask
        bare = path.partition("?")[0].removeprefix("/")
        # without a token the name is checked, so that no other site reaches the page under its own
        if not self.token:
            return bare if _name_of(host) in self.hosts else None
        given, slash, rest = bare.partition("/")
        # compared in constant time, so that its duration tells nothing of the token
        is_ours = hmac.compare_digest(
            given.encode("utf-8", "replace"), self.token.encode()
        )
        return rest if is_ours and slash else None


def _name_of(host: str) -> str | None:
    with suppress(ValueError):
        return urlsplit(f"//{host}").hostname
    return None


class PageServer(ThreadingMixIn, HTTPServer):
    """A thread for each connection, of which there are at most MOST_CONNECTIONS.

    listener: a listening socket. act: passes on an action's byte, False where there is no room.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(
        self,
        listener: socket.socket,
        stream: LiveStream,
        access: Access,
        act: Callable[[bytes], bool],
    ) -> None:
        super().__init__(
            listener.getsockname()[:2], PageHandler, bind_and_activate=False
        )
        # HTTPServer makes a socket of its own, but this one listens already
        self.socket.close()
        self.socket = listener
        self.stream = stream
        self.access = access
        self.act = act
        self._room = BoundedSemaphore(MOST_CONNECTIONS)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread; close the connection at once where there are too many."""
        # each connection costs a thread, and browsers open several
        if not self._room.acquire(blocking=False):
            self.shutdown_request(request)
            return
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and make room for another connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Browsers go away and stall: those are no errors. All others end one connection."""


class PageHandler(BaseHTTPRequestHandler):
    """One request."""

    server: PageServer
    server_version = "holdfast"
    sys_version = ""
    timeout = STALLED_S

    def do_GET(self) -> None:
        """A file of the page, the events, or the last 30 s."""
        path = self._allowed_path()
        if path is None:
            return
        # a table instead of a path on the disk: no request reaches another file
        if path in FILES:
            name, kind = FILES[path]
            self._answer(HTTPStatus.OK, kind, (FOLDER / name).read_bytes())
        elif path == "events":
            self._stream_events()
        elif path == "save":
            self._save()
        else:
            self._say(HTTPStatus.NOT_FOUND, "there is no such page\n")

    def do_POST(self) -> None:
        """An action."""
        path = self._allowed_path()
        if path is None:
            return
        # any site may send a POST to this machine: only the page's own may act on a run
        if self._is_foreign():
            self._say(HTTPStatus.FORBIDDEN, REFUSED)
            return

        actions = self.server.stream.about["actions"]
        offered = {f"do/{action['do']}": action["key"] for action in actions}
        if path not in offered:
            self._say(HTTPStatus.NOT_FOUND, "there is no such action\n")
        elif self.server.act(offered[path].encode()):
            self._say(HTTPStatus.ACCEPTED, "passed on\n")
        else:
            self._say(HTTPStatus.SERVICE_UNAVAILABLE, "the run takes no action now\n")

    def log_message(self, format: str, *args: Any) -> None:
        """Paths hold the token; nothing is written down."""

    def _allowed_path(self) -> str | None:
        path = self.server.access.path_of(self.path, self.headers.get("Host", ""))
        if path is None:
            self._say(HTTPStatus.FORBIDDEN, REFUSED)
        return path

    def _is_foreign(self) -> bool:
        """Whether another site's page sent the request. Every browser names the site of a POST."""
        origin = self.headers.get("Origin")
        return origin is not None and origin != f"http://{self.headers.get('Host', '')}"

    def _stream_events(self) -> None:
        self._head(HTTPStatus.OK, EVENT_STREAM)
        # a browser that was disconnected comes back after a second
        self.wfile.write(b"retry: 1000\n\n")
        try:
            for block in self.server.stream.frames():
                self.wfile.write(block)
        except TimeoutError:
            # what still waits is thrown away, so that a stalled browser holds no kernel memory
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)

    def _save(self) -> None:
        # copies, so that the run goes on while the archive is made
        samples, marks = self.server.stream.last()
        if not samples:
            self._say(HTTPStatus.NOT_FOUND, "no sample has come yet\n")
            return

        # the time of saving makes names differ, and sorts them
        name = time.strftime("holdfast-%Y%m%d-%H%M%S")
        archive = zipped(samples, marks, self.server.stream.about, name)
        attached = f'attachment; filename="{name}.zip"'
        self._answer(HTTPStatus.OK, ZIP, archive, {"Content-Disposition": attached})

    def _say(self, status: HTTPStatus, text: str) -> None:
        self._answer(status, TEXT, text.encode())

    def _answer(
        self,
        status: HTTPStatus,
        kind: str,
        content: bytes,
        more: dict[str, str] | None = None,
    ) -> None:
        length = {"Content-Length": str(len(content))}
        self._head(status, kind, length | (more or {}))
        self.wfile.write(content)

    def _head(
        self, status: HTTPStatus, kind: str, more: dict[str, str] | None = None
    ) -> None:
        self.send_response(status)
        headers = {"Content-Type": kind, **HEADERS, **(more or {})}
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
