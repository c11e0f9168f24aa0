"""Where lines come from: a stream of bytes, or datagrams. Nothing here waits for longer than asked.

A stream is standard input or a serial port. A port that is lost is opened again while it is read,
at most once a second.
"""

from __future__ import annotations

import os
import select
import socket
from collections.abc import Callable
from contextlib import suppress
from threading import Thread
from typing import Protocol

from holdfast.core.hand_lines import LONGEST_LINE, MOST_A_CALL

CHUNK_BYTES = 64 << 10
TRY_AGAIN_NS = 1_000_000_000


class Feed(Protocol):
    """What a LineSource reads. ended: no line will ever come again."""

    name: str
    ended: bool

    def pull(self, timeout_s: float) -> list[bytes]:
        """The lines that have come, oldest first, without their line ends.

        Waits at most so long for the first bytes.
        """
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

    def pull(self, timeout_s: float) -> list[bytes]:
        """The lines that have come; waits at most so long for the first bytes."""
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
        return self._lines.split(data)

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

    def close(self) -> None:
        """Close the port."""
        if self._handle >= 0:
            with suppress(OSError):
                os.close(self._handle)
        self._handle = -1

    def _try(self) -> None:
        with suppress(OSError):
            self._opened = self._open_port()


class DatagramFeed:
    """Lines that come as datagrams, one or several in each. closing: closes the socket."""

    ended = False

    def __init__(
        self, name: str, listener: socket.socket, closing: Callable[[], object]
    ) -> None:
        self.name = name
        self._listener = listener
        self._closing = closing

    def pull(self, timeout_s: float) -> list[bytes]:
        """The lines that have come; waits at most so long for the first datagram."""
        select.select([self._listener], [], [], max(0.0, timeout_s))
        lines: list[bytes] = []
        for _ in range(MOST_A_CALL):
            try:
                datagram = self._listener.recv(LONGEST_LINE + 1)
            except BlockingIOError:
                break
            lines += [line for line in datagram.split(b"\n") if line]
        return lines

    def close(self) -> None:
        """Close the socket."""
        self._closing()
