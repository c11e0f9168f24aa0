"""A serial port for one line at a time, by the standard library (termios), never waited for.

The port is raw, eight bits, no parity, no flow control; its modem lines stay as they are when it is
closed, because some boards reset on them. What has been written and has not left the machine yet
can be counted and thrown away.
"""

from __future__ import annotations

import fcntl
import os
import struct
import termios

from holdfast.edge_runtime.errors import AccessDenied, DeviceError, DeviceNotFound, UsageError

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
    port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _make_raw(port, RATES[baud])
    except (OSError, termios.error) as error:
        os.close(port)
        raise OSError(*error.args) from None
    return port


def opening_error(path: str, error: OSError) -> DeviceError:
    """What to tell a person whose port cannot be opened."""
    where, what = f"serial://{path}", error.strerror or str(error)
    if isinstance(error, PermissionError):
        return AccessDenied(what, where=where, next_step="join the group of the port (dialout)")
    cause = "no such port, or not a serial one"
    return DeviceNotFound(what, where=where, cause=cause, next_step="ls /dev/tty*")


def _make_raw(port: int, speed: int) -> None:
    flags = termios.tcgetattr(port)
    raw_control = termios.CS8 | termios.CREAD | termios.CLOCAL
    flags[0] = flags[1] = flags[LOCAL_FLAGS] = 0
    flags[CONTROL_FLAGS] = raw_control
    flags[4] = flags[5] = speed
    termios.tcsetattr(port, termios.TCSANOW, flags)


def unsent_bytes(port: int) -> int:
    """Bytes that were written and have not left the machine. Raises OSError."""
    count: int = struct.unpack("i", fcntl.ioctl(port, termios.TIOCOUTQ, b"\0" * 4))[0]
    return count


def forget_unsent(port: int) -> None:
    """Throw away what has been written and has not left the machine. Raises OSError."""
    try:
        termios.tcflush(port, termios.TCOFLUSH)
    except termios.error as error:
        raise OSError(*error.args) from None
