"""Where lines come from: standard input, a serial port, a Unix socket. Nothing here waits for
longer than asked. The only import of pyserial is here, which the extra `serial` installs.
"""

from __future__ import annotations

import errno
import os
import select
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from holdfast.core.errors import (
    AccessDenied,
    DeviceLost,
    DeviceNotFound,
    UsageError,
    needs_extra,
)
from holdfast.core.hand_lines import LONGEST_LINE, MOST_A_CALL, unix_listener

CHUNK_BYTES = 64 << 10
DEFAULT_BAUD = 115200
BITS_A_BYTE = 10
"""On a serial line: a start bit, eight bits, a stop bit."""


class LineSplitter:
    """Cuts bytes into lines. A line that is too long is cut short, and its rest is dropped."""

    def __init__(self) -> None:
        self._rest = b""
        self._skips = False

    @property
    def unfinished(self) -> int:
        """Bytes of a line whose end has not come."""
        return len(self._rest)

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


class StreamFeed:
    """Lines of a descriptor. close: closes it; None for standard input, whose end is the end.

    ended: no line will ever come again. bytes_per_s: what a serial port carries at most.
    """

    bytes_per_s: float | None = None

    def __init__(
        self, name: str, handle: int, close: Callable[[], object] | None = None
    ) -> None:
        self.name = name
        self.ended = False
        self._handle = handle
        self._close = close
        self._lines = LineSplitter()

    def pull(self, timeout_s: float) -> list[bytes]:
        """The lines that have come, oldest first, without their line ends.

        Waits at most so long for the first bytes. Raises DeviceLost.
        """
        if not select.select([self._handle], [], [], max(0.0, timeout_s))[0]:
            return []
        why = "its sender closed it"
        data = b""
        try:
            data = os.read(self._handle, CHUNK_BYTES)
        except OSError as error:
            why = error.strerror or str(error)
        if not data and self._close is not None:
            raise DeviceLost(f"lost ({why})", where=self.name, cause="it was unplugged")
        self.ended = not data
        return self._lines.split(data)

    @property
    def unfinished(self) -> int:
        """Bytes that have come of a line whose end has not."""
        return self._lines.unfinished

    def close(self) -> None:
        """Close the descriptor; standard input belongs to the program."""
        if self._close is not None:
            self._close()


class DatagramFeed:
    """Lines that come to a Unix socket as datagrams, one or several in each. Raises UsageError."""

    ended = False
    bytes_per_s: float | None = None
    unfinished = 0

    def __init__(self, path: str) -> None:
        self.name = f"unix://{path}"
        with ExitStack() as stack:
            self._listener = unix_listener(Path(path), "samples", stack)
            self._stack = stack.pop_all()

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
        """Close the socket, and remove its file."""
        self._stack.close()


Feed = StreamFeed | DatagramFeed
"""What a LineSource reads."""


def stdin_feed() -> StreamFeed:
    """What is piped into the program."""
    return StreamFeed("stdin", 0)


def serial_feed(path: str, baud: int) -> StreamFeed:
    """A serial port. Raises LibraryMissing, UsageError, DeviceNotFound, AccessDenied."""
    port = open_port(path, baud)
    feed = StreamFeed(f"serial://{path}", port.fileno(), port.close)
    feed.bytes_per_s = baud / BITS_A_BYTE
    return feed


def open_port(path: str, baud: int = DEFAULT_BAUD) -> Any:
    """A `serial.Serial` that waits for nothing: raw, eight bits, no parity, no flow control.

    Its fileno() serves select, os.read and os.write. Raises LibraryMissing without pyserial,
    UsageError, DeviceNotFound, AccessDenied.
    """
    with needs_extra("serial"):
        import serial
    try:
        return serial.Serial(path, baud, timeout=0, write_timeout=0)
    except ValueError as error:
        raise UsageError(
            f"baud={baud} cannot be set here ({error})", next_step="baud=115200"
        ) from None
    except OSError as error:
        where = f"serial://{path}"
        # pyserial raises an OSError of its own, with the number
        if error.errno == errno.EACCES:
            raise AccessDenied(
                str(error),
                where=where,
                next_step="join the group of the port (dialout)",
            ) from None
        raise DeviceNotFound(
            str(error),
            where=where,
            cause="no such port, or not a serial one",
            next_step="ls /dev/tty*",
        ) from None
