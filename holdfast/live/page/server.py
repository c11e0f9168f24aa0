"""The live page over HTTP: its files, and its stream of events.

    GET /TOKEN/              the page, and its scripts and style
    GET /TOKEN/events        server-sent events (stream.py)

A thread answers each request. A connection that sends or takes nothing for STALLED_S ends; a
browser comes back by itself.
"""

from __future__ import annotations

import hmac
import socket
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from holdfast.live.page.stream import LiveStream

FOLDER = Path(__file__).resolve().parent
FILES = {
    "": ("page.html", "text/html; charset=utf-8"),
    "page.css": ("page.css", "text/css; charset=utf-8"),
    "page.js": ("page.js", "text/javascript; charset=utf-8"),
    "hand.js": ("hand.js", "text/javascript; charset=utf-8"),
    "plot.js": ("plot.js", "text/javascript; charset=utf-8"),
}
"""Paths of the files of the page; nothing else is read from the disk."""
STALLED_S = 5.0
"""A connection that sends or takes nothing for so long ends."""
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
TEXT = "text/plain; charset=utf-8"
EVENT_STREAM = "text/event-stream"
REFUSED = b"not allowed: open the address that the command printed\n"


class PageServer(ThreadingHTTPServer):
    """The page's server. listener: a listening socket."""

    block_on_close = False

    def __init__(self, listener: socket.socket, stream: LiveStream, token: str) -> None:
        address = listener.getsockname()[:2]
        super().__init__(address, PageHandler, bind_and_activate=False)
        # it makes a socket of its own, but this one listens already
        self.socket.close()
        self.socket = listener
        self.stream = stream
        self.token = token

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Browsers go away and stall: those are no errors. All others end one connection."""


class PageHandler(BaseHTTPRequestHandler):
    """One request."""

    server: PageServer
    server_version = "holdfast"
    sys_version = ""
    timeout = STALLED_S

    def do_GET(self) -> None:
        """A file of the page, or the events."""
        path = self._allowed_path()
        # a table instead of a path on the disk: no request reaches another file
        if path is None:
            self._answer(HTTPStatus.FORBIDDEN, TEXT, REFUSED)
        elif path in FILES:
            name, kind = FILES[path]
            self._answer(HTTPStatus.OK, kind, (FOLDER / name).read_bytes())
        elif path == "events":
            self._stream_events()
        else:
            self._answer(HTTPStatus.NOT_FOUND, TEXT, b"there is no such page\n")

    def log_message(self, format: str, *args: Any) -> None:
        """Paths hold the token; nothing is written down."""

    def _allowed_path(self) -> str | None:
        """The path below the address of the page; None where the token is another."""
        # what stands after a question mark never decides who may ask
        given, slash, rest = (
            self.path.partition("?")[0].removeprefix("/").partition("/")
        )
        # compared in constant time, so that its duration tells nothing of the token
        asked = given.encode("utf-8", "replace")
        if slash and hmac.compare_digest(asked, self.server.token.encode()):
            return rest
        return None

    def _stream_events(self) -> None:
        self._head(HTTPStatus.OK, EVENT_STREAM)
        # a browser that was disconnected comes back after a second
        self.wfile.write(b"retry: 1000\n\n")
        for block in self.server.stream.frames():
            self.wfile.write(block)

    def _answer(self, status: HTTPStatus, kind: str, content: bytes) -> None:
        self._head(status, kind, **{"Content-Length": str(len(content))})
        self.wfile.write(content)

    def _head(self, status: HTTPStatus, kind: str, **more: str) -> None:
        self.send_response(status)
        headers = {"Content-Type": kind, **HEADERS, **more}
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
