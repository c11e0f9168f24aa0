"""Where lines come from: standard input, a serial port, a Unix socket. Nothing here waits for
longer than asked. The only import of pyserial is here, which the extra `serial` installs.
"""

from __future__ import annotations

import errno
import fcntl
import os
import select
import termios
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

from holdfast.core.errors import (
    AccessDenied,
    DeviceError,
    DeviceNotFound,
    UsageError,
    needs_extra,
)
from holdfast.core.hand_lines import LONGEST_LINE, MOST_A_CALL, unix_listener

CHUNK_BYTES = 64 << 10
DEFAULT_BAUD = 115200
RETRY_S = 0.2
"""Between two tries to open a port that has gone."""
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
    """Lines of a descriptor that another program writes to, such as standard input.

    ended: no line will ever come again. bytes_per_s: what a serial port carries at most.
    """

    bytes_per_s: float | None = None

    def __init__(self, name: str, handle: int) -> None:
        self.name = name
        self.ended = False
        self._handle = handle
        self._lines = LineSplitter()

    def pull(self, timeout_s: float) -> list[bytes]:
        """The lines that have come, oldest first, without their line ends.

        Waits at most so long for the first bytes.
        """
        if not select.select([self._handle], [], [], max(0.0, timeout_s))[0]:
            return []
        try:
            data = os.read(self._handle, CHUNK_BYTES)
        except BlockingIOError:
            # another reader of the same descriptor was faster
            return []
        except OSError:
            data = b""
        self.ended = not data
        return self._lines.split(data)

    @property
    def unfinished(self) -> int:
        """Bytes that have come of a line whose end has not."""
        return self._lines.unfinished

    def close(self) -> None:
        """Standard input belongs to the program."""


class SerialFeed:
    """Lines of a serial port. One that goes is reported, and opened again when it comes back.

    Raises LibraryMissing, UsageError, DeviceNotFound, AccessDenied.
    """

    ended = False

    def __init__(self, path: str, baud: int, report: Callable[[str], object]) -> None:
        self.name = f"serial://{path}"
        self._report = report
        self._open = partial(open_port, path, baud, reads=True)
        self._port: Any = self._open()
        self._try_s = 0.0
        self._lines = LineSplitter()
        self.bytes_per_s: float | None = baud / BITS_A_BYTE

    def pull(self, timeout_s: float) -> list[bytes]:
        """The lines that have come; waits at most so long for the first bytes."""
        wait_s = max(0.0, timeout_s)
        if self._port is None and not self._opens_again():
            time.sleep(min(wait_s, RETRY_S))
            return []
        if not select.select([self._port.fd], [], [], wait_s)[0]:
            return []
        return self._lines.split(self._read())

    @property
    def unfinished(self) -> int:
        """Bytes that have come of a line whose end has not."""
        return self._lines.unfinished

    def close(self) -> None:
        if self._port is not None:
            close_port(self._port)
            self._port = None

    def _read(self) -> bytes:
        try:
            data = os.read(self._port.fd, CHUNK_BYTES)
            # no bytes: another reader of the port took them, or it has gone
            if data or not _has_hung_up(self._port.fd):
                return data
            why = "hung up"
        except BlockingIOError:
            return b""
        except OSError as error:
            why = error.strerror or str(error)
        # closed at once: its adapter gets another name as long as a process holds the old one
        self.close()
        self._lines = LineSplitter()
        self._report(f"{self.name}: lost ({why}); likely cause: it was unplugged")
        return b""

    def _opens_again(self) -> bool:
        # opening takes milliseconds, which the loop has not got each time
        if time.monotonic() < self._try_s:
            return False
        self._try_s = time.monotonic() + RETRY_S
        # termios.error: it went again while it was opened
        with suppress(DeviceError, termios.error):
            self._port = self._open()
            self._report(f"{self.name}: back")
        return self._port is not None


def _has_hung_up(handle: int) -> bool:
    looks = select.poll()
    looks.register(handle, 0)
    return bool(looks.poll(0))


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


Feed = StreamFeed | SerialFeed | DatagramFeed
"""What a LineSource reads."""


def stdin_feed() -> StreamFeed:
    """What is piped into the program."""
    return StreamFeed("stdin", 0)


_ports: dict[str, list[tuple[Any, bool]]] = {}
"""Ports that this program has opened, by their true path; True: it reads."""


def open_port(path: str, baud: int = DEFAULT_BAUD, *, reads: bool = False) -> Any:
    """A `serial.Serial` that waits for nothing: raw, eight bits, no parity, no flow control.

    Its fileno() serves select, os.read and os.write. It is for this program alone, which may read
    it once and write to it: one board may send samples and obey commands. Close it by close_port.
    Raises LibraryMissing without pyserial, UsageError, DeviceNotFound, AccessDenied.
    """
    with needs_extra("serial"):
        import serial
    where = f"serial://{path}"
    device = os.path.realpath(path)
    ours = [(port, does) for port, does in _ports.get(device, []) if port.is_open]
    if reads and any(does for _, does in ours):
        raise UsageError(
            f"{where}: it is read already, and each line would come to one reader only",
            next_step="name another port for one of them",
        )
    try:
        for port, _ in ours:
            with suppress(OSError):
                fcntl.ioctl(port.fd, termios.TIOCNXCL)
        # a lock for programs that ask, and no further open for those that do not
        lock = None if ours else True
        port = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=lock)
        fcntl.ioctl(port.fd, termios.TIOCEXCL)
    except ValueError as error:
        raise UsageError(
            f"baud={baud} cannot be set here ({error})", next_step="baud=115200"
        ) from None
    except OSError as error:
        # pyserial raises an OSError of its own, with the number
        if error.errno in (errno.EBUSY, errno.EAGAIN):
            raise AccessDenied(
                "another program has opened it",
                where=where,
                next_step=f"end that program (fuser {path} names it)",
            ) from None
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
    _ports[device] = [*ours, (port, reads)]
    return port


def close_port(port: Any) -> None:
    """Close it, and let others open it."""
    # an unplugged one may fail in any of this
    with suppress(OSError, termios.error):
        fcntl.ioctl(port.fd, termios.TIOCNXCL)
    with suppress(OSError, termios.error):
        port.close()
