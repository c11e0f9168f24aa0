"""A fake /dev/i2c-N: smbus2 opens it and transfers messages, as it does with the kernel.

Only smbus2's SMBus is replaced, and only while the shim is installed; other buses are the system's.
It carries combined transfers (i2c_rdwr), which are all that the driver uses. Faults appear as the
kernel reports them: stall is EIO, short is EAGAIN (arbitration lost), late and a held bus are
ETIMEDOUT after the controller's second, unplug is ENODEV and then a missing file.
"""

from __future__ import annotations

import ctypes
import errno
import os
from types import TracebackType
from typing import Any

import smbus2

from holdfast.drivers.virtual.usb_backend import Traffic
from holdfast.drivers.virtual.virtual_hand import VirtualHand

FLAG_READ = 0x0001
BUS_HZ = 400_000
IOCTL_NS = 50_000
"""Interrupts, context switches and the controller's set-up."""
TIMEOUT_NS = 1_000_000_000


def _refused(number: int) -> OSError:
    """The kernel's error of this number."""
    return OSError(number, os.strerror(number))


class VirtualI2cDev:
    """The board's I2C in front of a virtual hand, within a `with` block.

    number: N of /dev/i2c-N. nack_errno: EREMOTEIO as on a Raspberry Pi, ENXIO on others. traffic:
    transfers are ioctls, bytes their payload.
    """

    def __init__(
        self,
        hand: VirtualHand,
        number: int = 1,
        *,
        nack_errno: int = errno.EREMOTEIO,
    ) -> None:
        self.hand = hand
        self.traffic = Traffic()
        self.open_files = 0
        self._number = number
        self._nack_errno = nack_errno
        self._replaced: Any = None

    def __enter__(self) -> VirtualI2cDev:
        """Replace smbus2's SMBus; several can be nested."""
        self._replaced = smbus2.SMBus
        vars(smbus2)["SMBus"] = self.open
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take it away again."""
        vars(smbus2)["SMBus"] = self._replaced

    def open(self, number: int) -> Any:
        """The opened file; a real one where the number belongs to another device."""
        if number != self._number:
            return self._replaced(number)
        if self.hand.unplugged():
            raise _refused(errno.ENOENT)
        return OpenedBus(self)

    # -- the controller

    def transfer(self, messages: tuple[Any, ...]) -> None:
        """smbus2's i2c_msg, START between and STOP after the last."""
        if any(message.flags & FLAG_READ for message in messages[:-1]):
            raise _refused(errno.EOPNOTSUPP)
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
        if self.hand.wire.held_low or self.hand.faults.lasts("late"):
            # the kernel waits for its controller before it gives up
            self.hand.clock.spend(TIMEOUT_NS)
            raise _refused(errno.ETIMEDOUT)
        if self.hand.faults.lasts("stall"):
            raise _refused(errno.EIO)
        if self.hand.faults.lasts("short"):
            raise _refused(errno.EAGAIN)


class OpenedBus:
    """What smbus2's SMBus is to the driver."""

    def __init__(self, device: VirtualI2cDev) -> None:
        self._device = device
        self._generation = device.hand.generation
        self._is_open = True
        device.open_files += 1

    def i2c_rdwr(self, *messages: Any) -> None:
        """Carry out the messages. Raises OSError, as the kernel does."""
        hand = self._device.hand
        if hand.unplugged() or hand.generation != self._generation:
            raise _refused(errno.ENODEV)
        self._device.transfer(messages)

    def close(self) -> None:
        """Close the file; a second call does no harm."""
        self._device.open_files -= self._is_open
        self._is_open = False
