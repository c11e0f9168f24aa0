"""i2c-tiny-usb: one control transfer for each I2C message, one for its status, any firmware.

Four firmwares answer for an absent chip in four ways: zeros, the data of the transfer before, no
data, or a STALL. So the driver always reads the status, and only the status says whether a reply
counts. The protocol cannot free a bus or detect that it is stuck. With a stuck bus, some firmwares
report that no chip acknowledges; those that drive the pins in software report one acknowledge. Till
Harbaum's firmware does not report a written byte that was not acknowledged.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from holdfast.core.errors import BusStuck, TransferFailed
from holdfast.drivers.bus import ACKED, NOT_ACKED, Reply, Transfer, require_short
from holdfast.drivers.usb import Stalled, UsbBridge

VENDOR_OUT = 0x41
VENDOR_IN = 0xC1
"""Vendor requests to the interface.

In a class request, wIndex (the I2C address) would name an interface.
"""
ECHO = 0
SET_DELAY = 2
GET_STATUS = 3
I2C_IO = 4
BEGIN = 1
END = 2
"""Added to I2C_IO: START before the message, STOP after it."""
FLAG_READ = 1
STATUS_ACK = 1
STATUS_NAK = 2
TIMEOUT_MS = 100
"""64 bytes take 12 ms at 50 kHz, and as long again on low-speed USB."""
MOST_BYTES = 64
"""Two of the four firmwares have no larger buffer."""
DELAY_US = 10
"""About half a clock: 100 kHz. A firmware may ignore it."""
ECHOED = 0xA55A


class TinyUsb(UsbBridge):
    """An I2C bus behind an i2c-tiny-usb. number: which of them on USB.

    bus_hz: ignored, its firmware decides. Raises DeviceNotFound, AccessDenied, DeviceLost or
    TransferFailed.
    """

    name = "tiny-usb"
    ids = ((0x0403, 0xC631), (0x1C40, 0x0534))

    def __init__(self, backend: Any, *, number: int = 0, bus_hz: int = 0) -> None:
        # chips that answered before: a bus that is held low cannot be asked directly
        self._seen: dict[int, None] = {}
        self._unended: int | None = None
        super().__init__(backend, number)

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """One after the other, two control transfers for each message (a write or a read)."""
        for transfer in transfers:
            require_short(self.name, transfer, MOST_BYTES)
        self._end()
        return [self._carry(transfer) for transfer in transfers]

    def clear(self) -> None:
        """Reset the bridge on USB.

        Raises BusStuck where no chip that answered before answers now.
        """
        self._port.reset()
        self._begin()
        seen = list(self._seen)
        if seen and not any(self._read(one, 1, BEGIN | END).acked for one in seen):
            raise BusStuck(
                "no chip answers after a reset of the bridge",
                where=self.name,
                cause="SDA is held low, or the sensors have no power",
                next_step="unplug it and plug it in",
            )

    def _begin(self) -> None:
        """See that the bridge answers, and set the speed."""
        echo = self._port.control_in(VENDOR_IN, ECHO, ECHOED, 0, 2, TIMEOUT_MS)
        # another device may have the same ids
        if echo != ECHOED.to_bytes(2, "little"):
            raise TransferFailed(
                f"the echo of {ECHOED:04x} is {echo.hex() or 'empty'}", where=self.name
            )
        self._port.control_out(
            VENDOR_OUT, SET_DELAY, DELAY_US, 0, timeout_ms=TIMEOUT_MS
        )
        self._end()

    def _carry(self, transfer: Transfer) -> Reply:
        if not transfer.read:
            return self._write(transfer, BEGIN | END)
        if not transfer.write:
            return self._read(transfer.address, transfer.read, BEGIN | END)
        # noted before the write, because a failure leaves the bus without a STOP
        self._unended = transfer.address
        reply = self._write(transfer, BEGIN)
        if reply.acked:
            reply = self._read(transfer.address, transfer.read, END)
        self._unended = None
        return reply

    def _end(self) -> None:
        """Send the STOP that a failure left out.

        Without it some firmwares make no START any more.
        """
        if self._unended is not None:
            self._read(self._unended, 1, END)
            self._unended = None

    def _write(self, transfer: Transfer, flags: int) -> Reply:
        """Send one message.

        A STALL means that a byte was not acknowledged, even if the address was.
        """
        stalled = None
        try:
            self._port.control_out(
                VENDOR_OUT,
                I2C_IO | flags,
                0,
                transfer.address,
                transfer.write,
                TIMEOUT_MS,
            )
        except TransferFailed as error:
            stalled = error

        acked = self._acked(transfer.address, stalled)
        # a time-out proves nothing about the byte, so it stays an error
        if stalled is not None and acked and not isinstance(stalled, Stalled):
            raise stalled
        return ACKED if acked and stalled is None else NOT_ACKED

    def _read(self, address: int, length: int, flags: int) -> Reply:
        """Read one message; its data count only if the status says so."""
        data = b""
        failed = None
        try:
            data = self._port.control_in(
                VENDOR_IN, I2C_IO | flags, FLAG_READ, address, length, TIMEOUT_MS
            )
        except TransferFailed as error:
            failed = error

        if not self._acked(address, failed):
            return NOT_ACKED
        if failed is not None:
            raise failed
        if len(data) != length:
            raise TransferFailed(
                f"{len(data)} of {length} bytes arrived", where=self.name
            )
        return Reply(data, acked=True)

    def _acked(self, address: int, failed: TransferFailed | None) -> bool:
        """Whether the last message was acknowledged. failed: its error, raised without a status."""
        try:
            status = self._port.control_in(VENDOR_IN, GET_STATUS, 0, 0, 1, TIMEOUT_MS)
        except TransferFailed as error:
            raise failed or error from None

        if status not in (bytes([STATUS_ACK]), bytes([STATUS_NAK])):
            raise failed or TransferFailed(
                f"the status is {status.hex() or 'empty'}, not 01 or 02",
                where=self.name,
            )
        # a dict keeps the order in which the chips answered first
        if status[0] == STATUS_ACK:
            self._seen[address] = None
        return status[0] == STATUS_ACK
