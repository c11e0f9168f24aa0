"""A serial port: the only import of pyserial, which the extra `serial` installs."""

from __future__ import annotations

import errno
from typing import Any

from holdfast.core.errors import (
    AccessDenied,
    DeviceError,
    DeviceNotFound,
    UsageError,
    needs_extra,
)

DEFAULT_BAUD = 115200


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
        raise _named(path, error) from None


def _named(path: str, error: OSError) -> DeviceError:
    where = f"serial://{path}"
    what = str(error)
    # pyserial raises an OSError of its own, with the number
    if error.errno == errno.EACCES:
        return AccessDenied(
            what, where=where, next_step="join the group of the port (dialout)"
        )
    cause = "no such port, or not a serial one"
    return DeviceNotFound(what, where=where, cause=cause, next_step="ls /dev/tty*")
