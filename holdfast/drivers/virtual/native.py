"""A fake /dev/i2c-N: smbus2 opens it and sends it ioctls, as it does with the kernel.

Only what smbus2 itself calls is replaced, and only while the shim is installed; every other file is
the system's. Faults appear as the kernel reports them: stall is EIO, short is EAGAIN (arbitration
lost), late and a held bus are ETIMEDOUT after the controller's second, unplug is ENODEV and then a
missing file.

SMBus calls as plain I2C messages, made as in i2c_smbus_xfer_emulated (Linux 6.12).

Block reads and block process calls need a read whose length the chip sends; a controller of plain
I2C cannot do that.
"""

from __future__ import annotations

import ctypes
import errno
import itertools
import os
import sys
from dataclasses import dataclass
from types import TracebackType
from typing import Any

import holdfast.drivers.native_i2c  # noqa: F401  (it imports smbus2)
from holdfast.drivers.virtual.usb_backend import Traffic
from holdfast.drivers.virtual.virtual_hand import VirtualHand

WRITE, READ = 0, 1
QUICK, BYTE, BYTE_DATA, WORD_DATA, PROC_CALL, BLOCK_DATA = range(6)
BLOCK_PROC_CALL, I2C_BLOCK_DATA = 7, 8
"""The size of a call (uapi/linux/i2c.h); 6 is an old name of 8."""
SIZES = (
    QUICK,
    BYTE,
    BYTE_DATA,
    WORD_DATA,
    PROC_CALL,
    BLOCK_DATA,
    BLOCK_PROC_CALL,
    I2C_BLOCK_DATA,
)
MOST_BLOCK_BYTES = 32


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
    if not 0 < length <= MOST_BLOCK_BYTES:
        raise refused(errno.EINVAL)
    return length


I2C_SLAVE, I2C_FUNCS, I2C_SLAVE_FORCE, I2C_RDWR, I2C_SMBUS = (
    0x0703,
    0x0705,
    0x0706,
    0x0707,
    0x0720,
)
FLAG_READ = 0x0001
FUNCS = 0x0EFF0001
"""I2C_FUNC_I2C and what the kernel emulates with it, except packet error codes."""
LAST_ADDRESS = 0x7F
MOST_MESSAGES, MOST_BYTES = 42, 8192
BUS_HZ = 400_000
IOCTL_NS = 50_000
"""Interrupts, context switches and the controller's set-up."""
TIMEOUT_NS = 1_000_000_000
_NUMBERS = itertools.count(1_000_000)
"""Of files; no real one has such a number."""


class VirtualI2cDev:
    """The board's I2C in front of a virtual hand, within a `with` block.

    number: N of /dev/i2c-N. nack_errno: EREMOTEIO as on a Raspberry Pi, ENXIO on others. readable:
    by this user. traffic: transfers are ioctls, bytes their payload.
    """

    def __init__(
        self,
        hand: VirtualHand,
        number: int = 1,
        *,
        nack_errno: int = errno.EREMOTEIO,
        readable: bool = True,
    ) -> None:
        self.hand, self.traffic = hand, Traffic()
        self.readable = readable
        self._path, self._nack_errno = f"/dev/i2c-{number}", nack_errno
        self._born_ns = hand.clock.now_ns()
        self._opened: dict[int, int] = {}
        self._addresses: dict[int, int] = {}
        self._generation, self._gone = 0, False
        self._replaced: dict[str, Any] = {}

    def __enter__(self) -> VirtualI2cDev:
        """Replace what smbus2 calls; several can be nested."""
        module = vars(sys.modules["smbus2.smbus2"])
        self._replaced = {name: module[name] for name in ("os", "ioctl")}
        module["os"] = _Os(self, self._replaced["os"])
        module["ioctl"] = self._ioctl
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take it away again."""
        vars(sys.modules["smbus2.smbus2"]).update(self._replaced)

    # -- what smbus2 calls

    @property
    def open_files(self) -> int:
        """How many have not been closed."""
        return len(self._opened)

    def open(self, path: str, flags: int) -> int | None:
        """A file number, or None where the path belongs to another device."""
        if path != self._path:
            return None
        if self._unplugged():
            raise refused(errno.ENOENT)
        if not self.readable:
            raise refused(errno.EACCES)
        fd = next(_NUMBERS)
        self._opened[fd] = self._generation
        return fd

    def close(self, fd: int) -> bool:
        """Whether it was one of ours."""
        self._addresses.pop(fd, None)
        return self._opened.pop(fd, None) is not None

    def _ioctl(self, fd: int, request: int, argument: Any = 0) -> Any:
        if fd not in self._opened:
            return self._replaced["ioctl"](fd, request, argument)
        if self._unplugged() or self._opened[fd] != self._generation:
            raise refused(errno.ENODEV)
        if request == I2C_FUNCS:
            argument.value = FUNCS
            return 0
        if request in (I2C_SLAVE, I2C_SLAVE_FORCE):
            return self._choose(fd, argument)
        if request == I2C_SMBUS:
            return self._smbus(argument, self._addresses.get(fd, 0))
        if request != I2C_RDWR:
            raise refused(errno.ENOTTY)
        return self._combined([argument.msgs[k] for k in range(argument.nmsgs)])

    def _choose(self, fd: int, address: int) -> int:
        """The chip that this file's SMBus calls go to."""
        if not 0 <= address <= LAST_ADDRESS:
            raise refused(errno.EINVAL)
        self._addresses[fd] = address
        return 0

    def _smbus(self, call: Any, address: int) -> int:
        brought = self._transfer(messages(call, address))
        take(call, brought[-1])
        return 0

    def _combined(self, requests: list[Any]) -> int:
        """I2C_RDWR: how many messages there were, as the kernel returns."""
        brought = self._transfer([_message(one) for one in requests])
        for message, data in zip(requests, brought, strict=True):
            if message.flags & FLAG_READ:
                ctypes.memmove(message.buf, data, len(data))
        return len(requests)

    # -- the controller

    def _transfer(self, messages: list[Message]) -> list[bytes]:
        """Messages with START between and STOP after the last; what each has read."""
        self._check(messages)
        self.traffic.transfers += 1
        self.hand.clock.spend(IOCTL_NS)
        self._suffer()
        bits = self.hand.wire.bits
        try:
            return [self._carry(message) for message in messages]
        finally:
            self.hand.wire.stop()
            self.hand.clock.spend(round(1e9 * (self.hand.wire.bits - bits) / BUS_HZ))

    def _check(self, messages: list[Message]) -> None:
        if not 0 < len(messages) <= MOST_MESSAGES or any(
            message.length > MOST_BYTES for message in messages
        ):
            raise refused(errno.EINVAL)
        if any(message.read is not None for message in messages[:-1]):
            raise refused(errno.EOPNOTSUPP)

    def _carry(self, message: Message) -> bytes:
        wire, reads = self.hand.wire, message.read is not None
        wire.start()
        if not wire.write(message.address << 1 | reads):
            raise refused(self._nack_errno)
        data = bytes(wire.read() for _ in range(message.read or 0))
        if not all(wire.write(byte) for byte in message.data):
            raise refused(self._nack_errno)
        self.traffic.bytes_in += len(data)
        self.traffic.bytes_out += len(message.data)
        return data

    # -- faults

    def _suffer(self) -> None:
        self.hand.suffer()
        if self.hand.wire.held_low or self._lasts("late"):
            self.hand.clock.spend(TIMEOUT_NS)
            raise refused(errno.ETIMEDOUT)
        if self._lasts("stall"):
            raise refused(errno.EIO)
        if self._lasts("short"):
            raise refused(errno.EAGAIN)

    def _unplugged(self) -> bool:
        gone = self._lasts("unplug")
        if gone and not self._gone:
            self._generation += 1
            self.hand.power_off()
        self._gone = gone
        return gone

    def _lasts(self, kind: str) -> bool:
        return self.hand.faults.lasts(
            kind, 1e-9 * (self.hand.clock.now_ns() - self._born_ns)
        )


class _Os:
    """The os module that smbus2 sees: the real one, with one more file."""

    def __init__(self, device: VirtualI2cDev, real: Any) -> None:
        self._device, self._real = device, real

    def open(self, path: str, flags: int) -> Any:
        fd = self._device.open(path, flags)
        return self._real.open(path, flags) if fd is None else fd

    def close(self, fd: int) -> None:
        if not self._device.close(fd):
            self._real.close(fd)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


def _message(request: Any) -> Message:
    """An i2c_msg of smbus2's."""
    if request.flags & FLAG_READ:
        return Message(request.addr, read=request.len)
    return Message(request.addr, ctypes.string_at(request.buf, request.len))
