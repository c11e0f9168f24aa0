"""SMBus calls as plain I2C messages, made as in i2c_smbus_xfer_emulated (Linux 6.12).

Block reads and block process calls need a read whose length the chip sends; a controller of plain
I2C cannot do that.
"""

from __future__ import annotations

import errno
import os
from dataclasses import dataclass
from typing import Any

WRITE, READ = 0, 1
QUICK, BYTE, BYTE_DATA, WORD_DATA, PROC_CALL, BLOCK_DATA = range(6)
BLOCK_PROC_CALL, I2C_BLOCK_DATA = 7, 8
"""The size of a call (uapi/linux/i2c.h); 6 is an old name of 8."""
SIZES = (QUICK, BYTE, BYTE_DATA, WORD_DATA, PROC_CALL, BLOCK_DATA, BLOCK_PROC_CALL, I2C_BLOCK_DATA)
MOST_BYTES = 32


@dataclass(frozen=True)
class Message:
    """One address after a START: bytes to write, or how many to read (then data is empty)."""

    address: int
    data: bytes = b""
    read: int | None = None

    @property
    def length(self) -> int:
        """Bytes of its payload."""
        return len(self.data) if self.read is None else self.read


def refused(number: int) -> OSError:
    """The kernel's error of this number."""
    return OSError(number, os.strerror(number))


def messages(call: Any, address: int) -> list[Message]:
    """The messages of an i2c_smbus_ioctl_data to this address.

    Raises OSError: EINVAL, EOPNOTSUPP.
    """
    if call.size not in SIZES or call.read_write not in (READ, WRITE):
        raise refused(errno.EINVAL)
    reads = call.read_write == READ
    if call.size == BLOCK_PROC_CALL or (call.size == BLOCK_DATA and reads):
        raise refused(errno.EOPNOTSUPP)
    if call.size in (QUICK, BYTE):
        return [_short(call, address, reads)]
    command = bytes([call.command])
    if call.size == PROC_CALL:
        return [Message(address, command + _payload(call)), Message(address, read=2)]
    if reads:
        return [Message(address, command), Message(address, read=_wanted(call))]
    return [Message(address, command + _payload(call))]


def take(call: Any, data: bytes) -> None:
    """Put the bytes that were read into a call's data."""
    union = call.data.contents
    if call.size in (BYTE, BYTE_DATA) and call.read_write == READ:
        union.byte = data[0]
    elif call.size == PROC_CALL or (call.size == WORD_DATA and call.read_write == READ):
        union.word = int.from_bytes(data, "little")
    elif call.size == I2C_BLOCK_DATA and call.read_write == READ:
        union.block[0] = len(data)
        union.block[1 : len(data) + 1] = list(data)


def _short(call: Any, address: int, reads: bool) -> Message:
    """A call without a register: the address alone, or one byte."""
    if reads:
        return Message(address, read=int(call.size == BYTE))
    return Message(address, bytes([call.command]) if call.size == BYTE else b"")


def _wanted(call: Any) -> int:
    """How many bytes a read of a register returns."""
    if call.size == I2C_BLOCK_DATA:
        return _block_length(call)
    return 2 if call.size == WORD_DATA else 1


def _payload(call: Any) -> bytes:
    """The bytes that are written after the command."""
    union = call.data.contents
    if call.size == BYTE_DATA:
        return bytes([union.byte])
    if call.size in (WORD_DATA, PROC_CALL):
        return int(union.word).to_bytes(2, "little")
    length = _block_length(call)
    block = bytes(union.block[: length + 1])
    return block if call.size == BLOCK_DATA else block[1:]


def _block_length(call: Any) -> int:
    length = int(call.data.contents.block[0])
    if not 0 < length <= MOST_BYTES:
        raise refused(errno.EINVAL)
    return length
