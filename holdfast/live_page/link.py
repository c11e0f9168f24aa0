"""The loop's end of the live page: messages that leave without waiting, and the page's actions.

The page is served by a process of its own, because threads of the loop's process would take turns
with it. Between both is a pair of sockets that never block. A message that finds no room is dropped
and counted. Where that process dies, the loop says so once and goes on.

One message is one packet of JSON. The first has `access` and `about`; later ones have one of
`sample`, `said`, `mark`, `ready`, `about`, and the last one `end`. An action is one byte.
"""

from __future__ import annotations

import errno
import json
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress

from holdfast.edge_runtime.errors import OutputError
from holdfast.edge_runtime.reading import Json
from holdfast.live_page.address import PageAddress, listen

PROCESS = "holdfast.live_page.process"
READY = b"ready"
WAITING_BYTES = 200 << 10
"""Room for messages that wait: more than a second of samples at 150 Hz."""
START_S, END_S = 30.0, 0.5
"""How long a run waits for the process to start, and to end."""
GONE = (errno.EPIPE, errno.ECONNRESET, errno.ENOTCONN, errno.EBADF)
_to_json = json.JSONEncoder(separators=(",", ":")).encode


class PageLink:
    """Messages to the page's process. unsent: messages that were dropped. handle: of its actions.

    channel: a packet socket. say: gets one line where the process is gone.
    """

    def __init__(self, channel: socket.socket, say: Callable[[str], object]) -> None:
        channel.setblocking(False)
        self._channel, self._say = channel, say
        self.unsent, self._gone = 0, False
        self.handle = channel.fileno()

    def send(self, message: Json) -> bool:
        """Send one message; False where it was dropped. Never waits."""
        if self._gone:
            return False
        try:
            self._channel.send(_to_json(message).encode())
        except OSError as error:
            self._drop(error)
            return False
        return True

    def action(self) -> bytes:
        """The next action of the page, b"" where there is none. Never waits."""
        try:
            return self._channel.recv(1)
        except OSError:
            return b""

    def close(self, end: str) -> None:
        """End the link, and say how it ended; the loop is over, so this may wait for END_S."""
        with suppress(OSError):
            self._channel.settimeout(END_S)
            self._channel.send(_to_json({"end": end}).encode())
        self._channel.close()

    def _drop(self, error: OSError) -> None:
        self.unsent += 1
        if error.errno in GONE:
            self._gone = True
            self._say("the live page's process ended; nothing is shown any more, the run goes on")


@contextmanager
def live_page(
    address: str, about: Json, say: Callable[[str], object], whole: str
) -> Iterator[PageLink]:
    """Serve the page on [HOST:]PORT, and say its URL. whole: what ends with it, such as "the run".

    Raises UsageError for an address that cannot be had, OutputError without a process.
    """
    place = listen(address)
    with closing(place.listener):
        channel, process = _started(place, about)
    link, end = PageLink(channel, say), f"{whole} failed"
    say(f"live page: {place.url}")
    try:
        yield link
        end = f"{whole} has ended"
    finally:
        link.close(end)
        with suppress(subprocess.TimeoutExpired):
            process.wait(END_S)


def _started(place: PageAddress, about: Json) -> tuple[socket.socket, subprocess.Popen[bytes]]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, WAITING_BYTES)
    numbers = [place.listener.fileno(), theirs.fileno()]
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-m", PROCESS, *map(str, numbers)],
            pass_fds=numbers,
            start_new_session=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    try:
        ours.send(_to_json({"access": place.access(), "about": about}).encode())
        ours.settimeout(START_S)
        if ours.recv(len(READY)) != READY:
            raise OSError("it ended at once")
    except OSError as error:
        ours.close()
        process.kill()
        process.wait()
        what = f"no process for the live page ({error.strerror or error})"
        raise OutputError(what, where="--web", next_step="run without --web") from None
    return ours, process
