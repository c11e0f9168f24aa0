"""FT232H: a whole scan is one MPSSE batch, one bulk transfer out and one in (FTDI AN 108, AN 255).

SCL is AD0; SDA is AD1 and AD2 tied together. Both are driven open-drain (0x9E), and data change
with three clock phases (0x8C). The acknowledge bit of every byte comes back, so a chip that does
not answer costs only its own reading. The driver reads the idle lines before and after a batch. If
SDA is low, a chip is stuck in the middle of a byte, and every byte would read as an acknowledged
zero; nine clocks free it.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

from holdfast.core.errors import BusStuck, TransferFailed, UsageError
from holdfast.drivers.bus import BRIDGE, NOT_ACKED, Reply, Transfer
from holdfast.drivers.usb import UsbPort

OUT_ENDPOINT = 0x02
IN_ENDPOINT = 0x81
PACKET = 512
STATUS_BYTES = 2
"""Every packet that comes in begins with two bytes of modem status."""
MOST_IN = PACKET - STATUS_BYTES - 4
"""A batch answers with one packet at most: a mark, the idle lines twice, the transfers' bytes."""
EMPTY_READS = 100

VENDOR_OUT = 0x40
INTERFACE_A = 1
SIO_RESET = 0x00
SIO_LATENCY = 0x09
SIO_BITMODE = 0x0B
RESET = 0
PURGE_SENT = 1
PURGE_ANSWERS = 2
"""Discard what the host sent, or what waits for the host; the chip names the two the other way."""
MPSSE_MODE = 0x0200
LATENCY_MS = 1

WRITE_BYTES = 0x11
WRITE_BITS = 0x13
READ_BYTES = 0x20
READ_BITS = 0x22
SET_LOW_PINS = 0x80
GET_LOW_PINS = 0x81
SETUP = bytes([0x8A, 0x97, 0x8C, 0x9E, 0x07, 0x00, 0x85])
"""60 MHz, no adaptive clock, three phases, AD0 .. AD2 drive only zeros, no loopback."""
DIVIDER = 0x86
FLUSH = 0x87
BAD_COMMANDS = (0xAA, 0xAB)
REFUSED = 0xFA
"""Invalid commands: the engine answers 0xFA and the command, which marks where an answer begins."""

SCL = 0x01
SDA = 0x02
SDA_IN = 0x04
DRIVEN = SCL | SDA
HOLD = 4
"""A pin write is repeated this often, for the hold times of START and STOP."""
MASTER_HZ = 60e6
SLOWEST_HZ = 10_000
FASTEST_HZ = 1_000_000
"""Slower, a scan would outlast its USB reads; below 306 Hz the divider has no bits left."""


def _pins(levels: int, times: int = HOLD) -> bytes:
    return bytes([SET_LOW_PINS, levels, DRIVEN]) * times


START = _pins(SCL | SDA) + _pins(SCL) + _pins(0, 1)
STOP = _pins(0) + _pins(SCL) + _pins(SCL | SDA)
RELEASE = _pins(SDA, 1)
"""SCL low, SDA released for the next talker."""
ACK = bytes([WRITE_BITS, 0, 0x00])
NACK = bytes([WRITE_BITS, 0, 0xFF])
LOOK = bytes([GET_LOW_PINS])
CLOCKS = (_pins(SDA) + _pins(SCL | SDA)) * 9
SDA_PULSE = _pins(SDA) + _pins(0) + LOOK + _pins(SDA) + _pins(SCL | SDA)
"""SDA low for a moment, and read back, while SCL is low."""


class Ft232h:
    """An I2C bus behind an FT232H. bus_hz: 10 kHz to 1 MHz; number: which FT232H on USB.

    Raises UsageError, DeviceNotFound, AccessDenied, DeviceLost, TransferFailed, or BusStuck where
    SDA is not wired.
    """

    name = BRIDGE

    def __init__(self, backend: Any, *, number: int = 0, bus_hz: int = 400_000) -> None:
        if not SLOWEST_HZ <= bus_hz <= FASTEST_HZ:
            raise UsageError(
                f"bus_hz={bus_hz} is not a bus speed of the {self.name}",
                next_step=f"choose {SLOWEST_HZ} to {FASTEST_HZ} Hz",
            )
        # three phases: each bit takes one and a half clocks of the two-phase formula
        self._divider = round(MASTER_HZ / (3 * bus_hz)) - 1
        self._turn = 0
        self._doubtful = True
        self._port = UsbPort(backend, number=number)
        # a bridge that does not get ready must not keep its interface
        try:
            self._begin()
        except BaseException:
            self._port.close()
            raise

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """All transfers in one round trip. Raises UsageError where their answers fill a packet."""
        expected = sum(_answers(transfer) for transfer in transfers)
        if expected > MOST_IN:
            raise UsageError(
                f"transfers with {expected} bytes of answers do not fit into one scan",
                next_step=f"ask for at most {MOST_IN} bytes at once",
            )
        return self._carry(transfers, expected)

    def clear(self) -> None:
        """Nine clocks and a STOP. Raises BusStuck where SCL or SDA stays low after them."""
        self._begin()
        pins = self._ask(CLOCKS + STOP + LOOK, 1)[0]
        low = [name for name, pin in (("SCL", SCL), ("SDA", SDA_IN)) if not pins & pin]
        if low:
            raise BusStuck(
                f"{' and '.join(low)} still low after nine clocks",
                where=self.name,
                cause="a sensor without supply, a short, pull-ups missing, or SDA and SCL swapped",
                next_step="switch the sensors' power off and on",
            )

    def close(self) -> None:
        """Give the bridge back; a second call does no harm."""
        self._port.close()

    def _begin(self) -> None:
        """Reset the engine, and see that it answers."""
        # the order matters: the mode is set in an engine whose buffers are empty
        for request, value in (
            (SIO_RESET, RESET),
            (SIO_RESET, PURGE_SENT),
            (SIO_RESET, PURGE_ANSWERS),
            (SIO_LATENCY, LATENCY_MS),
            (SIO_BITMODE, 0),
            (SIO_BITMODE, MPSSE_MODE),
        ):
            self._port.control_out(VENDOR_OUT, request, value, INTERFACE_A)

        self._doubtful = True
        # the mark alone: an engine in another mode does not return it
        self._ask(b"", 0)
        divider = bytes([DIVIDER, self._divider & 0xFF, self._divider >> 8])
        self._port.write(OUT_ENDPOINT, SETUP + divider + _pins(SCL | SDA))
        self._check_wiring()

    def _check_wiring(self) -> None:
        """Pull SDA low by AD1 and read it by AD2. Raises BusStuck where AD2 does not see it.

        SCL is low meanwhile, so no chip takes it for a START or a STOP. A line that is not tied
        reads high, and no chip would ever seem to acknowledge.
        """
        pins = self._ask(SDA_PULSE, 1)[0]
        if pins & SDA_IN:
            raise BusStuck(
                "SDA cannot be read back",
                where=self.name,
                cause="AD1 and AD2 are not tied together",
                next_step="wire AD1 and AD2 both to SDA",
            )

    def _carry(self, transfers: Sequence[Transfer], expected: int) -> list[Reply]:
        """One batch, between two looks at the idle lines. Raises BusStuck where one was low."""
        commands = b"".join(_commands(transfer) for transfer in transfers)
        answer = self._ask(LOOK + commands + LOOK, expected + 2)
        # with SDA held low every acknowledge bit would read as acknowledged
        idle = SCL | SDA_IN
        if answer[0] & answer[-1] & idle != idle:
            raise BusStuck(
                "SCL or SDA is held low",
                where=self.name,
                cause="a chip was interrupted in the middle of a byte",
            )
        replies = []
        at = 1
        for transfer in transfers:
            data_at = at + _acks(transfer)
            end = data_at + transfer.read
            # one missing acknowledge spoils the transfer, and the other transfers stand
            refused = any(ack & 1 for ack in answer[at:data_at])
            replies.append(
                NOT_ACKED if refused else Reply(answer[data_at:end], acked=True)
            )
            at = end

        return replies

    def _ask(self, commands: bytes, expected: int) -> bytes:
        """Send commands and return their answer. After a failure, discard old answers first.

        The mark alternates, so a late answer to an earlier request is never taken for this one.
        """
        if self._doubtful:
            for value in (PURGE_SENT, PURGE_ANSWERS):
                self._port.control_out(VENDOR_OUT, SIO_RESET, value, INTERFACE_A)
            self._port.drain(IN_ENDPOINT, PACKET, empty=STATUS_BYTES)
        self._doubtful = True
        # two marks suffice: only the answer to the request before can be late
        self._turn = 1 - self._turn
        mark = BAD_COMMANDS[self._turn]
        self._port.write(OUT_ENDPOINT, bytes([mark]) + commands + bytes([FLUSH]))
        answer = self._collect(expected + 2)
        if answer[:2] != bytes([REFUSED, mark]):
            raise TransferFailed(
                "the answer belongs to another request",
                where=self.name,
                cause="a late reply",
            )
        self._doubtful = False
        return answer[2:]

    def _collect(self, expected: int) -> bytes:
        """Exactly so many bytes of answers, without the packets' status bytes."""
        found = b""
        empty = 0
        while len(found) < expected:
            packet = self._port.read(IN_ENDPOINT, PACKET)
            if len(packet) < STATUS_BYTES:
                raise self._wrong_length(f"a packet of {len(packet)} bytes")
            # an empty packet only says that the latency timer has run out
            empty = empty + 1 if len(packet) == STATUS_BYTES else 0
            if empty > EMPTY_READS:
                raise self._wrong_length(f"{len(found)} of {expected} bytes arrived")
            found += packet[STATUS_BYTES:]

        if len(found) > expected:
            raise self._wrong_length(f"{len(found)} bytes arrived, not {expected}")
        return found

    def _wrong_length(self, what: str) -> TransferFailed:
        return TransferFailed(what, where=self.name)


@lru_cache(maxsize=64)
def _commands(transfer: Transfer) -> bytes:
    """One transfer: every byte written is followed by its acknowledge bit. Cached: scans repeat."""
    commands = b""
    if transfer.write or not transfer.read:
        commands += START + _written(transfer.address << 1)
        for byte in transfer.write:
            commands += _written(byte)
    if transfer.read:
        commands += _pins(SDA, 1) + START + _written(transfer.address << 1 | 1)
        # SDA is released before and after each byte; a NACK ends the read
        one_byte = bytes([READ_BYTES, 0, 0])
        commands += (one_byte + ACK + RELEASE) * (transfer.read - 1)
        commands += one_byte + NACK + RELEASE
    return commands + STOP


def _written(byte: int) -> bytes:
    return bytes([WRITE_BYTES, 0, 0, byte]) + RELEASE + bytes([READ_BITS, 0])


def _answers(transfer: Transfer) -> int:
    """How many bytes a transfer answers: acknowledge bits, then data."""
    return _acks(transfer) + transfer.read


def _acks(transfer: Transfer) -> int:
    written = 1 + len(transfer.write) if transfer.write or not transfer.read else 0
    return written + bool(transfer.read)
