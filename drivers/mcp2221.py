"""MCP2221A: an I2C engine with a memory for grudges, asked by HID reports, one command at a time.

A scan begins with a look at the engine; every write, and the first half of a write-then-read, is
followed by one. A chip that did not acknowledge, a time-out, and an engine that saw SDA move while
it was idle ("confused": its next transfer would be bogus) all need a cancel, and an engine that was
never used must not be given one. The reply to a cancel says nothing; the state afterwards does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from drivers.bus import NOT_ACKED, Reply, Transfer
from drivers.usb import UsbPort, named_errors
from edge_runtime.errors import BusStuck, TransferFailed, UsageError

MCP2221_IDS = ((0x04D8, 0x00DD),)
HID_INTERFACE, OUT_ENDPOINT, IN_ENDPOINT, REPORT = 2, 0x03, 0x83, 64
STATUS_SET, GET_DATA = 0x10, 0x40
WRITE, READ, READ_AGAIN, WRITE_NO_STOP = 0x90, 0x91, 0x93, 0x94
"""READ_AGAIN: after START again."""
CANCEL, SET_SPEED, SPEED_IS_SET = 0x10, 0x20, 0x20
STATE_AT, CONFUSED_AT, USED_AT, SCL_AT, SDA_AT = 8, 18, 21, 22, 23
"""Bytes of the reply to STATUS_SET; 18 and 21 are in no data sheet."""
CONFUSED = 8
IDLE, NACK, WRITTEN_NO_STOP, DATA_READY = 0x00, 0x25, 0x45, 0x55
WORKING = frozenset(
    {
        0x10,
        0x11,
        0x15,
        0x16,
        0x20,
        0x21,
        0x22,
        0x24,
        0x40,
        0x41,
        0x42,
        0x43,
        0x50,
        0x51,
        0x53,
        0x54,
        0x60,
        0x61,
    }
)
"""States that pass by themselves."""
MOST_BYTES = 60
TIMEOUT_MS = 50
"""Of a report; its reply comes within a few ms, whatever the I2C bus does."""
SLOWEST_HZ, FASTEST_HZ = 47_000, 400_000
POLLS = 20
"""60 bytes at 47 kHz take 12 ms, a poll 2 to 3 ms."""
CANCELS = 3


@dataclass(frozen=True)
class Status:
    """What the engine says of itself and of its pins."""

    state: int
    confused: bool
    used: bool
    scl: bool
    sda: bool

    @property
    def ready(self) -> bool:
        """For a transfer."""
        return self.state == IDLE and not self.confused and self.scl and self.sda


class Mcp2221:
    """An I2C bus behind an MCP2221 or MCP2221A. number: of those on USB; bus_hz: 47 .. 400 kHz.

    Raises DeviceNotFound, AccessDenied, DeviceLost, TransferFailed or BusStuck.
    """

    name = "mcp2221"

    def __init__(self, backend: Any, number: int = 0, bus_hz: int = 400_000) -> None:
        if not SLOWEST_HZ <= bus_hz <= FASTEST_HZ:
            raise UsageError(
                f"{bus_hz} Hz is no speed of the bus", next_step=f"{SLOWEST_HZ} .. {FASTEST_HZ} Hz"
            )
        self._divider = round(12e6 / bus_hz) - 3
        self._doubtful = True
        self._port = UsbPort(
            self.name, MCP2221_IDS, backend, interface=HID_INTERFACE, number=number
        )
        try:
            self._begin()
        except BaseException:
            self._port.close()
            raise

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """One transfer after the other: two commands for a write, four for a write-then-read, and
        one before all."""
        for transfer in transfers:
            _check(transfer)
        self._make_ready()
        return [self._carry(transfer) for transfer in transfers]

    def clear(self) -> None:
        """Cancel what the engine is at. Raises BusStuck: it cannot clock a chip free."""
        self._synchronise()
        status = self._status()
        if status.used:
            self._cancel()
        elif not status.ready:
            raise self._not_ready(status)

    def close(self) -> None:
        """Give the bridge back; twice does no harm."""
        self._port.close()

    # -- transfers

    def _carry(self, transfer: Transfer) -> Reply:
        if transfer.read:
            return self._read(transfer)
        if transfer.write:
            return Reply(b"", acked=True) if self._write(WRITE, transfer, IDLE) else NOT_ACKED
        # a write of nothing is not to be had
        present = self._read(Transfer(transfer.address, read=1))
        return Reply(b"", present.acked)

    def _write(self, command: int, transfer: Transfer, done: int) -> bool:
        """Whether it was acknowledged. done: the state it ends in."""
        self._start(command, len(transfer.write), transfer.address << 1, transfer.write)
        status = self._settled()
        if status.state not in (done, NACK):
            raise self._gave_up(status.state)
        if status.state == NACK or status.confused:
            self._cancel()
        return status.state == done

    def _read(self, transfer: Transfer) -> Reply:
        """A write without STOP first, if there is one: what reads on from a NACK would read
        something else."""
        if transfer.write and not self._write(WRITE_NO_STOP, transfer, WRITTEN_NO_STOP):
            return NOT_ACKED
        self._start(
            READ_AGAIN if transfer.write else READ, transfer.read, transfer.address << 1 | 1
        )
        for _ in range(POLLS):
            reply = self._ask(bytes([GET_DATA]))
            state, count = reply[2], reply[3]
            if state == DATA_READY and reply[1] == 0:
                return self._data(reply, count, transfer.read)
            if state == NACK:
                self._cancel()
                return NOT_ACKED
            if state not in (*WORKING, WRITTEN_NO_STOP, DATA_READY):
                break
        raise self._gave_up(state)

    def _data(self, reply: bytes, count: int, wanted: int) -> Reply:
        if count != wanted:
            self._cancel()
            raise TransferFailed(f"{count} of {wanted} bytes came in", where=self.name)
        return Reply(reply[4 : 4 + count], acked=True)

    def _start(self, command: int, length: int, address: int, data: bytes = b"") -> None:
        """Hand a transfer to the engine."""
        reply = self._ask(bytes([command, length & 0xFF, length >> 8, address]) + data)
        if reply[1] != 0:
            raise self._gave_up(reply[2])

    def _gave_up(self, state: int) -> TransferFailed:
        """Cancel a transfer that does not end well; the error to raise. Raises BusStuck where a
        line is low."""
        self._cancel()
        return TransferFailed(
            f"the transfer ended in state {state:#04x}",
            where=self.name,
            cause="noise, or a chip that holds a line",
        )

    # -- the engine

    def _begin(self) -> None:
        """Make it ready and set the speed."""
        self._make_ready()
        if self._ask(bytes([STATUS_SET, 0, 0, SET_SPEED, self._divider]))[3] != SPEED_IS_SET:
            raise TransferFailed(
                "does not take its speed", where=self.name, next_step="unplug it and plug it in"
            )

    def _make_ready(self) -> None:
        self._synchronise()
        status = self._settled()
        if status.ready:
            return
        if not status.used:
            raise self._not_ready(status)
        self._cancel()

    def _settled(self) -> Status:
        """The status once it is no longer one that passes by itself, or the last that was asked
        for."""
        for _ in range(POLLS):
            status = self._status()
            if status.state not in WORKING:
                break
        return status

    def _cancel(self) -> None:
        """Bring a used engine back to idle. Raises BusStuck where a line stays low, TransferFailed
        where it hangs."""
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
                cause="a chip cut off in the middle of a byte, which this bridge cannot clock free, or no pull-ups",
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
            confused=reply[CONFUSED_AT] == CONFUSED and state != WRITTEN_NO_STOP,
            used=reply[USED_AT] != 0,
            scl=reply[SCL_AT] != 0,
            sda=reply[SDA_AT] != 0,
        )

    # -- reports

    def _ask(self, command: bytes) -> bytes:
        """A report out, and the one that answers it. After a failure nobody knows what the next one
        will answer."""
        try:
            self._port.write(OUT_ENDPOINT, command.ljust(REPORT, b"\0"), TIMEOUT_MS)
            reply = self._port.read(IN_ENDPOINT, REPORT, TIMEOUT_MS)
            if len(reply) != REPORT:
                raise TransferFailed(f"a report of {len(reply)} bytes", where=self.name)
            if reply[0] != command[0]:
                raise TransferFailed(f"{reply[0]:#04x} answers {command[0]:#04x}", where=self.name)
        except TransferFailed:
            self._doubtful = True
            raise
        return reply

    def _synchronise(self) -> None:
        """After a failure: read away late replies, which only by their command can be told from the
        next ones.

        One that comes later still meets another command, since no scan asks the same thing twice in
        its first two commands: that is a failure again.
        """
        if not self._doubtful:
            return
        with named_errors(self.name):
            for endpoint in (OUT_ENDPOINT, IN_ENDPOINT):
                self._port.clear_halt(endpoint)
        self._port.drain(IN_ENDPOINT, REPORT)
        self._doubtful = False


def _check(transfer: Transfer) -> None:
    """Raises TransferFailed for what does not fit a report."""
    longest = max(len(transfer.write), transfer.read)
    if longest > MOST_BYTES:
        raise TransferFailed(
            f"{longest} bytes in one transfer",
            where=Mcp2221.name,
            cause=f"a report carries {MOST_BYTES} at most",
        )
