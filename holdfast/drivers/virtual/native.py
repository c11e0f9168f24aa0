"""A fake /dev/i2c-N: smbus2 opens it and sends it ioctls, as it does with the kernel.

Only what smbus2 itself calls is replaced, and only while the shim is installed; every other file is
the system's. It carries combined transfers (I2C_RDWR), which are all that the driver uses. Faults
appear as the kernel reports them: stall is EIO, short is EAGAIN (arbitration lost), late and a held
bus are ETIMEDOUT after the controller's second, unplug is ENODEV and then a missing file.
"""

from __future__ import annotations

import ctypes
import errno
import itertools
import os
import sys
from types import TracebackType
from typing import Any

import holdfast.drivers.native_i2c  # noqa: F401  (it imports smbus2)
from holdfast.drivers.virtual.usb_backend import Traffic
from holdfast.drivers.virtual.virtual_hand import VirtualHand

I2C_FUNCS = 0x0705
I2C_RDWR = 0x0707
FLAG_READ = 0x0001
FUNCS = 0x00000001
"""I2C_FUNC_I2C."""
MOST_MESSAGES = 42
MOST_BYTES = 8192
BUS_HZ = 400_000
IOCTL_NS = 50_000
"""Interrupts, context switches and the controller's set-up."""
TIMEOUT_NS = 1_000_000_000
_NUMBERS = itertools.count(1_000_000)
"""Of files; no real one has such a number."""


def _refused(number: int) -> OSError:
    """The kernel's error of this number."""
    return OSError(number, os.strerror(number))


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
        self.hand = hand
        self.traffic = Traffic()
        self.readable = readable
        self._path = f"/dev/i2c-{number}"
        self._nack_errno = nack_errno
        self._born_ns = hand.clock.now_ns()
        self._opened: dict[int, int] = {}
        self._generation = 0
        self._gone = False
        self._replaced: dict[str, Any] = {}

    def __enter__(self) -> VirtualI2cDev:
        """Replace what smbus2 calls; several can be nested."""
        module = vars(sys.modules["smbus2.smbus2"])
        self._replaced = {name: module[name] for name in ("os", "ioctl")}
        # smbus2 alone sees these; the process keeps its own os
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
            raise _refused(errno.ENOENT)
        if not self.readable:
            raise _refused(errno.EACCES)
        fd = next(_NUMBERS)
        self._opened[fd] = self._generation
        return fd

    def close(self, fd: int) -> bool:
        """Whether it was one of ours."""
        return self._opened.pop(fd, None) is not None

    def _ioctl(self, fd: int, request: int, argument: Any) -> Any:
        if fd not in self._opened:
            return self._replaced["ioctl"](fd, request, argument)
        if self._unplugged() or self._opened[fd] != self._generation:
            raise _refused(errno.ENODEV)
        if request == I2C_FUNCS:
            argument.value = FUNCS
            return 0
        if request != I2C_RDWR:
            raise _refused(errno.ENOTTY)
        return self._transfer([argument.msgs[k] for k in range(argument.nmsgs)])

    # -- the controller

    def _transfer(self, messages: list[Any]) -> int:
        """smbus2's i2c_msg , START between and STOP after the last; returns their number."""
        self._check(messages)
        self.traffic.transfers += 1
        self.hand.clock.spend(IOCTL_NS)
        self._suffer()
        bits = self.hand.wire.bits
        try:
            for message in messages:
                self._carry(message)
        finally:
            self.hand.wire.stop()
            self.hand.clock.spend(round(1e9 * (self.hand.wire.bits - bits) / BUS_HZ))

        return len(messages)

    def _check(self, messages: list[Any]) -> None:
        too_long = any(message.len > MOST_BYTES for message in messages)
        if too_long or not 0 < len(messages) <= MOST_MESSAGES:
            raise _refused(errno.EINVAL)
        if any(message.flags & FLAG_READ for message in messages[:-1]):
            raise _refused(errno.EOPNOTSUPP)

    def _carry(self, message: Any) -> None:
        wire = self.hand.wire
        reads = bool(message.flags & FLAG_READ)
        wire.start()
        if not wire.write(message.addr << 1 | reads):
            raise _refused(self._nack_errno)
        if reads:
            data = bytes(wire.read() for _ in range(message.len))
            ctypes.memmove(message.buf, data, len(data))
            self.traffic.bytes_in += len(data)
            return
        for byte in ctypes.string_at(message.buf, message.len):
            if not wire.write(byte):
                raise _refused(self._nack_errno)

        self.traffic.bytes_out += message.len

    # -- faults

    def _suffer(self) -> None:
        self.hand.suffer()
        if self.hand.wire.held_low or self._lasts("late"):
            # the kernel waits for its controller before it gives up
            self.hand.clock.spend(TIMEOUT_NS)
            raise _refused(errno.ETIMEDOUT)
        if self._lasts("stall"):
            raise _refused(errno.EIO)
        if self._lasts("short"):
            raise _refused(errno.EAGAIN)

    def _unplugged(self) -> bool:
        gone = self._lasts("unplug")
        if gone and not self._gone:
            self._generation += 1
            self.hand.power_off()
        self._gone = gone
        return gone

    def _lasts(self, kind: str) -> bool:
        now_s = 1e-9 * (self.hand.clock.now_ns() - self._born_ns)
        return self.hand.faults.lasts(kind, now_s)


class _Os:
    """The os module that smbus2 sees: the real one, with one more file."""

    def __init__(self, device: VirtualI2cDev, real: Any) -> None:
        self._device = device
        self._real = real

    def open(self, path: str, flags: int) -> Any:
        fd = self._device.open(path, flags)
        return self._real.open(path, flags) if fd is None else fd

    def close(self, fd: int) -> None:
        if not self._device.close(fd):
            self._real.close(fd)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)
