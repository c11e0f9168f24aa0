"""An FT232H: its control requests, its MPSSE engine (FTDI AN 108), and the two lines it drives.

It knows the commands that a driver of I2C needs, and answers others as the chip does. The engine
moves whole bytes, because the emulation's computing time is taken from the reader in the same
process. A driver that clocks single bits of a byte would not be understood.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import usb.core

from holdfast.drivers.virtual.virtual_hand import VirtualHand, Wire

OUT_ENDPOINT = 0x02
IN_ENDPOINT = 0x81
PACKET = 512
STATUS = bytes([0x32, 0x60])
"""Modem status before every packet."""
TRANSFER_NS = 125_000
"""A transfer takes at least a microframe."""
SCL = 0x01
SDA = 0x02
SDA_IN = 0x04
SIO_RESET = 0x00
SIO_LATENCY = 0x09
SIO_BITMODE = 0x0B
PURGE_SENT = 1
PURGE_ANSWERS = 2
"""Values of SIO_RESET: 1 clears what the host sent, 2 what waits for it, 0 both.

libftdi calls 1 SIO_TCOFLUSH.
"""
MPSSE = 2
SET_PINS = 0x80
WRITE_BYTES, WRITE_BITS, READ_BYTES, READ_BITS = 0x11, 0x13, 0x20, 0x22
ONE_BIT = b"\0"
"""A length less 1: an acknowledge. No driver of ours moves other bits."""
SET_OTHER_PINS, DIVIDER, OPEN_DRAIN = 0x82, 0x86, 0x9E
LENGTHS = {
    SET_PINS: 3,
    SET_OTHER_PINS: 3,
    DIVIDER: 3,
    OPEN_DRAIN: 3,
    WRITE_BYTES: 3,
    WRITE_BITS: 3,
    READ_BYTES: 3,
    READ_BITS: 2,
}
"""Bytes of the commands that have arguments, data of byte writes not counted."""
WITHOUT_EFFECT = (SET_OTHER_PINS, 0x85, 0x97, OPEN_DRAIN)
STALL = 32

Command = tuple[int, bytes]
"""An opcode and its arguments."""


def stall() -> Any:
    """What libusb raises on a STALL."""
    return usb.core.USBError("Pipe error", STALL, STALL)


@lru_cache(maxsize=64)
def parsed(commands: bytes) -> tuple[tuple[Command, ...], int]:
    """MPSSE commands as (opcode, arguments), and how many bytes they use; the rest is incomplete.

    A pin write that repeats the one before is left out. Cached: a driver sends the same batch again
    and again.
    """
    found: list[Command] = []
    at = 0
    while at < len(commands):
        opcode = commands[at]
        used = LENGTHS.get(opcode, 1)
        if opcode == WRITE_BYTES and at + used <= len(commands):
            used += 1 + int.from_bytes(commands[at + 1 : at + 3], "little")
        if at + used > len(commands):
            break
        command = opcode, commands[at + 1 : at + used]
        if opcode != SET_PINS or not found or found[-1] != command:
            found.append(command)
        at += used

    return tuple(found), at


class VirtualFt232h:
    """The bridge in front of a virtual hand."""

    def __init__(self, hand: VirtualHand) -> None:
        self.hand = hand
        self.reset()

    def reset(self) -> None:
        """As plugged in: no MPSSE, latency 16 ms, 12 MHz clock."""
        self._mode = 0
        self._latency_ms = 16
        self._commands = b""
        self._answers = bytearray()
        self._flushed = False
        self._lines = BusLines(self.hand.wire)
        self._shifted = 0
        self._divider = 0
        self._master_hz = 12e6
        self._phases = 2

    # -- control requests

    def control_out(self, request: int, value: int) -> None:
        """FTDI's own requests; those for the serial port are accepted and ignored."""
        if request == SIO_LATENCY:
            self._latency_ms = value & 0xFF
            return
        if request == SIO_BITMODE:
            self._mode = value >> 8
            # a new mode begins with empty buffers, as after a reset
            value = 0
        elif request != SIO_RESET:
            return
        if value != PURGE_ANSWERS:
            self._commands = b""
        if value != PURGE_SENT:
            self._answers = bytearray()

    # -- bulk

    def write(self, endpoint: int, data: bytes) -> None:
        """Commands; an incomplete one waits for its rest.

        Our computing time counts as transfer time.
        """
        clock = self.hand.clock
        wire = self.hand.wire
        clock.spend(TRANSFER_NS)
        if self._mode != MPSSE:
            return
        self.hand.suffer()
        self._commands += data
        bits = wire.bits
        from_ns = clock.now_ns()
        commands, used = parsed(self._commands)
        self._commands = self._commands[used:]
        for opcode, arguments in commands:
            if opcode == SET_PINS:
                levels, driven = arguments
                # a pin that is not driven is pulled up
                high = levels | ~driven
                self._lines.set(bool(high & SCL), bool(high & SDA))
            elif opcode == WRITE_BYTES:
                for byte in arguments[2:]:
                    self._lines.byte_out(byte)
            elif opcode == READ_BITS and arguments == ONE_BIT:
                # the newest bit is the lowest, and older ones stay above it
                self._shifted = (
                    self._shifted << 1 | self._lines.acknowledge_in()
                ) & 0xFF
                self._answers.append(self._shifted)
            elif opcode == READ_BYTES:
                for _ in range(int.from_bytes(arguments, "little") + 1):
                    self._answers.append(self._lines.byte_in())
            elif opcode == WRITE_BITS and arguments[:1] == ONE_BIT:
                self._lines.acknowledge_out(bool(arguments[1] & 0x80))
            else:
                self._configure(opcode, arguments)

        bus_hz = self._master_hz / ((1 + self._divider) * self._phases)
        duration_ns = round(1e9 * (wire.bits - bits) / bus_hz)
        clock.spend(from_ns + duration_ns - clock.now_ns())

    def read(self, endpoint: int, length: int) -> bytes:
        """Packets, each with its status; without a flush they wait for the latency timer."""
        self.hand.clock.spend(TRANSFER_NS)
        if not self._flushed:
            self.hand.clock.spend(1_000_000 * self._latency_ms)
        packets = b""
        while len(packets) + len(STATUS) <= length:
            room = min(PACKET, length - len(packets)) - len(STATUS)
            part = self._answers[:room]
            self._answers = self._answers[room:]
            packets += STATUS + part
            if len(part) < PACKET - len(STATUS):
                break

        self._flushed = self._flushed and bool(self._answers)
        return packets

    # -- the engine

    def _levels(self) -> int:
        lines = self._lines
        return lines.scl * SCL | lines.master * SDA | lines.sda * SDA_IN

    def _configure(self, opcode: int, arguments: bytes) -> None:
        """Commands that do not move the lines."""
        if opcode == 0x81:
            self._answers.append(self._levels())
        elif opcode == DIVIDER:
            self._divider = int.from_bytes(arguments, "little")
        elif opcode == 0x87:
            self._flushed = True
        elif opcode == 0x8A:
            self._master_hz = 60e6
        elif opcode == 0x8C:
            self._phases = 3
        elif opcode not in WITHOUT_EFFECT:
            self._answers += bytes([0xFA, opcode])


class BusLines:
    """SCL and SDA as the master drives them: pins make START and STOP, commands move bytes."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.scl = self.master = True
        self._acked = False

    @property
    def sda(self) -> bool:
        """The SDA line: low if the master or a chip pulls it."""
        return self.master and not self.wire.held_low

    def set(self, scl: bool, sda: bool) -> None:
        """Pins written by the master; SDA that moves while SCL is high is a START or a STOP."""
        if self.scl and scl and sda != self.master and not self.wire.held_low:
            self.wire.stop() if sda else self.wire.start()
            self._acked = False
        rises = scl and not self.scl
        self.scl = scl
        self.master = sda
        if rises and self.wire.held_low:
            self.wire.clock()

    def byte_out(self, byte: int) -> None:
        """A byte from the master."""
        self.scl = False
        self.master = bool(byte & 1)
        if not self._held(8):
            self._acked = self.wire.write(byte)

    def acknowledge_in(self) -> int:
        """The level of SDA after a byte from the master: low where a chip acknowledges."""
        self.scl = False
        if self._held(1):
            return 0
        return int(self.master and not self._acked)

    def byte_in(self) -> int:
        """A byte from the chips; the released line where none sends."""
        self.scl = False
        return 0 if self._held(8) else self.wire.read()

    def acknowledge_out(self, level: bool) -> None:
        """The master's acknowledge of a byte; a high level silences the chips."""
        self.scl = False
        self.master = level
        if not self._held(1) and level:
            self.wire.refuse()

    def _held(self, clocks: int) -> bool:
        """Whether a chip holds SDA low; it counts these clocks."""
        held = self.wire.held_low
        for _ in range(clocks if held else 0):
            self.wire.clock()
        return held
