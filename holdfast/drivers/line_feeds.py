"""Where lines come from: a stream of bytes, or datagrams. Nothing here waits for longer than asked.

A stream is standard input, a serial port or a TCP connection. One that is lost is opened again
while it is read, at most once a second. A TCP port that listens has one client at a time: another
one is let in where the client has sent no sample for 300 ms.
"""

from __future__ import annotations

import errno
import os
import select
import socket
from collections.abc import Callable, Hashable
from contextlib import suppress
from threading import Thread
from typing import Any, Protocol

from holdfast.core.line_port import Datagrams
from holdfast.core.line_session import LONGEST_LINE, SILENCE_NS

CHUNK_BYTES = 64 << 10
TRY_AGAIN_NS = 1_000_000_000
MOST_ACCEPTED = 8
"""New connections that are looked at in one call."""
Lines = list[tuple[Hashable, bytes]]
"""(sender, line without its line end), oldest first."""


class Feed(Protocol):
    """What a LineSource reads. ended: no line will ever come again."""

    name: str
    ended: bool

    def pull(self, timeout_s: float) -> Lines:
        """What has come; waits at most so long for the first bytes."""
        ...

    def obeyed(self, peer: Hashable) -> None:
        """A sender's line was a sample."""
        ...

    def close(self) -> None:
        """Close everything."""
        ...


class LineSplitter:
    """Cuts bytes into lines. A line that is too long is cut short, and its rest is dropped."""

    def __init__(self) -> None:
        self._rest = b""
        self._skips = False

    def split(self, data: bytes) -> list[bytes]:
        """The lines that are whole now, without their line ends."""
        *lines, rest = (self._rest + data).split(b"\n")
        if self._skips and lines:
            del lines[0]
            self._skips = False
        self._rest = b"" if self._skips else rest
        if len(self._rest) > LONGEST_LINE:
            # one byte too long, so that it is counted as too long
            lines.append(self._rest[: LONGEST_LINE + 1])
            self._rest = b""
            self._skips = True
        return lines


class StreamEnd(Protocol):
    """Opens a stream. number: of the connection, from 0."""

    number: int

    def handle(self) -> int | None:
        """The descriptor; None while it is not open. Opens it without waiting."""
        ...

    def lost(self) -> bool:
        """The stream ended or failed. Whether it may come back."""
        ...

    def obeyed(self) -> None:
        """A sample came."""
        ...

    def close(self) -> None:
        """Close it."""
        ...


class StreamFeed:
    """Lines of one stream. say: receives a line when it is lost, and when it is back."""

    def __init__(self, name: str, end: StreamEnd, say: Callable[[str], object]) -> None:
        self.name = name
        self.ended = False
        self._end = end
        self._say = say
        self._lines = LineSplitter()
        self._number: int | None = None
        self._is_lost = False

    def pull(self, timeout_s: float) -> Lines:
        """What has come; waits at most so long for the first bytes."""
        handle = None if self.ended else self._end.handle()
        if handle is None:
            # nothing to read from: the time passes all the same
            select.select([], [], [], max(0.0, timeout_s))
            return []
        if self._number != self._end.number:
            self._begin(self._end.number)
        if not select.select([handle], [], [], max(0.0, timeout_s))[0]:
            return []
        data = self._read(handle)
        return [(self._number, line) for line in self._lines.split(data)]

    def obeyed(self, peer: Hashable) -> None:
        """A sender's line was a sample."""
        if peer == self._number:
            self._end.obeyed()

    def close(self) -> None:
        """Close the stream."""
        self._end.close()

    def _begin(self, number: int) -> None:
        self._number = number
        # the end of a line that was cut off is no line
        self._lines = LineSplitter()
        if self._is_lost:
            self._say(f"{self.name}: it is back")
        self._is_lost = False

    def _read(self, handle: int) -> bytes:
        try:
            data = os.read(handle, CHUNK_BYTES)
        except BlockingIOError:
            return b""
        except OSError as error:
            self._lose(error.strerror or str(error))
            return b""
        if not data:
            self._lose("its sender closed it")
        return data

    def _lose(self, why: str) -> None:
        if not self._end.lost():
            self.ended = True
        elif not self._is_lost:
            self._say(
                f"{self.name}: lost ({why}); the state is unknown until it is back"
            )
            self._is_lost = True


class StandardInput:
    """What is piped into the program; its end is the end of the source."""

    number = 0

    def __init__(self, handle: int = 0) -> None:
        self._handle = handle

    def handle(self) -> int | None:
        """The descriptor."""
        return self._handle

    def lost(self) -> bool:
        """It does not come back."""
        return False

    def obeyed(self) -> None:
        """Nothing to note."""

    def close(self) -> None:
        """It belongs to the program."""


class SerialEnd:
    """A serial port. open_port: opens it without waiting for a carrier; raises OSError."""

    def __init__(
        self, handle: int, open_port: Callable[[], int], now_ns: Callable[[], int]
    ) -> None:
        self.number = 0
        self._handle = handle
        self._open_port = open_port
        self._now_ns = now_ns
        self._looked_ns = 0
        self._opening: Thread | None = None
        self._opened = -1

    def handle(self) -> int | None:
        """The descriptor; looks for a lost port once a second, in a thread."""
        if self._handle >= 0:
            return self._handle
        if self._opening is not None and self._opening.is_alive():
            return None
        if self._opened >= 0:
            self._handle, self._opened = self._opened, -1
            self.number += 1
            return self._handle
        if self._now_ns() - self._looked_ns >= TRY_AGAIN_NS:
            self._looked_ns = self._now_ns()
            # opening a dying adapter can take seconds
            self._opening = Thread(target=self._try, name="serial port", daemon=True)
            self._opening.start()
        return None

    def lost(self) -> bool:
        """Close it: an adapter gets another name as long as a process holds the old one."""
        self.close()
        self._looked_ns = self._now_ns()
        return True

    def obeyed(self) -> None:
        """Nothing to note."""

    def close(self) -> None:
        """Close the port."""
        if self._handle >= 0:
            with suppress(OSError):
                os.close(self._handle)
        self._handle = -1

    def _try(self) -> None:
        with suppress(OSError):
            self._opened = self._open_port()


class TcpCaller:
    """A connection to an address, which is made again after it was lost."""

    def __init__(
        self,
        connection: socket.socket,
        address: tuple[Any, ...],
        now_ns: Callable[[], int],
    ) -> None:
        """connection: connected to the address."""
        self.number = 0
        self._socket: socket.socket | None = connection
        self._family = connection.family
        self._address = address
        self._now_ns = now_ns
        self._looked_ns = 0
        self._connecting = False
        connection.setblocking(False)

    def handle(self) -> int | None:
        """The descriptor of the connection."""
        if self._socket is not None and self._connecting:
            self._finish(self._socket)
        elif self._socket is None and self._now_ns() - self._looked_ns >= TRY_AGAIN_NS:
            self._begin()
        if self._socket is None or self._connecting:
            return None
        return self._socket.fileno()

    def lost(self) -> bool:
        """It may be made again."""
        self.close()
        self._looked_ns = self._now_ns()
        return True

    def obeyed(self) -> None:
        """Nothing to note."""

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._connecting = False

    def _begin(self) -> None:
        self._looked_ns = self._now_ns()
        self._socket = socket.socket(self._family, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._connecting = True
        if self._socket.connect_ex(self._address) not in (0, errno.EINPROGRESS):
            self.close()

    def _finish(self, connection: socket.socket) -> None:
        """Look whether the connection is made."""
        if not select.select([], [connection], [], 0.0)[1]:
            # an address that does not answer is tried anew
            if self._now_ns() - self._looked_ns > 5 * TRY_AGAIN_NS:
                self.lost()
            return
        if connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self.close()
            return
        self._connecting = False
        self.number += 1


class TcpListener:
    """A port that one client at a time connects to. refused: called for each other one."""

    def __init__(
        self,
        listener: socket.socket,
        now_ns: Callable[[], int],
        refused: Callable[[], object],
    ) -> None:
        self.number = -1
        self._listener = listener
        self._now_ns = now_ns
        self._refused = refused
        self._client: socket.socket | None = None
        self._heard_ns = 0
        listener.setblocking(False)

    def handle(self) -> int | None:
        """The descriptor of the client."""
        for _ in range(MOST_ACCEPTED):
            try:
                newcomer, _ = self._listener.accept()
            except OSError:
                break
            self._meet(newcomer)
        return None if self._client is None else self._client.fileno()

    def lost(self) -> bool:
        """Another client may come."""
        if self._client is not None:
            self._client.close()
        self._client = None
        return True

    def obeyed(self) -> None:
        """The client sent a sample."""
        self._heard_ns = self._now_ns()

    def close(self) -> None:
        """Close the client and the port."""
        self.lost()
        self._listener.close()

    def _meet(self, newcomer: socket.socket) -> None:
        now_ns = self._now_ns()
        if self._client is not None and now_ns - self._heard_ns <= SILENCE_NS:
            newcomer.close()
            self._refused()
            return
        self.lost()
        newcomer.setblocking(False)
        self._client = newcomer
        self._heard_ns = now_ns
        self.number += 1


class DatagramFeed:
    """Lines that come as datagrams, one or several in each. closing: closes the socket."""

    ended = False

    def __init__(
        self, name: str, datagrams: Datagrams, closing: Callable[[], object]
    ) -> None:
        self.name = name
        self._datagrams = datagrams
        self._closing = closing

    def pull(self, timeout_s: float) -> Lines:
        """What has come; waits at most so long for the first datagram."""
        select.select(self._datagrams.sockets, [], [], max(0.0, timeout_s))
        lines: Lines = []
        for datagram, address in self._datagrams.waiting():
            lines += [(address, line) for line in datagram.split(b"\n") if line]
        return lines

    def obeyed(self, peer: Hashable) -> None:
        """Give the sender a queue of its own, which others cannot fill."""
        self._datagrams.follow(peer)

    def close(self) -> None:
        """Close the sockets."""
        self._datagrams.close()
        self._closing()
