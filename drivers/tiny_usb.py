"""i2c-tiny-usb: one control transfer per I2C message and one for its status, whatever firmware is
in it.

Four firmwares answer a chip that is not there in four ways: zeros, what the transfer before left in
their buffer, no data, or a STALL. So the status is always read, and only the status says whether a
reply is one. The protocol has no way to free a bus, and none to see that it is stuck: some
firmwares then say that nobody acknowledges, and those that swing the pins themselves that everybody
does, once. Nor does harbaum's say that a written byte was not acknowledged.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from drivers.bus import NOT_ACKED, Reply, Transfer
from drivers.usb import Stalled, UsbPort
from edge_runtime.errors import BusStuck, TransferFailed, UsageError

TINY_USB_IDS = ((0x0403, 0xC631), (0x1C40, 0x0534))
VENDOR_OUT, VENDOR_IN = 0x41, 0xC1
"""Vendor requests to the interface: of the class type, wIndex (the I2C address) would be taken for
an interface."""
ECHO, SET_DELAY, GET_STATUS, I2C_IO = 0, 2, 3, 4
BEGIN, END = 1, 2
"""Added to I2C_IO: START before it, STOP after it."""
FLAG_READ = 1
STATUS_ACK, STATUS_NAK = 1, 2
TIMEOUT_MS = 100
"""64 bytes at 50 kHz take 12 ms, and on a low-speed USB as long again."""
MOST_BYTES = 64
"""Two of the four firmwares have no larger buffer."""
DELAY_US_100_KHZ = 10
ECHOED = 0xA55A


class TinyUsb:
    """An I2C bus behind an i2c-tiny-usb. number: of those on USB; delay_us: half a clock more or
    less, 10 is 100 kHz.

    A firmware may ignore the delay. Raises DeviceNotFound, AccessDenied, DeviceLost or
    TransferFailed.
    """

    name = "tiny-usb"

    def __init__(self, backend: Any, number: int = 0, delay_us: int = DELAY_US_100_KHZ) -> None:
        if not 0 < delay_us <= 0xFFFF:
            raise UsageError(
                f"{delay_us} us is no delay of the bus", next_step="1 .. 65535 us, 10 is 100 kHz"
            )
        self._delay_us = delay_us
        self._seen: dict[int, None] = {}
        self._unended: int | None = None
        self._port = UsbPort(self.name, TINY_USB_IDS, backend, number=number)
        try:
            self._begin()
        except BaseException:
            self._port.close()
            raise

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """One transfer after the other: two control transfers for each message (a write, a
        read)."""
        for transfer in transfers:
            _check(transfer)
        self._end()
        return [self._carry(transfer) for transfer in transfers]

    def clear(self) -> None:
        """Reset the bridge on USB and see whether a chip that has answered before does. Raises
        BusStuck."""
        self._port.reset()
        self._begin()
        if self._seen and not any(
            self._read(address, 1, BEGIN | END).acked for address in list(self._seen)
        ):
            raise BusStuck(
                "no chip answers after a reset of the bridge",
                where=self.name,
                cause="SDA is held low, or the sensors have no power",
                next_step="unplug it and plug it in",
            )

    def close(self) -> None:
        """Give the bridge back; twice does no harm."""
        self._port.close()

    def _begin(self) -> None:
        """See that it answers, and set the speed."""
        echo = self._port.control_in(VENDOR_IN, ECHO, ECHOED, 0, 2, TIMEOUT_MS)
        if echo != ECHOED.to_bytes(2, "little"):
            raise TransferFailed(
                f"{ECHOED:04x} came back as {echo.hex() or 'nothing'}", where=self.name
            )
        self._port.control_out(VENDOR_OUT, SET_DELAY, self._delay_us, 0, timeout_ms=TIMEOUT_MS)
        self._end()

    def _carry(self, transfer: Transfer) -> Reply:
        if not transfer.read:
            return self._write(transfer, BEGIN | END)
        if not transfer.write:
            return self._read(transfer.address, transfer.read, BEGIN | END)
        self._unended = transfer.address
        written = self._write(transfer, BEGIN)
        reply = self._read(transfer.address, transfer.read, END) if written.acked else written
        self._unended = None
        return reply

    def _end(self) -> None:
        """Bring out the STOP that a failure kept back: without it some firmwares make no START any
        more."""
        if self._unended is not None:
            self._read(self._unended, 1, END)
            self._unended = None

    def _write(self, transfer: Transfer, flags: int) -> Reply:
        """One message out. A STALL is a byte that was not acknowledged, even where the address
        was."""
        stalled = None
        try:
            self._port.control_out(
                VENDOR_OUT, I2C_IO | flags, 0, transfer.address, transfer.write, TIMEOUT_MS
            )
        except TransferFailed as error:
            stalled = error
        acked = self._acked(transfer.address, stalled)
        if stalled is not None and acked and not isinstance(stalled, Stalled):
            raise stalled
        return Reply(b"", acked=True) if acked and stalled is None else NOT_ACKED

    def _read(self, address: int, length: int, flags: int) -> Reply:
        """One message in; its data count only if the status says so."""
        data, failed = b"", None
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
            raise TransferFailed(f"{len(data)} of {length} bytes came in", where=self.name)
        return Reply(data, acked=True)

    def _acked(self, address: int, failed: TransferFailed | None) -> bool:
        """The status of the message before. failed: what that message met, which counts where there
        is no status."""
        try:
            status = self._port.control_in(VENDOR_IN, GET_STATUS, 0, 0, 1, TIMEOUT_MS)
        except TransferFailed as error:
            raise failed or error from None
        if status not in (bytes([STATUS_ACK]), bytes([STATUS_NAK])):
            raise failed or TransferFailed(
                f"{status.hex() or 'nothing'} is no status of a message", where=self.name
            )
        if status[0] == STATUS_ACK:
            self._seen[address] = None
        return status[0] == STATUS_ACK


def _check(transfer: Transfer) -> None:
    """Raises TransferFailed for more than the smallest firmware can carry."""
    longest = max(len(transfer.write), transfer.read)
    if longest > MOST_BYTES:
        raise TransferFailed(
            f"{longest} bytes in one transfer",
            where=TinyUsb.name,
            cause=f"its firmwares carry {MOST_BYTES} at most",
        )
