"""An FT232H: its control requests and its MPSSE engine (FTDI AN 108)."""

from __future__ import annotations

from functools import lru_cache

from holdfast.drivers.virtual.usb_backend import BULK, Device, stall
from holdfast.drivers.virtual.usb_devices import Interface, endpoints
from holdfast.drivers.virtual.virtual_hand import VirtualHand
from holdfast.drivers.virtual.wire import BusLines

OUT_ENDPOINT, IN_ENDPOINT, PACKET = 0x02, 0x81, 512
STATUS = bytes([0x32, 0x60])
"""Modem status before every packet."""
TRANSFER_NS = 125_000
"""A transfer takes at least a microframe."""
SCL, SDA, SDA_IN = 0x01, 0x02, 0x04
SIO_RESET, SIO_LATENCY, SIO_GET_LATENCY, SIO_BITMODE, SIO_GET_PINS = (
    0x00,
    0x09,
    0x0A,
    0x0B,
    0x0C,
)
PURGE_SENT, PURGE_ANSWERS = 1, 2
"""Values of SIO_RESET: 1 clears what the host sent, 2 what waits for it, 0 both.

libftdi calls 1 SIO_TCOFLUSH.
"""
MPSSE = 2
SET_PINS = 0x80
LENGTHS = dict.fromkeys(
    (SET_PINS, 0x82, 0x86, 0x9E, 0x10, 0x11, 0x20, 0x24, 0x12, 0x13), 3
) | {
    0x22: 2,
    0x26: 2,
}
"""Bytes of the commands that have arguments, data of byte writes not counted."""
BYTE_WRITES = (0x10, 0x11)
LET_GO = (SET_PINS, bytes([SDA, SCL | SDA]))
"""SCL low, SDA free."""
READ_BIT, READ_BYTE = (0x22, bytes(1)), (0x20, bytes(2))
SENT, GOT = 0x100, 0x101
"""Three commands as one.

A byte out and its acknowledge in, or a byte in and its acknowledge out.
"""
SIMPLE = {0x81, 0x83, 0x84, 0x85, 0x87, 0x8A, 0x8B, 0x8C, 0x8D, 0x96, 0x97}


Command = tuple[int, bytes]
"""An opcode and its arguments."""


@lru_cache(maxsize=64)
def parsed(commands: bytes) -> tuple[tuple[tuple[int, bytes], ...], int]:
    """MPSSE commands as (opcode, arguments), and how many bytes they use; the rest is incomplete.

    A pin write that repeats the one before is left out; SENT and GOT stand for three commands each.
    Cached: a driver sends the same batch again and again.
    """
    found: list[tuple[int, bytes]] = []
    at = 0
    while at < len(commands):
        opcode = commands[at]
        used = LENGTHS.get(opcode, 1)
        if opcode in BYTE_WRITES and at + used <= len(commands):
            used += 1 + int.from_bytes(commands[at + 1 : at + 3], "little")
        if at + used > len(commands):
            break
        command = opcode, commands[at + 1 : at + used]
        if opcode != SET_PINS or not found or found[-1] != command:
            found.append(command)
            found[-3:] = _joined(found[-3:])
        at += used
    return tuple(found), at


def _joined(last: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """The last three commands, or the one command that they make."""
    if (
        len(last) == 3
        and last[2] == READ_BIT
        and last[1] == LET_GO
        and last[0][0] == 0x11
        and len(last[0][1]) == 3
    ):
        return [(SENT, last[0][1][2:])]
    if (
        len(last) == 3
        and last[2] == LET_GO
        and last[1][0] == 0x13
        and last[1][1][0] == 0
        and last[0] == READ_BYTE
    ):
        return [(GOT, last[1][1][1:])]
    return last


class VirtualFt232h(Device):
    """The bridge in front of a virtual hand."""

    vendor, product, speed = 0x0403, 0x6014, "high"
    release = 0x0900
    strings = ("FTDI", "Single RS232-HS", "FTHOLD01")
    interfaces = (
        Interface(endpoints((IN_ENDPOINT, BULK, PACKET), (OUT_ENDPOINT, BULK, PACKET))),
    )
    kernel_driver = frozenset({0})  # ftdi_sio

    def __init__(self, hand: VirtualHand) -> None:
        self.hand = hand
        self.reset()

    def reset(self) -> None:
        """As plugged in: no MPSSE, latency 16 ms, 12 MHz clock."""
        self._mode, self._latency_ms = 0, 16
        self._commands, self._answers = b"", bytearray()
        self._flushed = False
        self._pins = BusLines(self.hand.wire)
        self._divider, self._by_five, self._phases, self._loopback = 0, True, 2, False

    # -- control requests

    def control_out(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> None:
        """FTDI's own requests; those for the serial port are accepted and ignored."""
        if request == SIO_RESET and value in (0, PURGE_SENT, PURGE_ANSWERS):
            if value != PURGE_ANSWERS:
                self._commands = b""
            if value != PURGE_SENT:
                self._answers = bytearray()
        elif request == SIO_LATENCY:
            self._latency_ms = value & 0xFF
        elif request == SIO_BITMODE:
            self._mode = value >> 8
            self._commands, self._answers = b"", bytearray()
        elif request > SIO_GET_PINS:
            raise stall()

    def control_in(
        self, request_type: int, request: int, value: int, index: int, length: int
    ) -> bytes:
        """Latency, pins, modem status."""
        if request == SIO_GET_LATENCY:
            return bytes([self._latency_ms])
        if request == SIO_GET_PINS:
            return bytes([self._levels()])
        if request == 0x05:
            return bytes([0x01, 0x60])
        raise stall()

    # -- bulk

    def write(self, endpoint: int, data: bytes) -> None:
        """Commands; an incomplete one waits for its rest.

        Our computing time counts as transfer time.
        """
        self.hand.clock.spend(TRANSFER_NS)
        if self._mode != MPSSE:
            return
        self.hand.suffer()
        self._commands += data
        bits, from_ns = self.hand.wire.bits, self.hand.clock.now_ns()
        commands, used = parsed(self._commands)
        self._commands = self._commands[used:]
        for opcode, arguments in commands:
            self._carry_out(opcode, arguments)
        lasts_ns = round(1e9 * (self.hand.wire.bits - bits) / self._bus_hz())
        self.hand.clock.spend(from_ns + lasts_ns - self.hand.clock.now_ns())

    def read(self, endpoint: int, length: int) -> bytes:
        """Packets, each with its status; without a flush they wait for the latency timer."""
        self.hand.clock.spend(TRANSFER_NS)
        if not self._flushed:
            self.hand.clock.spend(1_000_000 * self._latency_ms)
        packets = b""
        while len(packets) + len(STATUS) <= length:
            room = min(PACKET, length - len(packets)) - len(STATUS)
            part, self._answers = self._answers[:room], self._answers[room:]
            packets += STATUS + part
            if len(part) < PACKET - len(STATUS):
                break
        self._flushed = self._flushed and bool(self._answers)
        return packets

    # -- the engine

    def _bus_hz(self) -> float:
        master = 12e6 if self._by_five else 60e6
        return master / ((1 + self._divider) * self._phases)

    def _levels(self) -> int:
        return self._pins.scl * SCL | self._pins.master * SDA | self._pins.sda * SDA_IN

    def _carry_out(self, opcode: int, arguments: bytes) -> None:
        if opcode == SET_PINS:
            levels, driven = arguments
            self._pins.set(
                bool(levels & SCL or not driven & SCL),
                bool(levels & SDA or not driven & SDA),
            )
        elif opcode == GOT:
            self._answers.append(self._pins.got(arguments[0] > 127))
        elif opcode == SENT:
            self._answers.append(self._pins.sent(arguments[0]))
        elif opcode in (0x20, 0x24):
            for _ in range(int.from_bytes(arguments, "little") + 1):
                self._answers.append(self._pins.byte_in())
        elif opcode in (0x22, 0x26):
            self._answers.append(self._shift_in(arguments[0] + 1))
        elif opcode in (0x12, 0x13):
            self._shift_out(arguments[1], arguments[0] + 1)
        elif opcode in BYTE_WRITES:
            for byte in arguments[2:]:
                self._pins.byte_out(byte)
        elif opcode == 0x86:
            self._divider = int.from_bytes(arguments, "little")
        elif opcode in SIMPLE:
            self._simple(opcode)
        elif opcode not in LENGTHS:
            self._answers += bytes([0xFA, opcode])

    def _simple(self, opcode: int) -> None:
        if opcode == 0x81:
            self._answers.append(self._levels())
        elif opcode == 0x83:
            self._answers.append(0)
        elif opcode == 0x87:
            self._flushed = True
        elif opcode in (0x8A, 0x8B):
            self._by_five = opcode == 0x8B
        elif opcode in (0x8C, 0x8D):
            self._phases = 3 if opcode == 0x8C else 2

    def _shift_out(self, byte: int, bits: int) -> None:
        for k in range(bits):
            self._pins.clock(bool(byte >> 7 - k & 1))

    def _shift_in(self, bits: int) -> int:
        byte = 0
        for _ in range(bits):
            byte = byte << 1 | self._pins.clock(self._pins.master)
        return byte
