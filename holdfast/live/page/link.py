"""The loop's end of the live page: messages that leave without waiting.

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
from urllib.parse import urlsplit

from holdfast.core.contract import Json
from holdfast.core.errors import OutputError, UsageError

LOOPBACK = "127.0.0.1"
TOKEN_BYTES = 16
WAITING_CONNECTIONS = 64
SEND_BUFFER = 32 << 10
"""Bytes that wait for a slow browser: a second or two of frames, so that it never shows old ones
for long."""
EXAMPLES = "web:8000 (this machine only), or web:0.0.0.0:8000 (the network)"


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


PROCESS = "holdfast.live.page.process"
READY = b"ready"
WAITING_BYTES = 200 << 10
"""Room for messages that wait: more than a second of samples at 150 Hz."""
START_S, END_S = 30.0, 0.5
"""How long a run waits for the process to start, and to end."""
GONE = (errno.EPIPE, errno.ECONNRESET, errno.ENOTCONN, errno.EBADF)
_to_json = json.JSONEncoder(separators=(",", ":")).encode


class PageLink:
    """Messages to the page's process. unsent: messages that were dropped.

    channel: a packet socket. process: serves the page, None in tests. report: gets one line where
    the process is gone.
    """

    def __init__(
        self,
        channel: socket.socket,
        report: Callable[[str], object],
        process: subprocess.Popen[bytes] | None = None,
    ) -> None:
        # a page that does not read costs messages, and never a sample its time
        channel.setblocking(False)
        self._channel = channel
        self._report = report
        self._process = process
        self.unsent = 0
        self._gone = False

    def send(self, message: Json) -> bool:
        """Send one message; False where it was dropped. Never waits."""
        # the loss was reported already, and the run goes on without the page
        if self._gone:
            return False
        try:
            self._channel.send(_to_json(message).encode())
        except OSError as error:
            self._drop(error)
            return False
        return True

    def close(self, end: str) -> None:
        """Show how the run ended and end the link; the loop is over, so this may wait for END_S."""
        with suppress(OSError):
            # the last message says how the run ended, so it may wait, but not for ever
            self._channel.settimeout(END_S)
            self._channel.send(_to_json({"end": end}).encode())

        self._channel.close()

        if self._process is not None:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(END_S)

    def _drop(self, error: OSError) -> None:
        self.unsent += 1
        if error.errno in GONE:
            self._gone = True
            self._report(
                "the live page's process ended; nothing is shown any more, the run goes on"
            )


def open_page(address: str, about: Json, report: Callable[[str], object]) -> PageLink:
    """Serve the page on [HOST:]PORT until the link is closed, and report its URL.

    Raises UsageError for an address that cannot be had, OutputError without a process.
    """
    token = secrets.token_urlsafe(TOKEN_BYTES)
    listener, url = listen(address, token)
    with listener:
        link = _started(listener, {"token": token, "about": about}, report)
    report(f"live page: {url}")
    return link


def _started(
    listener: socket.socket, first: Json, report: Callable[[str], object]
) -> PageLink:
    # packets: a message arrives whole or not at all, also where the room for it runs out
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING_BYTES)
    numbers = [listener.fileno(), theirs.fileno()]
    with theirs:
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
        ours.send(_to_json(first).encode())
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

    return PageLink(ours, report, process)
