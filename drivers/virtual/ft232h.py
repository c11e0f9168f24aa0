"""An FT232H: its control requests, its MPSSE engine, and the pins that make an I2C wire (FTDI AN
108)."""

from __future__ import annotations

from functools import lru_cache

from drivers.virtual.descriptors import Interface, endpoints
from drivers.virtual.hand import VirtualHand
from drivers.virtual.usb_backend import BULK, Device, stall
from drivers.virtual.wire import Wire

OUT_ENDPOINT, IN_ENDPOINT, PACKET = 0x02, 0x81, 512
STATUS = bytes([0x32, 0x60])
"""Modem status before every packet."""
TRANSFER_NS = 125_000
"""A transfer takes at least a microframe."""
SCL, SDA, SDA_IN = 0x01, 0x02, 0x04
SIO_RESET, SIO_LATENCY, SIO_GET_LATENCY, SIO_BITMODE, SIO_GET_PINS = 0x00, 0x09, 0x0A, 0x0B, 0x0C
PURGE_SENT, PURGE_ANSWERS = 1, 2
"""Values of SIO_RESET: 1 clears what the host sent (libftdi's SIO_TCOFLUSH), 2 what waits for it; 0
clears both."""
MPSSE = 2
SET_PINS = 0x80
LENGTHS = dict.fromkeys((SET_PINS, 0x82, 0x86, 0x9E, 0x10, 0x11, 0x20, 0x24, 0x12, 0x13), 3) | {
    0x22: 2,
    0x26: 2,
}
"""Bytes of the commands that have arguments, data of byte writes not counted."""
BYTE_WRITES = (0x10, 0x11)
LET_GO = (SET_PINS, bytes([SDA, SCL | SDA]))
"""SCL low, SDA free."""
READ_BIT, READ_BYTE = (0x22, bytes(1)), (0x20, bytes(2))
SENT, GOT = 0x100, 0x101
"""Three commands as one: a byte out and its acknowledge in, a byte in and its acknowledge out."""
SIMPLE = {0x81, 0x83, 0x84, 0x85, 0x87, 0x8A, 0x8B, 0x8C, 0x8D, 0x96, 0x97}


class Pins:
    """SCL and SDA, edge by edge, as the chips on the wire understand them."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.scl = self.master = True
        self._state = "idle"
        self._count = self._byte = 0
        self._acked = self._addressing = False

    @property
    def sda(self) -> bool:
        """The line: low if anybody pulls it."""
        return self.master and not self.wire.held_low

    def set(self, scl: bool, sda: bool) -> None:
        """Pins written by the master: SDA that moves while SCL is high is a START or a STOP."""
        if self.scl and scl and sda != self.master and not self.wire.held_low:
            self._stop() if sda else self._start()
        rises = scl and not self.scl
        self.scl, self.master = scl, sda
        if rises:
            self._clocked(sda)

    def clock(self, bit: bool) -> bool:
        """One bit from the master (1 lets the line go); what the line was while SCL was high."""
        self.master = bit
        level = self._clocked(bit)
        self.scl = False
        return level

    def byte_out(self, byte: int) -> None:
        """Eight bits from the master; at once where a byte begins and nobody holds the line."""
        if self._state == "listen" and not self._count and not self.wire.held_low:
            self._byte, self._count = byte, 8
            self._acked = self.wire.write(byte)
            self.master, self.scl = bool(byte & 1), False
            return
        for k in range(8):
            self.clock(bool(byte >> 7 - k & 1))

    def byte_in(self) -> int:
        """Eight bits, the master's side left as it is; at once where a chip's byte begins."""
        if self._state == "talk" and not self._count and self.master and not self.wire.held_low:
            self._byte, self._count = self.wire.read(), 8
            self.scl = False
            return self._byte
        byte = 0
        for _ in range(8):
            byte = byte << 1 | self.clock(self.master)
        return byte

    def sent(self, byte: int) -> bool:
        """A byte from the master, the line let go, and what it is then: low where a chip
        acknowledges."""
        if self._state == "listen" and not self._count and not self.wire.held_low:
            self._acked = self.wire.write(byte)
            self.master, self.scl = True, False
            self._acknowledged(byte)
            return not self._acked
        self.byte_out(byte)
        self.set(scl=False, sda=True)
        return self.clock(bit=True)

    def got(self, acknowledge: bool) -> int:
        """A byte from the chips, the master's acknowledge bit (low to go on), and the line let
        go."""
        if self._state == "talk" and not self._count and self.master and not self.wire.held_low:
            self._byte, self.scl = self.wire.read(), False
            self._state = "silent" if acknowledge else "talk"
            return self._byte
        byte = self.byte_in()
        self.clock(acknowledge)
        self.set(scl=False, sda=True)
        return byte

    def _start(self) -> None:
        self.wire.start()
        self._state, self._count, self._byte, self._addressing = "listen", 0, 0, True

    def _stop(self) -> None:
        self.wire.stop()
        self._state = "idle"

    def _clocked(self, bit: bool) -> bool:
        if self.wire.held_low:
            self.wire.clock()
            return False
        if self._state == "listen":
            return self._heard(bit)
        if self._state == "talk":
            return self._said(bit)
        return bit

    def _heard(self, bit: bool) -> bool:
        """Eight bits from the master, then the chips' acknowledge."""
        if self._count < 8:
            self._byte, self._count = self._byte << 1 & 0xFF | bit, self._count + 1
            if self._count == 8:
                self._acked = self.wire.write(self._byte)
            return bit
        self._count = 0
        self._acknowledged(self._byte)
        return bit and not self._acked

    def _acknowledged(self, byte: int) -> None:
        """Who acknowledged an address to read from talks next."""
        if self._addressing and self._acked and byte & 1:
            self._state = "talk"
        self._addressing = False

    def _said(self, bit: bool) -> bool:
        """Eight bits from the chips, then the master's acknowledge; after a NACK they are
        silent."""
        if self._count == 0:
            self._byte = self.wire.read()
        if self._count < 8:
            level = bool(self._byte >> 7 - self._count & 1) and bit
            self._count += 1
            return level
        self._count = 0
        if bit:
            self._state = "silent"
        return bit


@lru_cache(maxsize=64)
def parsed(commands: bytes) -> tuple[tuple[tuple[int, bytes], ...], int]:
    """MPSSE commands as (opcode, what follows it), and how many bytes they are; the rest is
    incomplete.

    A pin write that repeats the one before moves nothing and is left out; SENT and GOT stand for
    their three. A driver asks the same again and again.
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
    """The last three commands, or the one that they are."""
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
    """The bridge before a virtual hand."""

    vendor, product, speed = 0x0403, 0x6014, "high"
    release = 0x0900
    strings = ("FTDI", "Single RS232-HS", "FTHOLD01")
    interfaces = (Interface(endpoints((IN_ENDPOINT, BULK, PACKET), (OUT_ENDPOINT, BULK, PACKET))),)
    kernel_driver = frozenset({0})  # ftdi_sio

    def __init__(self, hand: VirtualHand) -> None:
        self.hand = hand
        self.reset()

    def reset(self) -> None:
        """As plugged in: no MPSSE, latency 16 ms, 12 MHz clock."""
        self._mode, self._latency_ms = 0, 16
        self._commands, self._answers = b"", bytearray()
        self._flushed = False
        self._pins = Pins(self.hand.wire)
        self._divider, self._by_five, self._phases, self._loopback = 0, True, 2, False

    # -- control requests

    def control_out(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> None:
        """FTDI's own requests; those for the serial port are taken and ignored."""
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
        """Commands; an incomplete one waits for its rest. What we take to compute is part of the
        transfer's time."""
        self.hand.clock.spend(TRANSFER_NS)
        if self._mode != MPSSE:
            return
        self.hand.suffer()
        self._commands += data
        bits, from_ns = self.hand.wire.bits, self.hand.clock.now_ns()
        commands, used = parsed(self._commands)
        self._commands = self._commands[used:]
        for opcode, told in commands:
            self._carry_out(opcode, told)
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

    def _carry_out(self, opcode: int, told: bytes) -> None:
        if opcode == SET_PINS:
            levels, driven = told
            self._pins.set(
                bool(levels & SCL or not driven & SCL), bool(levels & SDA or not driven & SDA)
            )
        elif opcode == GOT:
            self._answers.append(self._pins.got(told[0] > 127))
        elif opcode == SENT:
            self._answers.append(self._pins.sent(told[0]))
        elif opcode in (0x20, 0x24):
            for _ in range(int.from_bytes(told, "little") + 1):
                self._answers.append(self._pins.byte_in())
        elif opcode in (0x22, 0x26):
            self._answers.append(self._shift_in(told[0] + 1))
        elif opcode in (0x12, 0x13):
            self._shift_out(told[1], told[0] + 1)
        elif opcode in BYTE_WRITES:
            for byte in told[2:]:
                self._pins.byte_out(byte)
        elif opcode == 0x86:
            self._divider = int.from_bytes(told, "little")
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
