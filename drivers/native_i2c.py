"""The board's own I2C through /dev/i2c-N: one ioctl a transfer, since some controllers read only as
the last message.

The speed is the kernel's (on a Raspberry Pi dtparam=i2c_arm_baudrate=400000), and so are the
clocks: nothing here can free a bus that is held low.
"""

from __future__ import annotations

import errno
from collections.abc import Sequence

import smbus2

from drivers.bus import NOT_ACKED, Reply, Transfer
from edge_runtime.errors import (
    AccessDenied,
    BusStuck,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    TransferFailed,
)

NACK_ERRORS = (errno.ENXIO, errno.EREMOTEIO)
"""What controllers say of an address or a byte that nobody acknowledges."""
GONE_ERRORS = (errno.ENODEV, errno.ENOENT)
MOST_BYTES = 8192
"""Of one message, as i2c-dev has it."""


class NativeI2C:
    """The bus /dev/i2c-<bus_number>. Raises DeviceNotFound or AccessDenied where it cannot be
    opened."""

    def __init__(self, bus_number: int) -> None:
        self.name = f"i2c-{bus_number}"
        try:
            self._bus = smbus2.SMBus(bus_number)
        except OSError as error:
            raise self._unopened(error) from None

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """One ioctl for each transfer."""
        return [self._carry(transfer) for transfer in transfers]

    def clear(self) -> None:
        """Raises BusStuck: the kernel owns the clocks."""
        raise BusStuck(
            "cannot be freed from here",
            where=self.name,
            cause="the kernel owns the clocks",
            next_step="check the wiring and the pull-ups, then switch the sensors' power off and on",
        )

    def close(self) -> None:
        """Close the file; twice does no harm."""
        self._bus.close()

    def _carry(self, transfer: Transfer) -> Reply:
        longest = max(len(transfer.write), transfer.read)
        if longest > MOST_BYTES:
            raise TransferFailed(
                f"{longest} bytes in one transfer", where=self.name, cause=f"{MOST_BYTES} at most"
            )
        messages = _messages(transfer)
        try:
            self._bus.i2c_rdwr(*messages)
        except OSError as error:
            if error.errno in NACK_ERRORS:
                return NOT_ACKED
            raise self._failed(error) from None
        return Reply(bytes(messages[-1]) if transfer.read else b"", acked=True)

    def _unopened(self, error: OSError) -> DeviceError:
        if error.errno in (errno.EACCES, errno.EPERM):
            return AccessDenied(
                "not allowed to open it",
                where=self.name,
                cause="this user is not in the group i2c",
                next_step="holdfast doctor",
            )
        if error.errno in (*GONE_ERRORS, errno.ENXIO):
            return DeviceNotFound(
                f"no /dev/{self.name}",
                where=self.name,
                cause="another number, or I2C is not switched on",
                next_step="ls /dev/i2c-*",
            )
        return TransferFailed(f"cannot be opened: {error.strerror}", where=self.name)

    def _failed(self, error: OSError) -> DeviceError:
        """What a transfer met, other than a missing acknowledge."""
        if error.errno == errno.ETIMEDOUT:
            return BusStuck(
                "no transfer ends in time", where=self.name, cause="SDA or SCL is held low"
            )
        if error.errno in GONE_ERRORS:
            return DeviceLost("no longer there", where=self.name, cause="its adapter was unplugged")
        return TransferFailed(f"a transfer failed: {error.strerror}", where=self.name)


def _messages(transfer: Transfer) -> list[smbus2.i2c_msg]:
    """A write, a read, or both with START again between; a read is always the last."""
    messages = []
    if transfer.write or not transfer.read:
        messages.append(smbus2.i2c_msg.write(transfer.address, list(transfer.write)))
    if transfer.read:
        messages.append(smbus2.i2c_msg.read(transfer.address, transfer.read))
    return messages
