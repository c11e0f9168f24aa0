"""The registers of a virtual TMAG5273: their bytes, what a write changes, and their bit fields."""

from __future__ import annotations

from holdfast.drivers.tmag5273 import REGISTERS, Register

LAST = max(register.address for register in REGISTERS.values())
BY_ADDRESS = {register.address: register for register in REGISTERS.values()}
CONFIGURATION_BYTES = REGISTERS["I2C_ADDRESS"].address


class RegisterFile:
    """The bytes of all registers by address, as after power-on; version 1 or 2 of the chip."""

    def __init__(self, factory_address: int, version: int) -> None:
        self.bytes = bytearray(LAST + 1)
        for register in REGISTERS.values():
            self.bytes[register.address] = register.reset
        self.bytes[REGISTERS["I2C_ADDRESS"].address] = factory_address << 1
        self.bytes[REGISTERS["DEVICE_ID"].address] = version

    @property
    def configuration(self) -> bytes:
        """The configuration registers, from address 0."""
        return bytes(self.bytes[:CONFIGURATION_BYTES])

    def field(self, register: str, name: str) -> int:
        """One bit field of a register."""
        return REGISTERS[register].read(self.bytes[REGISTERS[register].address], name)

    def set_mode(self, mode: int) -> None:
        """Set DEVICE_CONFIG_2.OPERATING_MODE."""
        address = REGISTERS["DEVICE_CONFIG_2"].address
        self.bytes[address] = self.bytes[address] & ~3 & 0xFF | mode

    def store(self, address: int, byte: int) -> Register | None:
        """Write a byte as the chip takes it; the register, or None where there is none."""
        register = BY_ADDRESS.get(address)
        if register is not None:
            cleared = register.write_one_clears & byte
            kept = self.bytes[address] & ~register.writable & 0xFF & ~cleared
            self.bytes[address] = kept | byte & register.writable
        return register
