"""The live page of `holdfast run --to web`: every sample, its answer, its grip command.

The page is served by a separate process, because threads of the loop's process would take turns
with it. Between both is a pair of sockets that never block. A message that finds no room is dropped
and counted. Where that process dies, the loop reports it once and goes on.

One message is one packet of JSON. The first has `token` and `about`; later ones have `sample` or
`said`, and the last one `end`.

The page listens on [HOST:]PORT. Each path begins with a token, a secret of 128 bits that is drawn
anew for every run: without it no other user, machine or web site reaches the page.
"""

from __future__ import annotations

import errno
import json
import secrets
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from holdfast.core.contract import (
    RISKY_SLIP,
    SITUATIONS,
    GripCommand,
    Json,
    Prediction,
    Sample,
)
from holdfast.core.errors import OutputError, UsageError
from holdfast.core.hand_card import (
    ALL_AXES,
    SIDES,
    HandCard,
    hand_or_usual,
    sensor_names,
)
from holdfast.core.source import SourceReading
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.wearer import IntentMonitor
from holdfast.live.outputs import STOPPED

if TYPE_CHECKING:
    from holdfast.live.grip import GripOutput

LOOPBACK = "127.0.0.1"
TOKEN_BYTES = 16
WAITING_CONNECTIONS = 64
SEND_BUFFER = 32 << 10
"""Bytes that wait for a slow browser: a second or two of frames, so that it never shows old ones
for long."""
EXAMPLES = "web:8000 (this machine only), or web:0.0.0.0:8000 (the network)"
PROCESS = "holdfast.live.page.process"
READY = b"ready"
WAITING_BYTES = 200 << 10
"""Room for messages that wait: more than a second of samples at 150 Hz."""
START_S, END_S = 30.0, 0.5
"""How long a run waits for the process to start, and to end."""
GONE = (errno.EPIPE, errno.ECONNRESET, errno.ENOTCONN, errno.EBADF)
_to_json = json.JSONEncoder(separators=(",", ":")).encode
A_ROW, APART_MM = 4, 25.0
"""Sensors of which no card says where they are."""
ANSWER = (
    "state",
    "why",
    "p_risky",
    "weight",
    "latency_us",
    "arm",
    "act",
    "opening",
    "overridden",
    "commands",
    "late",
    "started_loaded",
    "degraded",
)
"""What the page gets of a prediction."""


# -- the page's process


def read_address(text: str) -> tuple[str, int]:
    """(host, port) of [HOST:]PORT. Raises UsageError.

    >>> read_address("8000"), read_address("[::1]:0")
    (('127.0.0.1', 8000), ('::1', 0))
    """
    try:
        parts = urlsplit(f"//{text}" if ":" in text else f"//{LOOPBACK}:{text}")
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if not host or port is None:
        what = f"web:{text[:80]} is no address of a page"
        raise UsageError(what, next_step=EXAMPLES)
    return host, port


def listen(text: str, token: str) -> tuple[socket.socket, str]:
    """(a socket that listens on [HOST:]PORT, the URL to open); port 0: any free one.

    Raises UsageError where the host is unknown or the port cannot be had.
    """
    host, port = read_address(text)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server(
            (host, port), family=family, backlog=WAITING_CONNECTIONS
        )
    except (OSError, UnicodeError) as error:
        what = getattr(error, "strerror", None) or str(error)
        raise UsageError(
            f"web:{text[:80]}: {what.lower()}",
            next_step="choose another port, such as web:8001, or web:0 for any free one",
        ) from None
    # accepted connections have it too
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)

    # these are where it listens, and no addresses that a browser elsewhere could open
    shown = socket.gethostname() if host in ("0.0.0.0", "::") else host
    shown = f"[{shown}]" if ":" in shown else shown
    return listener, f"http://{shown}:{listener.getsockname()[1]}/{token}/"


@dataclass
class PageLink:
    """Messages to the page's process. unsent: messages that were dropped.

    channel: a packet socket. process: serves the page, None in tests. report: gets one line where
    the process is gone.
    """

    channel: socket.socket
    report: Callable[[str], object]
    process: subprocess.Popen[bytes] | None = None
    unsent: int = 0
    gone: bool = False

    def __post_init__(self) -> None:
        # a page that does not read costs messages, and never a sample its time
        self.channel.setblocking(False)

    def send(self, message: Json) -> bool:
        """Send one message; False where it was dropped. Never waits."""
        # the loss was reported already, and the run goes on without the page
        if self.gone:
            return False
        try:
            self.channel.send(_to_json(message).encode())
        except OSError as error:
            self._drop(error)
            return False
        return True

    def close(self, end: str) -> None:
        """Show how the run ended and end the link; the loop is over, so this may wait for END_S."""
        with suppress(OSError):
            # the last message says how the run ended, so it may wait, but not for ever
            self.channel.settimeout(END_S)
            self.channel.send(_to_json({"end": end}).encode())

        self.channel.close()

        if self.process is not None:
            with suppress(subprocess.TimeoutExpired):
                self.process.wait(END_S)

    def _drop(self, error: OSError) -> None:
        self.unsent += 1
        if error.errno in GONE:
            self.gone = True
            self.report(
                "the live page's process ended; nothing is shown any more, the run goes on"
            )


def open_page(address: str, about: Json, report: Callable[[str], object]) -> PageLink:
    """Serve the page on [HOST:]PORT until the link is closed, and report its URL.

    Raises UsageError for an address that cannot be had, OutputError without a process.
    """
    token = secrets.token_urlsafe(TOKEN_BYTES)
    listener, url = listen(address, token)
    # packets: a message arrives whole or not at all, also where the room for it runs out
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING_BYTES)
    numbers = [listener.fileno(), theirs.fileno()]
    with listener, theirs:
        # a session of its own: Ctrl-C in the terminal ends the run, which then ends the page
        process = subprocess.Popen(
            [sys.executable, "-m", PROCESS, *map(str, numbers)],
            pass_fds=numbers,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    try:
        ours.send(_to_json({"token": token, "about": about}).encode())
        # a process that hangs while it starts must not hold the run for ever
        ours.settimeout(START_S)
        if ours.recv(len(READY)) != READY:
            raise OSError("it ended at once")
    except OSError as error:
        ours.close()
        # without its channel the process serves nothing
        process.kill()
        process.wait()
        what = f"no process for the live page ({error.strerror or error})"
        raise OutputError(what, where="web", next_step="run without the page") from None

    report(f"live page: {url}")
    return PageLink(ours, report, process)


# -- what it shows


@dataclass
class RunPage:
    """The page as an output of a run. grip: what runs a controller; None where none does.

    why_ended: why the run ended, as far as it is known.
    """

    link: PageLink
    card: ModelCard
    grip: GripOutput | None = None
    intent: IntentMonitor | None = None
    why_ended: str = ""
    _lost: int = 0
    _next: int = 0

    def write(
        self,
        prediction: Prediction,
        sample: Sample,
        reading: SourceReading,
        command: GripCommand | None = None,
    ) -> None:
        """Send one sample; nothing waits, and what finds no room is dropped."""
        # a gap in the numbers is what the loop did not read in time
        self._lost += sample.sequence - self._next
        self._next = sample.sequence + 1

        message: Json = {
            "t_ns": sample.t_ns,
            "x": sample.values.tolist(),
            "v": sample.valid.astype(int).tolist(),
            "why": reading.why,
            "lost": self._lost,
            "unsent": self.link.unsent,
            "answer": {name: getattr(prediction, name) for name in ANSWER},
        }
        # A probability of almost 0 would look like an answer.
        if SITUATIONS[RISKY_SLIP] in self.card.not_learned:
            message["answer"]["p_risky"] = None
        if self.grip is not None and command is not None:
            message["grip"] = command._asdict() | {"leaves": self.grip.leaves}
        if self.intent is not None:
            wants = self.intent.newest.wants
            message["intent"] = {"wants": wants, "link": self.intent.link}
        self.link.send({"sample": message})

    def report(self, line: str) -> None:
        """Show a message of the run."""
        self.link.send({"said": line})

    def close(self, reason: str) -> None:
        """Show how the run ended."""
        how = "the run has ended" if reason == STOPPED else "the run failed"
        self.link.close(f"{how}: {self.why_ended}" if self.why_ended else how)


def drawn_hand(card: HandCard | None, n_sensors: int) -> list[Json]:
    """The contacts of a hand for the page, sensors in the order of their channels.

    side: 0 or 1, left and right of the object; null, with places in a row, without a card.
    """
    hand = hand_or_usual(card, n_sensors)
    if hand is not None:
        names = iter(hand.sensor_names)
        return [
            {
                "name": next(names) if one.sensed else "",
                "side": SIDES.index(one.side),
                "x_mm": one.across_mm,
                "y_mm": one.along_mm,
                "pad": one.pad,
                "sensed": one.sensed,
                "measures": one.measures,
            }
            for one in hand.contacts
        ]

    contacts: list[Json] = []
    for k, name in enumerate(sensor_names(None, n_sensors)):
        place = {"x_mm": APART_MM * (k % A_ROW), "y_mm": -APART_MM * (k // A_ROW)}
        sensed = {"pad": "", "sensed": True, "measures": ALL_AXES}
        contacts.append({"name": name, "side": None, **place, **sensed})
    return contacts


def open_run_page(
    address: str,
    source: str,
    model: str,
    card: ModelCard,
    report: Callable[[str], None],
    *,
    with_grip: bool,
) -> RunPage:
    """The page of a run, served at [HOST:]PORT. Raises UsageError and OutputError.

    source: a URL; model: a file. with_grip: whether a controller sends commands.
    """
    about: Json = {
        "unit": card.unit,
        "hand": drawn_hand(card.hand, card.n_channels // 3),
        "model": f"{Path(model).name} ({card.model_id})",
        "source": source,
        "grip": with_grip,
    }
    return RunPage(open_page(address, about, report), card)
