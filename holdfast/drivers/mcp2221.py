"""MCP2221A: an I2C engine that remembers its failures, driven by HID reports one at a time.

A scan begins with a status request; one more follows every write and the first half of a
write-then-read. Three things need a cancel: a chip that did not acknowledge, a time-out, and an
engine that saw SDA move while it was idle ("confused": its next transfer would return wrong data).
An engine that was never used must not get a cancel. The reply to a cancel says nothing; the state
afterwards does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from holdfast.core.errors import BusStuck, TransferFailed
from holdfast.drivers.bus import ACKED, NOT_ACKED, Reply, Transfer, require_short
from holdfast.drivers.usb import UsbBridge, require_bus_hz

HID_INTERFACE = 2
OUT_ENDPOINT = 0x03
IN_ENDPOINT = 0x83
REPORT = 64
STATUS_SET = 0x10
GET_DATA = 0x40
WRITE = 0x90
READ = 0x91
READ_AGAIN = 0x93
WRITE_NO_STOP = 0x94
"""READ_AGAIN begins with a repeated START."""
CANCEL = 0x10
SET_SPEED = 0x20
SPEED_IS_SET = 0x20
STATE_AT, CONFUSED_AT, USED_AT, SCL_AT, SDA_AT = 8, 18, 21, 22, 23
"""Bytes of the reply to STATUS_SET; the data sheet does not name 18 and 21."""
CONFUSED = 8
IDLE = 0x00
NACK = 0x25
WRITTEN_NO_STOP = 0x45
DATA_READY = 0x55
WORKING = frozenset(
    bytes.fromhex("10 11 15 16 20 21 22 24 40 41 42 43 50 51 53 54 60 61")
)
"""States that end by themselves."""
MOST_BYTES = 60
TIMEOUT_MS = 50
"""Of a report; its reply comes within a few ms, however long the I2C transfer takes."""
SLOWEST_HZ = 47_000
FASTEST_HZ = 400_000
POLLS = 20
"""60 bytes at 47 kHz take 12 ms, a poll 2 to 3 ms."""
CANCELS = 3


@dataclass(frozen=True)
class Status:
    """What the engine reports of itself and of its pins."""

    state: int
    confused: bool
    used: bool
    scl: bool
    sda: bool

    @property
    def ready(self) -> bool:
        """Whether it can begin a transfer."""
        return self.state == IDLE and not self.confused and self.scl and self.sda


class Mcp2221(UsbBridge):
    """An I2C bus behind an MCP2221 or MCP2221A.

    number: which of them on USB. bus_hz: 47 to 400 kHz.

    Raises UsageError, DeviceNotFound, AccessDenied, DeviceLost, TransferFailed or BusStuck.
    """

    name = "mcp2221"
    ids = ((0x04D8, 0x00DD),)
    interface = HID_INTERFACE

    def __init__(self, backend: Any, *, number: int = 0, bus_hz: int = 400_000) -> None:
        require_bus_hz(self.name, bus_hz, SLOWEST_HZ, FASTEST_HZ)
        self._divider = round(12e6 / bus_hz) - 3
        self._doubtful = True
        super().__init__(backend, number)

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """One transfer after the other: two commands for a write, four for a write-then-read."""
        for transfer in transfers:
            require_short(self.name, transfer, MOST_BYTES)
        self._make_ready()
        return [self._carry(transfer) for transfer in transfers]

    def clear(self) -> None:
        """Cancel the engine's transfer. Raises BusStuck: it cannot clock a chip free."""
        self._synchronise()
        status = self._status()
        if status.used:
            self._cancel()
        elif not status.ready:
            raise self._not_ready(status)

    # -- transfers

    def _carry(self, transfer: Transfer) -> Reply:
        if transfer.read:
            return self._read(transfer)
        if transfer.write:
            return ACKED if self._write(WRITE, transfer, IDLE) else NOT_ACKED
        # the engine cannot write nothing
        present = self._read(Transfer(transfer.address, read=1))
        return ACKED if present.acked else NOT_ACKED

    def _write(self, command: int, transfer: Transfer, done: int) -> bool:
        """Whether the write was acknowledged. done: the state that it ends in."""
        self._start(command, len(transfer.write), transfer.address << 1, transfer.write)
        status = self._settled()
        if status.state not in (done, NACK):
            raise self._gave_up(status.state)
        # the engine keeps a failure until it is cancelled
        if status.state == NACK or status.confused:
            self._cancel()
        return status.state == done

    def _read(self, transfer: Transfer) -> Reply:
        """Write first, without STOP, if there is something to write.

        A read after a NACK would be wrong.
        """
        if transfer.write and not self._write(WRITE_NO_STOP, transfer, WRITTEN_NO_STOP):
            return NOT_ACKED
        self._start(
            READ_AGAIN if transfer.write else READ,
            transfer.read,
            transfer.address << 1 | 1,
        )
        for _ in range(POLLS):
            reply = self._ask(bytes([GET_DATA]))
            state = reply[2]
            count = reply[3]
            if state == DATA_READY and not reply[1]:
                return self._data(reply, count, transfer.read)
            if state == NACK:
                self._cancel()
                return NOT_ACKED
            # a time-out or a lost arbitration ends here; neither goes away by itself
            if state not in (*WORKING, WRITTEN_NO_STOP, DATA_READY):
                break

        raise self._gave_up(state)

    def _data(self, reply: bytes, count: int, wanted: int) -> Reply:
        # a short answer would be taken for a whole packet with a wrong CRC
        if count != wanted:
            self._cancel()
            raise TransferFailed(f"{count} of {wanted} bytes arrived", where=self.name)
        return Reply(reply[4 : 4 + count], acked=True)

    def _start(
        self, command: int, length: int, address: int, data: bytes = b""
    ) -> None:
        """Hand a transfer to the engine."""
        size = length.to_bytes(2, "little")
        reply = self._ask(bytes([command, *size, address]) + data)
        if reply[1]:
            raise self._gave_up(reply[2])

    def _gave_up(self, state: int) -> TransferFailed:
        """Cancel a transfer that failed, and return the error.

        Raises BusStuck where a line is low.
        """
        self._cancel()
        return TransferFailed(
            f"the transfer ended in state {state:#04x}",
            where=self.name,
            cause="noise, or a chip that holds a line",
        )

    # -- the engine

    def _begin(self) -> None:
        """Make the engine ready and set its speed."""
        self._make_ready()
        reply = self._ask(bytes([STATUS_SET, 0, 0, SET_SPEED, self._divider]))
        if reply[3] != SPEED_IS_SET:
            raise TransferFailed(
                "does not accept its bus speed",
                where=self.name,
                next_step="unplug it and plug it in",
            )

    def _make_ready(self) -> None:
        self._synchronise()
        status = self._settled()
        if status.ready:
            return
        # a cancel before the first transfer would hang this engine for good
        if not status.used:
            raise self._not_ready(status)
        self._cancel()

    def _settled(self) -> Status:
        """The status once it is no longer a passing one, or after the last poll."""
        for _ in range(POLLS):
            status = self._status()
            if status.state not in WORKING:
                break
        return status

    def _cancel(self) -> None:
        """Bring a used engine back to idle.

        Raises BusStuck (a line is low) or TransferFailed (it hangs).
        """
        # the reply to a cancel proves nothing; the state afterwards does
        for _ in range(CANCELS):
            self._ask(bytes([STATUS_SET, 0, CANCEL]))
            status = self._settled()
            if status.ready:
                return

        raise self._not_ready(status)

    def _not_ready(self, status: Status) -> BusStuck | TransferFailed:
        if not (status.scl and status.sda):
            return BusStuck(
                f"{'SDA' if status.scl else 'SCL'} is held low",
                where=self.name,
                cause="no pull-ups, or a chip is stuck in a byte and this bridge cannot free it",
                next_step="switch the sensors' power off and on",
            )

        return TransferFailed(
            f"its engine hangs in state {status.state:#04x}",
            where=self.name,
            cause="a cancel before its first transfer" if not status.used else "",
            next_step="unplug it and plug it in",
        )

    def _status(self) -> Status:
        reply = self._ask(bytes([STATUS_SET]))
        state = reply[STATE_AT]
        return Status(
            state=state,
            # after a write without STOP the same byte has another meaning
            confused=reply[CONFUSED_AT] == CONFUSED and state != WRITTEN_NO_STOP,
            used=bool(reply[USED_AT]),
            scl=bool(reply[SCL_AT]),
            sda=bool(reply[SDA_AT]),
        )

    # -- reports

    def _ask(self, command: bytes) -> bytes:
        """Send a report and read its reply.

        After a failure, the next reply may belong to an earlier report.
        """
        try:
            self._port.write(OUT_ENDPOINT, command.ljust(REPORT, b"\0"), TIMEOUT_MS)
            reply = self._port.read(IN_ENDPOINT, REPORT, TIMEOUT_MS)
            if len(reply) != REPORT:
                raise TransferFailed(f"a report of {len(reply)} bytes", where=self.name)
            if reply[0] != command[0]:
                raise TransferFailed(
                    f"reply {reply[0]:#04x} to {command[0]:#04x}", where=self.name
                )
        except TransferFailed:
            # the reply may still come, and must not answer the next command
            self._doubtful = True
            raise

        return reply

    def _synchronise(self) -> None:
        """After a failure, read away late replies; only their command tells them from new ones.

        A reply that comes even later does not match the next command, because the first two
        commands of a scan differ: that is a failure again.
        """
        if not self._doubtful:
            return
        for endpoint in (OUT_ENDPOINT, IN_ENDPOINT):
            self._port.clear_halt(endpoint)

        self._port.drain(IN_ENDPOINT, REPORT, empty=0)
        self._doubtful = False
