"""The wires to a hand's controller: a socket or a serial port, written without waiting.

    unix:///PATH                  one datagram a line, to a socket file of its receiver
    serial:///dev/ttyX?baud=N     lines that end with a line feed; 115200 where no baud is given

A serial port carries few lines: 115200 baud about 60 a second. A line is left out while the one
before is still on its way, so that what arrives is never older than two lines. A line that was cut
off (a full buffer, a program that died) is ended by the next line feed: a reader skips it.

A serial port is set by the standard library (termios): raw, eight bits, no parity, no flow control.
Its modem lines stay as they are when it is closed, because some boards reset on them. What has been
written and has not left the machine yet can be counted and thrown away.
"""

from __future__ import annotations

import errno
import fcntl
import math
import os
import select
import socket
import struct
import termios
from contextlib import suppress
from threading import Thread

from holdfast.core.errors import AccessDenied, DeviceError, DeviceNotFound, UsageError
from holdfast.core.hand_lines import LineUrl, line_url

RATES = {
    int(name[1:]): value
    for name, value in vars(termios).items()
    if name[0] == "B" and name[1:].isdecimal() and int(name[1:]) >= 9600
}
"""Bits a second that this system's termios can set."""
CONTROL_FLAGS, LOCAL_FLAGS = 2, 3
"""Places in what tcgetattr returns."""


def open_port(path: str, baud: int) -> int:
    """A non-blocking descriptor of the port. Raises UsageError, OSError."""
    if baud not in RATES:
        raise UsageError(
            f"baud={baud} cannot be set here",
            next_step=f"one of {', '.join(map(str, sorted(RATES)))}",
        )

    # without waiting for a modem's carrier, and not as the terminal of this process
    port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _make_raw(port, RATES[baud])
    except (OSError, termios.error) as error:
        os.close(port)
        # termios has an error class of its own, which callers would have to know
        raise OSError(*error.args) from None

    return port


def opening_error(path: str, error: OSError) -> DeviceError:
    """What to tell a person whose port cannot be opened."""
    where = f"serial://{path}"
    what = error.strerror or str(error)
    if isinstance(error, PermissionError):
        return AccessDenied(
            what, where=where, next_step="join the group of the port (dialout)"
        )
    cause = "no such port, or not a serial one"
    return DeviceNotFound(what, where=where, cause=cause, next_step="ls /dev/tty*")


def _make_raw(port: int, speed: int) -> None:
    flags = termios.tcgetattr(port)
    raw_control = termios.CS8 | termios.CREAD | termios.CLOCAL
    # without input and output flags no byte is changed on its way, and without local ones
    # none is echoed or taken for Ctrl-C
    flags[0] = 0
    flags[1] = 0
    flags[LOCAL_FLAGS] = 0
    flags[CONTROL_FLAGS] = raw_control
    flags[4] = speed
    flags[5] = speed
    termios.tcsetattr(port, termios.TCSANOW, flags)


def unsent_bytes(port: int) -> int:
    """Bytes that were written and have not left the machine. Raises OSError."""
    answer = fcntl.ioctl(port, termios.TIOCOUTQ, b"\0" * 4)
    count: int = struct.unpack("i", answer)[0]
    return count


def forget_unsent(port: int) -> None:
    """Throw away what has been written and has not left the machine. Raises OSError."""
    try:
        termios.tcflush(port, termios.TCOFLUSH)
    except termios.error as error:
        raise OSError(*error.args) from None


DEFAULT_BAUD = 115200
MOST_UNSENT = 96
"""A serial port that still has more bytes to send gets no further line."""
BITS_A_COMMAND = 2100
"""About 210 bytes, ten bits each."""
LAST_LINE_MS = 200
"""The last line waits this long for room in a serial port."""
ADDRESSES = "unix:///run/hand/grip or serial:///dev/ttyUSB0?baud=115200"


class UnixLink:
    """A datagram socket to a receiver's socket file, which may come later, or anew.

    Who may write to the file may command its receiver: it should have permissions 0600.
    """

    is_serial = False
    reconnects = True
    most_hz = math.inf

    def __init__(self, path: str, name: str) -> None:
        self.name = name
        self._path = path
        self._sender: socket.socket | None = None

    @property
    def handle(self) -> int:
        """The socket's descriptor, -1 while there is no receiver."""
        return -1 if self._sender is None else self._sender.fileno()

    def connect(self) -> None:
        """Find the receiver. Raises OSError."""
        self.lose()
        sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        sender.setblocking(False)
        try:
            sender.connect(self._path)
        except OSError:
            sender.close()
            raise
        self._sender = sender

    def write(self, line: bytes) -> bool:
        """Send one datagram; False where the receiver's queue is full."""
        if self._sender is None:
            raise FileNotFoundError(errno.ENOENT, "there is no receiver")
        try:
            self._sender.send(line)
        except BlockingIOError:
            return False
        return True

    def reopen(self) -> bool:
        """Find the receiver again; whether it is there."""
        if self._sender is None:
            with suppress(OSError):
                self.connect()
        return self._sender is not None

    def lose(self) -> None:
        """Let go of a receiver that is gone; `reopen` looks for a new one."""
        if self._sender is not None:
            self._sender.close()
            self._sender = None

    def finish(self, line: bytes) -> None:
        """Send it, to a new receiver where the one before is gone."""
        if self._sender is not None:
            with suppress(ConnectionError):
                self._sender.send(line)
                return
        self.connect()
        self.write(line)

    def close(self) -> None:
        """Close the socket."""
        self.lose()


class SerialLink:
    """A serial port that may be unplugged and comes back."""

    is_serial = reconnects = True

    def __init__(self, path: str, baud: int, name: str) -> None:
        self.name = name
        self._path = path
        self._baud = baud
        self.handle = -1
        self._rest = b""
        self._opening: Thread | None = None

    @property
    def most_hz(self) -> float:
        """Commands a second."""
        return self._baud / BITS_A_COMMAND

    def open(self) -> None:
        """Open the port. Raises OSError, UsageError."""
        self.handle = open_port(self._path, self._baud)

    def write(self, line: bytes) -> bool:
        """Write one line; False while the one before is still on its way."""
        # two lines must never mix: the rest of the one before goes first
        if self._rest and not self._push():
            return False
        # a line behind many unsent bytes would arrive old: a newer one is sent later instead
        if unsent_bytes(self.handle) > MOST_UNSENT:
            return False
        # the part that the port does not take now is written before the next line
        self._rest = line + b"\n"
        return self._push() or self._begun(line)

    def reopen(self) -> bool:
        """Open the port again in a thread: a dying adapter can take seconds for it."""
        if self._opening is not None and self._opening.is_alive():
            return False

        if self.handle < 0:
            # a daemon: a port that never opens must not keep the program from ending
            self._opening = Thread(
                target=self._try_to_open, name="serial port", daemon=True
            )
            self._opening.start()
            return False

        return True

    def lose(self) -> None:
        """Close a port that failed; `reopen` opens it again."""
        self.close()
        # ends a line that was cut off, so that the reader skips it
        self._rest = b"\n"

    def finish(self, line: bytes) -> None:
        """Write it, after a line feed; throw away what waits where there is no room."""
        data = b"\n" + line + b"\n"
        # the last line is `hold`, which is worth more than a command before it
        if not self._has_room(0):
            with suppress(OSError):
                forget_unsent(self.handle)

        while data:
            # the run is over, so this wait delays no answer, and it must end
            if not self._has_room(LAST_LINE_MS):
                raise TimeoutError(110, "no room for the last line")
            taken = os.write(self.handle, data)
            data = data[taken:]

    def close(self) -> None:
        """Close the port."""
        if self.handle >= 0:
            handle = self.handle
            self.handle = -1
            with suppress(OSError):
                os.close(handle)

    def _try_to_open(self) -> None:
        with suppress(OSError):
            self.open()

    def _push(self) -> bool:
        """Write what is left of a line; whether all of it was taken."""
        try:
            taken = os.write(self.handle, self._rest)
        except BlockingIOError:
            return False
        self._rest = self._rest[taken:]
        return not self._rest

    def _begun(self, line: bytes) -> bool:
        """Whether a line was taken in part; its rest follows. A line not begun is left out."""
        # with its line feed the whole line is one byte longer, so at least one byte has left
        if len(self._rest) <= len(line):
            return True
        self._rest = b""
        return False

    def _has_room(self, wait_ms: int) -> bool:
        ready = select.poll()
        ready.register(self.handle, select.POLLOUT)
        return bool(ready.poll(wait_ms))


Link = UnixLink | SerialLink


def open_link(url: str, option: str) -> Link:
    """Open a URL's wire. option: its name on the command line.

    Raises UsageError, DeviceError.
    """
    try:
        where = line_url(url)
    except ValueError as error:
        raise _not_an_address(url, option, str(error)) from None

    scheme = where.parts.scheme
    if scheme == "serial":
        return _serial(where, option)
    if where.options:
        cause = f"{next(iter(where.options))[:40]!r} is no option of it"
        raise _not_an_address(where.url, option, cause)
    if scheme == "unix":
        return _unix(where, option)
    raise _not_an_address(where.url, option, "")


def _not_an_address(url: str, option: str, cause: str) -> UsageError:
    if url.startswith("udp://"):
        cause = "nothing that moves a hand crosses a network"
    return UsageError(
        f"{option} {url[:80]!r} is not an address", cause=cause, next_step=ADDRESSES
    )


def _unix(where: LineUrl, option: str) -> UnixLink:
    if where.parts.netloc or not where.path.strip("/"):
        raise _not_an_address(where.url, option, "a path from / on, as unix:///PATH")
    link = UnixLink(where.path, f"{option} {where.url}")
    # a receiver that starts later is found then; until then its absence is reported
    link.reopen()
    return link


def _serial(where: LineUrl, option: str) -> SerialLink:
    parts, url = where.parts, where.url
    baud = where.options.get("baud", str(DEFAULT_BAUD))
    # serial://dev/ttyX, with two slashes, would lose the first part of the path
    if set(where.options) - {"baud"} or parts.netloc or not parts.path.strip("/"):
        raise _not_an_address(url, option, "a path, and nothing but baud=")
    if not baud.isdecimal() or len(baud) > 9:
        raise _not_an_address(url, option, f"baud={baud[:40]!r} is not a whole number")

    link = SerialLink(parts.path, int(baud), f"{option} {url}")
    try:
        link.open()
    except OSError as error:
        raise opening_error(parts.path, error) from None

    return link
