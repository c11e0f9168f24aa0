"""An I2C wire, byte by byte, and the multiplexer that splits it.

A bridge calls start, write, read and stop; everything on the wire receives all of it. Bits are
counted, because they take time. While SDA is held low, nothing is acknowledged and every byte reads
0.

SCL and SDA of an I2C bus, edge by edge, as the chips on the wire decode them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

BITS_OF_A_BYTE = 9
RELEASED = 0xFF
"""What is read where nothing pulls SDA low."""
CLOCKS_TO_FREE = 9


class Target(Protocol):
    """Something with an address on a wire."""

    def addressed(self, address: int, *, read: bool) -> bool:
        """After a START: whether it acknowledges."""
        ...

    def write(self, byte: int) -> bool:
        """A byte from the master; whether it is acknowledged."""
        ...

    def read(self) -> int:
        """The next byte for the master."""
        ...

    def stop(self) -> None:
        """STOP was seen."""
        ...


class Noise:
    """Bits that flip on their way, each with the same probability. seed: decides which bits."""

    def __init__(self, bit_error_rate: float, seed: int = 0) -> None:
        self._rate, self._random = bit_error_rate, np.random.default_rng(seed)
        self._until = int(self._random.geometric(self._rate))

    def flips(self) -> int:
        """Which bits of the next byte flip: a mask of nine bits, the acknowledge lowest."""
        mask = 0
        while self._until <= BITS_OF_A_BYTE:
            mask |= 1 << BITS_OF_A_BYTE - self._until
            self._until += int(self._random.geometric(self._rate))
        self._until -= BITS_OF_A_BYTE
        return mask


class Wire:
    """A wire and the targets on it. noise: what flips bits, or None."""

    def __init__(self, targets: Sequence[Target]) -> None:
        self.targets = list(targets)
        self.bits = 0
        self.noise: Noise | None = None
        self._listening: list[Target] = []
        self._address_next = False
        self._reading = self._silent = False
        self._clocks_to_go = 0

    @property
    def held_low(self) -> bool:
        """Whether a chip holds SDA low."""
        return self._clocks_to_go > 0

    def hold_low(self) -> None:
        """A chip was interrupted in a byte and holds SDA until enough clocks have come."""
        self._clocks_to_go = CLOCKS_TO_FREE

    def power_on(self) -> None:
        """A chip that held SDA low has lost its power meanwhile."""
        self._clocks_to_go = 0

    def clock(self) -> None:
        """One clock pulse with SDA released."""
        self.bits += 1
        self._clocks_to_go = max(0, self._clocks_to_go - 1)

    def start(self) -> None:
        """START, or a repeated START."""
        self.bits += 1
        self._address_next, self._listening = True, []
        self._reading = self._silent = False

    def write(self, byte: int) -> bool:
        """A byte to the addressed targets; whether one acknowledged."""
        self.bits += BITS_OF_A_BYTE
        if self.held_low:
            return False
        if self.noise is None:
            return self._written(byte)
        flips = self.noise.flips()
        return self._written(byte ^ flips >> 1) ^ bool(flips & 1)

    def read(self) -> int:
        """A byte from the addressed targets: open drain, so zeros win; 0xFF without any target."""
        self.bits += BITS_OF_A_BYTE
        if self.held_low:
            return 0
        if self.noise is None:
            return self._sent_byte()
        flips, byte = self.noise.flips(), self._sent_byte()
        self._silent = self._silent or bool(
            flips & 1
        )  # a target that sees no acknowledge ends
        return byte ^ flips >> 1

    def _written(self, byte: int) -> bool:
        if self._address_next:
            self._address_next, self._reading = False, bool(byte & 1)
            self._listening = [
                t for t in self.targets if t.addressed(byte >> 1, read=self._reading)
            ]
            return bool(self._listening)
        if self._reading:  # the targets send the data themselves
            return False
        return any([target.write(byte) for target in self._listening])

    def _sent_byte(self) -> int:
        # the targets were addressed for a write: to them the released line is a byte
        if not self._reading:
            for target in self._listening:
                target.write(RELEASED)
            return RELEASED
        byte = RELEASED
        for target in () if self._silent else self._listening:
            byte &= target.read()
        return byte

    def stop(self) -> None:
        """STOP."""
        self.bits += 1
        self._listening, self._address_next, self._reading = [], False, False
        for target in self.targets:
            target.stop()


class Mux:
    """A TCA9548A: one byte enables any of eight channels, from the next STOP on."""

    def __init__(
        self, channels: Sequence[Sequence[Target]], address: int = 0x70
    ) -> None:
        self.channels = [list(channel) for channel in channels]
        self.address = address
        self._own = False
        self._listening: list[Target] = []
        self.power_on()

    def addressed(self, address: int, *, read: bool) -> bool:
        """Its own address, or one on an enabled channel."""
        self._own = address == self.address
        self._listening = (
            []
            if self._own
            else [t for t in self._enabled if t.addressed(address, read=read)]
        )
        return self._own or bool(self._listening)

    def write(self, byte: int) -> bool:
        """To its control register, or on to the channels."""
        if self._own:
            self._next = byte
            return True
        return any([target.write(byte) for target in self._listening])

    def read(self) -> int:
        """Its control register, or what the channels send."""
        if self._own:
            return self.control
        byte = 0xFF
        for target in self._listening:
            byte &= target.read()
        return byte

    def stop(self) -> None:
        """The new channels are enabled; the channels used so far receive the STOP."""
        for target in self._enabled:
            target.stop()
        if self._next != self.control:
            self._enable(self._next)
        self._own, self._listening = False, []

    def power_on(self) -> None:
        """No channel is enabled."""
        self._enable(0)

    def _enable(self, control: int) -> None:
        self.control = self._next = control
        self._enabled = [
            target
            for number, channel in enumerate(self.channels)
            if control >> number & 1
            for target in channel
        ]


class BusLines:
    """SCL and SDA as the master drives them and as the chips decode them."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.scl = self.master = True
        self._state = "idle"
        self._count = self._byte = 0
        self._acked = self._addressing = False

    @property
    def sda(self) -> bool:
        """The SDA line: low if the master or a chip pulls it."""
        return self.master and not self.wire.held_low

    def set(self, scl: bool, sda: bool) -> None:
        """Pins written by the master; SDA that moves while SCL is high is a START or a STOP."""
        if self.scl and scl and sda != self.master and not self.wire.held_low:
            self._stop() if sda else self._start()
        rises = scl and not self.scl
        self.scl, self.master = scl, sda
        if rises:
            self._clocked(sda)

    def clock(self, bit: bool) -> bool:
        """One bit from the master (1 releases the line); the level of SDA while SCL was high."""
        self.master = bit
        level = self._clocked(bit)
        self.scl = False
        return level

    def byte_out(self, byte: int) -> None:
        """Eight bits from the master.

        In one step where a byte begins and no chip holds the line.
        """
        if self._state == "listen" and not self._count and not self.wire.held_low:
            self._byte, self._count = byte, 8
            self._acked = self.wire.write(byte)
            self.master, self.scl = bool(byte & 1), False
            return
        for k in range(8):
            self.clock(bool(byte >> 7 - k & 1))

    def byte_in(self) -> int:
        """Eight bits from a chip, the master's side unchanged.

        In one step where a chip's byte begins.
        """
        if (
            self._state == "talk"
            and not self._count
            and self.master
            and not self.wire.held_low
        ):
            self._byte, self._count = self.wire.read(), 8
            self.scl = False
            return self._byte
        byte = 0
        for _ in range(8):
            byte = byte << 1 | self.clock(self.master)
        return byte

    def sent(self, byte: int) -> bool:
        """A byte from the master, the line released, and its level then.

        Low where a chip acknowledges.
        """
        if self._state == "listen" and not self._count and not self.wire.held_low:
            self._acked = self.wire.write(byte)
            self.master, self.scl = True, False
            self._acknowledged(byte)
            return not self._acked
        self.byte_out(byte)
        self.set(scl=False, sda=True)
        return self.clock(bit=True)

    def got(self, acknowledge: bool) -> int:
        """A byte from the chips, the master's acknowledge bit (low to go on), the line released."""
        if (
            self._state == "talk"
            and not self._count
            and self.master
            and not self.wire.held_low
        ):
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
            return self._from_master(bit)
        if self._state == "talk":
            return self._from_chips(bit)
        return bit

    def _from_master(self, bit: bool) -> bool:
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
        """The chip that acknowledged its address for a read sends next."""
        if self._addressing and self._acked and byte & 1:
            self._state = "talk"
        self._addressing = False

    def _from_chips(self, bit: bool) -> bool:
        """Eight bits from the chips, then the master's acknowledge; a NACK silences the chips."""
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
