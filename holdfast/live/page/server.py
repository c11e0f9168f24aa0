"""The live page over HTTP: its files, and its stream of events.

    GET /TOKEN/              the page, and its scripts and style
    GET /TOKEN/events        server-sent events

A thread answers each request. A connection that sends or takes nothing for STALLED_S ends; a
browser comes back by itself.

All browsers get the same frames. A frame has the newest sample and a short row for each sample
since the frame before, so that no risky sample falls between two frames. A browser that was stalled
for longer than the frames are kept begins anew with a whole picture; none holds up another.
"""

from __future__ import annotations

import hmac
import json
import math
import socket
from collections import deque
from collections.abc import Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Condition
from typing import Any

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
Message = dict[str, Any]

SHOWN_S = 10.0
"""How much a new browser sees."""
FRAME_S = 0.06
"""The time between two frames: shorter than a display is read."""
KEPT_FRAMES = 32
"""About two seconds of frames for a slow browser."""
MOST_SAID = 40
"""Lines that the page shows and a new browser gets; older ones are forgotten."""
ROW_FIELDS = ("t_s", "state", "p_risky", "load", "grip", "target", "act")
"""What a row of a frame has, in this order; null where it is not known."""
SIGNIFICANT = 6
"""Digits of a shown number."""


# -- what the page knows


class LiveStream:
    """The samples and messages of one run. about: what the page shows of it once.

    One thread takes messages and publishes; any thread reads.
    """

    def __init__(self, about: Message) -> None:
        self.about = about
        self.ended = ""
        self._changed = Condition()
        self._newest: Message | None = None
        self._rows: deque[list[Any]] = deque()
        self._lines: deque[str] = deque(maxlen=MOST_SAID)
        self._news = _nothing_new()
        self._frames: deque[bytes] = deque(maxlen=KEPT_FRAMES)
        self._count = 0
        self._over = False
        self._first_ns = 0
        self._came_s = math.nan

    # -- from the run

    def take(self, message: Message, now_s: float) -> None:
        """One message of the run (run_page.py), at now_s of a monotonic clock."""
        with self._changed:
            if "sample" in message:
                self._take_sample(message["sample"])
                self._came_s = now_s
            if "said" in message:
                self._lines.append(message["said"])
                self._news["said"].append(message["said"])
            # the first reason counts: what follows a stop is only its consequence
            self.ended = self.ended or message.get("end", "")

    def _take_sample(self, sample: Message) -> None:
        before_ns = self._newest["t_ns"] if self._newest else math.inf
        # time never goes back within a run (holdfast/live/loop.py: restarts)
        if sample["t_ns"] < before_ns:
            self._rows.clear()
            self._news["rows"] = []
            self._news["restarts"] = True
            self._first_ns = sample["t_ns"]
        self._newest = sample

        row = self._row(sample)
        self._rows.append(row)
        self._news["rows"].append(row)
        # by time and not by count: the rate of a hand may change while it runs
        while self._rows[0][0] < row[0] - SHOWN_S:
            self._rows.popleft()

    def publish(self, now_s: float) -> None:
        """Make a frame of everything new, and wake the browsers' threads."""
        with self._changed:
            self._frames.append(event("frame", self._now(now_s) | self._news))
            self._count += 1
            self._news = _nothing_new()
            # only now: the frame that shows the end must be sent before a browser's loop stops
            self._over = bool(self.ended)
            self._changed.notify_all()

    # -- to a browser

    def frames(self) -> Iterator[bytes]:
        """Events for one browser: a whole picture, then frames as they come; ends with the run."""
        with self._changed:
            seen = self._count
            first = self._whole()

        yield first

        over = False
        while not over:
            with self._changed:
                while self._count == seen and not self._over:
                    self._changed.wait()
                # how many frames were made since this browser took its last one
                missed = self._count - seen
                seen = self._count
                over = self._over
                # where frames that it needs are gone, it begins with a whole picture
                newest = list(self._frames)[-missed:]
                if missed > len(self._frames):
                    newest = [self._whole()]
            # sent without the lock, so that a stalled browser holds up no other
            yield b"".join(newest)

    def _whole(self) -> bytes:
        picture = self._now(self._came_s)
        picture["about"] = {**self.about, "rows": ROW_FIELDS, "shown_s": SHOWN_S}
        picture["rows"] = list(self._rows)
        picture["said"] = list(self._lines)
        return event("whole", picture)

    def _now(self, now_s: float) -> Message:
        """The newest sample as it is shown, and how long none has come."""
        sample = self._as_shown(self._newest) if self._newest else None
        silent_s = _shown(now_s - self._came_s)
        return {"silent_s": silent_s, "sample": sample, "ended": self.ended}

    def _as_shown(self, sample: Message) -> Message:
        """A sample as the browser gets it: forces by finger."""
        shown = dict(sample)
        values = list(map(_shown, shown.pop("x")))
        shown["forces"] = [values[k : k + 3] for k in range(0, len(values), 3)]
        shown["t_s"] = self._since_start(shown.pop("t_ns"))
        return shown

    def _row(self, sample: Message) -> list[Any]:
        """A sample in the order of ROW_FIELDS, for the history of the page."""
        load = squeeze = 0.0
        # fingers that are not valid do not count, as in holdfast/edge_runtime/grip_control.py
        for k, good in enumerate(sample["v"]):
            x, y, z = sample["x"][3 * k : 3 * k + 3]
            if good and math.isfinite(x + y + z):
                load += math.hypot(x, y)
                # a finger cannot pull at an object: what is below zero is noise
                squeeze += max(z, 0.0)

        answer = sample["answer"]
        # a probability of an unknown state would look like an answer
        p_risky = None if answer["state"] == "unknown" else answer["p_risky"]
        # a target that does not leave is none of the hand's
        grip = sample.get("grip", {"leaves": False})
        target = grip["target_n"] if grip["leaves"] else None
        # in the order of ROW_FIELDS: a name in each row would make frames larger
        return [
            self._since_start(sample["t_ns"]),
            answer["state"],
            # thumb and fingers press against each other, so the grip of either side is half of both
            *map(_shown, (p_risky, load, 0.5 * squeeze, target)),
            int(answer["act"]),
        ]

    def _since_start(self, t_ns: int) -> float:
        return round(1e-9 * (t_ns - self._first_ns), 4)


def _nothing_new() -> Message:
    return {"rows": [], "said": [], "restarts": False}


def event(name: str, content: Message) -> bytes:
    """A server-sent event. Its JSON has no number that JavaScript cannot read."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return f"event: {name}\ndata: {text}\n\n".encode()


def _shown(value: float | None) -> float | None:
    """With few digits; None where it is no finite number."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{value:.{SIGNIFICANT}g}")


# -- over HTTP


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
    """What answers one request of a browser."""

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
