"""The board's own I2C through /dev/i2c-N: one ioctl for each transfer.

Some controllers can read only in the last message of an ioctl. The kernel sets the speed (on a
Raspberry Pi: dtparam=i2c_arm_baudrate=400000) and drives the clock, so this driver cannot free a
bus that is held low.
"""

from __future__ import annotations

import errno
from collections.abc import Sequence

import smbus2

from holdfast.core.errors import (
    AccessDenied,
    BusStuck,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    TransferFailed,
)
from holdfast.drivers.bus import NOT_ACKED, Reply, Transfer

NACK_ERRORS = (errno.ENXIO, errno.EREMOTEIO)
"""The errors with which controllers report a missing acknowledge."""
GONE_ERRORS = (errno.ENODEV, errno.ENOENT)


class NativeI2C:
    """The bus /dev/i2c-<bus_number>.

    Raises DeviceNotFound or AccessDenied if it cannot be opened.
    """

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
        """Raises BusStuck: the kernel drives the clock."""
        raise BusStuck(
            "a chip holds the bus low, and this driver cannot free it",
            where=self.name,
            cause="the kernel drives the clock line",
            next_step="check wires and pull-ups, then switch the sensors' power off and on",
        )

    def close(self) -> None:
        """Close the file; a second call does no harm."""
        self._bus.close()

    def _carry(self, transfer: Transfer) -> Reply:
        """A write, a read, or both with a repeated START between; the read is the last message."""
        address = transfer.address
        messages = []
        if transfer.write or not transfer.read:
            messages.append(smbus2.i2c_msg.write(address, list(transfer.write)))
        if transfer.read:
            messages.append(smbus2.i2c_msg.read(address, transfer.read))
        try:
            self._bus.i2c_rdwr(*messages)
        except OSError as error:
            # an absent chip is a reply, and the other transfers go on
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
                next_step="holdfast doctor shows how to add it",
            )

        if error.errno in (*GONE_ERRORS, errno.ENXIO):
            return DeviceNotFound(
                f"no /dev/{self.name}",
                where=self.name,
                cause="the bus has another number, or I2C is not enabled",
                next_step="ls /dev/i2c-* lists the buses",
            )

        return TransferFailed(f"cannot be opened: {error.strerror}", where=self.name)

    def _failed(self, error: OSError) -> DeviceError:
        """The error of a transfer, other than a missing acknowledge."""
        if error.errno == errno.ETIMEDOUT:
            return BusStuck(
                "transfers do not end in time",
                where=self.name,
                cause="SDA or SCL is held low",
            )
        if error.errno in GONE_ERRORS:
            return DeviceLost(
                "no longer there", where=self.name, cause="its adapter was unplugged"
            )
        return TransferFailed(f"a transfer failed: {error.strerror}", where=self.name)
