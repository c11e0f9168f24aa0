"""An I2C wire, byte by byte, and the multiplexer that splits it.

A bridge calls start, write, read and stop; everything on the wire receives all of it. Bits are
counted, because they take time. While SDA is held low, nothing is acknowledged and every byte reads
0.
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
        self._silent = self._silent or bool(flips & 1)  # a target that sees no acknowledge ends
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

    def __init__(self, channels: Sequence[Sequence[Target]], address: int = 0x70) -> None:
        self.channels = [list(channel) for channel in channels]
        self.address = address
        self._own = False
        self._listening: list[Target] = []
        self.power_on()

    def addressed(self, address: int, *, read: bool) -> bool:
        """Its own address, or one on an enabled channel."""
        self._own = address == self.address
        self._listening = (
            [] if self._own else [t for t in self._enabled if t.addressed(address, read=read)]
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
