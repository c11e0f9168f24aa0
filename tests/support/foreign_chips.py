"""Chips of others on the wire, as their data sheets have them, for tests of what a scan does to
them.

Each tells in `state` what it would lose: its memory, outputs and settings, but not its pointer,
which any read moves.
"""

from __future__ import annotations

GENERAL_CALL, SOFTWARE_RESET = 0x00, 0x06


class Registers:
    """A chip with registers: the first byte written is a pointer, those after it are stored.

    increments: whether the pointer goes on by itself.
    """

    def __init__(self, address: int, memory: bytes, *, increments: bool = True) -> None:
        self.address, self.memory, self.increments = (
            address,
            bytearray(memory),
            increments,
        )
        self.pointer, self._first = 0, False

    @property
    def state(self) -> bytes:
        """What it holds."""
        return bytes(self.memory)

    def addressed(self, address: int, *, read: bool) -> bool:
        self._first = not read
        return address == self.address

    def write(self, byte: int) -> bool:
        if self._first:
            self.pointer, self._first = byte % len(self.memory), False
        else:
            self.memory[self.pointer] = byte
            self._go_on()
        return True

    def read(self) -> int:
        byte = self.memory[self.pointer]
        self._go_on()
        return byte

    def stop(self) -> None:
        """Nothing is pending."""

    def _go_on(self) -> None:
        self.pointer = (self.pointer + self.increments) % len(self.memory)


def eeprom(address: int = 0x50) -> Registers:
    """A 24C02 with something in it."""
    return Registers(address, bytes(k * 37 % 251 for k in range(256)))


class Pca9685(Registers):
    """A 16-channel PWM driver (NXP): it also answers at its all-call address, and the general call
    06 resets it."""

    ALL_CALL = 0x70
    FRESH = bytes([0x11, 0x04, 0xE2, 0xE4, 0xE8, 0xE0]) + bytes(250)

    def __init__(self, address: int = 0x40) -> None:
        in_use = bytearray(self.FRESH)
        # awake, a servo at its angle
        in_use[0], in_use[6:10] = 0x01, bytes([0x10, 0x00, 0x33, 0x01])
        super().__init__(address, bytes(in_use), increments=False)
        self.reset_calls = 0
        self._general = False

    def addressed(self, address: int, *, read: bool) -> bool:
        super().addressed(address, read=read)
        self._general = address == GENERAL_CALL and not read
        return self._general or address in (self.address, self.ALL_CALL)

    def write(self, byte: int) -> bool:
        if not self._general:
            return super().write(byte)
        if self._first and byte == SOFTWARE_RESET:
            self.reset_calls += 1
            self.memory[:] = self.FRESH
        self._first = False
        return True


class Ads1115(Registers):
    """An analog-to-digital converter (TI): four registers of two bytes, its pointer has two
    bits."""

    def __init__(self, address: int = 0x48) -> None:
        super().__init__(
            address, bytes([0x12, 0x34, 0x85, 0x83, 0x80, 0x00, 0x7F, 0xFF])
        )

    def write(self, byte: int) -> bool:
        if self._first:
            byte = 2 * (byte & 3)
        return super().write(byte)


class Expander:
    """An I/O expander (PCF8574): no registers; every byte written is its outputs."""

    def __init__(self, address: int = 0x20) -> None:
        self.address, self.outputs = address, 0b1010_0101

    @property
    def state(self) -> bytes:
        """Its outputs."""
        return bytes([self.outputs])

    def addressed(self, address: int, *, read: bool) -> bool:
        return address == self.address

    def write(self, byte: int) -> bool:
        self.outputs = byte
        return True

    def read(self) -> int:
        return self.outputs

    def stop(self) -> None:
        """Nothing is pending."""
