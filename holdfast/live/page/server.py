"""The live page over HTTP: its files, its stream of events, the last 30 s, and its actions.

    GET /[TOKEN/]              the page, and its scripts and style
    GET /[TOKEN/]events        server-sent events (stream.py)
    GET /[TOKEN/]save          the last 30 s
    POST /[TOKEN/]do/NAME      an action that the page offers, such as mark

A request must be whole REQUEST_S after its connection began, and its headers are limited. A browser
that takes nothing for STALLED_S is disconnected; it comes back by itself. Where there are too many
connections, those that have not asked for anything yet make way.

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
import re
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
from threading import Lock
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
MOST_CONNECTIONS, MOST_OF_ADDRESS = 64, 16
"""Connections at a time, altogether and from one address; a browser opens six."""
MOST_HEAD_BYTES = 32 << 10
"""Of a request's first line and headers: a browser sends 1 KiB, and cookies that pages on other
ports of this machine have set."""
REQUEST_S = 5.0
"""From the connection to the end of its request; a browser needs milliseconds."""
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
TOO_LONG = b"HTTP/1.0 431 Request Header Fields Too Large\r\n\r\n"
_HEAD_END = re.compile(rb"\n\r?\n")


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


def read_head(connection: socket.socket, now_s: Callable[[], float]) -> bytes | None:
    """The first line and headers of a request; None where they are too long.

    A part of them where the browser goes away. Raises TimeoutError where they are not whole after
    REQUEST_S, however many pieces came.
    """
    until_s = now_s() + REQUEST_S
    head = bytearray()
    while len(head) <= MOST_HEAD_BYTES:
        left_s = until_s - now_s()
        if left_s <= 0.0:
            raise TimeoutError
        connection.settimeout(left_s)
        piece = connection.recv(MOST_HEAD_BYTES + 1 - len(head))
        # the end may have begun in the piece before
        searched = max(0, len(head) - 2)
        head += piece
        if not piece or _HEAD_END.search(head, searched):
            return bytes(head)

    return None


class Visitors:
    """The open connections. Where there are too many, one makes way for the new one.

    The oldest that has not asked for anything makes way: a browser asks as soon as it is connected.
    Where all have asked, the oldest of the same address does. So no address takes the place of a
    browser elsewhere.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._addresses: dict[socket.socket, str] = {}
        self._asked: set[socket.socket] = set()

    def enter(self, connection: socket.socket, address: str) -> bool:
        """Take a connection in; False where none makes way for it."""
        with self._lock:
            same = [one for one, its in self._addresses.items() if its == address]
            crowd = list(self._addresses)
            has_room = len(crowd) < MOST_CONNECTIONS
            if len(same) >= MOST_OF_ADDRESS:
                crowd, has_room = same, False

            if not has_room:
                waiting = [one for one in crowd if one not in self._asked]
                leaver = next(iter(waiting + same), None)
                if leaver is None:
                    return False
                self._forget(leaver)
                # its thread may wait for it: this ends every read and write of a connection
                with suppress(OSError):
                    leaver.shutdown(socket.SHUT_RDWR)
            self._addresses[connection] = address
            return True

    def ask(self, connection: socket.socket) -> None:
        """Its request is whole."""
        with self._lock:
            if connection in self._addresses:
                self._asked.add(connection)

    def leave(self, connection: socket.socket) -> None:
        """It is about to be closed."""
        with self._lock:
            self._forget(connection)

    def _forget(self, connection: socket.socket) -> None:
        self._addresses.pop(connection, None)
        self._asked.discard(connection)


class PageServer(ThreadingMixIn, HTTPServer):
    """A thread for each connection.

    listener: a listening socket. act: passes on an action's byte, False where there is no room.
    now_s: a monotonic clock.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(
        self,
        listener: socket.socket,
        stream: LiveStream,
        access: Access,
        act: Callable[[bytes], bool],
        now_s: Callable[[], float] = time.monotonic,
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
        self.now_s = now_s
        self.visitors = Visitors()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread; close the connection at once where there are too many."""
        # each connection costs a thread, and browsers open several
        if self.visitors.enter(request, client_address[0]):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection, which makes room for another one."""
        self.visitors.leave(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Browsers go away and stall: those are no errors. All others end one connection."""


class PageHandler(BaseHTTPRequestHandler):
    """One request."""

    server: PageServer
    server_version = "holdfast"
    sys_version = ""

    def handle(self) -> None:
        """Read the request whole and within its limits, then answer it."""
        head = read_head(self.connection, self.server.now_s)
        self.connection.settimeout(STALLED_S)
        if head is None:
            self.wfile.write(TOO_LONG)
            return

        self.server.visitors.ask(self.connection)
        self.rfile.close()
        self.rfile = io.BytesIO(head)
        super().handle()

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
