"""One conversion of a TMAG5273 as its registers set it up (SLYS045A 7.5.2), and the registers.

Covers what a driver of three axes sets: the channels, averaging, ranges, and the read format.
Temperature, angle, repeated channels and the interrupts of wake-and-sleep mode are missing: their
registers can be written and have no effect, and wake-and-sleep is sleep. Where the data sheet is
silent, the emulation does what is harder for a driver: a disabled channel keeps its last result.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from holdfast.drivers.tmag5273 import RANGES_MT, REGISTERS, Register, conversion_s

AXES = range(3)
NOISE_UT = np.array([125.0, 125.0, 68.0])
"""Noise of one conversion (SLYS045A 6.7); averaging divides it by the root of the averages."""
NOISE_ROWS = 4096
FULL_SCALE = 32768
MOST_AVERAGING = 5
"""Of CONV_AVG: 2^5 averages; larger values mean the same."""


@lru_cache(maxsize=12)
def noise_of(seed: int | None, number: int) -> tuple[tuple[float, ...], ...]:
    """[rows][3] noise in uT that a chip's conversions use in turn; none without a seed.

    Cached, because hands are opened again and again.
    """
    if seed is None:
        return ((0.0, 0.0, 0.0),)
    random = np.random.default_rng([seed, number])
    noise = random.normal(size=(NOISE_ROWS, 3)) * NOISE_UT
    return tuple(map(tuple, noise.tolist()))


@dataclass(frozen=True)
class Settings:
    """What the registers set. axes: that are converted; full_ut: full scale of each axis."""

    axes: tuple[int, ...]
    averages: int
    full_ut: tuple[float, float, float]
    duration_s: float
    """Time of one conversion of all its axes."""

    def raw(
        self, field_ut: Sequence[float], noise_ut: Sequence[float]
    ) -> dict[int, int]:
        """Results of the enabled axes, 16 bits, signed.

        Plain numbers, faster here than an array.
        """
        root = math.sqrt(self.averages)
        results = {}
        for axis in self.axes:
            share = (field_ut[axis] + noise_ut[axis] / root) / self.full_ut[axis]
            results[axis] = round(max(-32768.0, min(32767.0, FULL_SCALE * share)))
        return results


@lru_cache(maxsize=256)
def settings(registers: bytes, version: int) -> Settings:
    """From the configuration registers, by address; version 1 or 2. Cached: drivers repeat them."""

    def read(register: str, name: str) -> int:
        return REGISTERS[register].read(registers[REGISTERS[register].address], name)

    mask = read("SENSOR_CONFIG_1", "MAG_CH_EN")
    axes = tuple(axis for axis in AXES if mask >> axis & 1)
    averages = 1 << min(read("DEVICE_CONFIG_1", "CONV_AVG"), MOST_AVERAGING)
    xy_ut = 1e3 * RANGES_MT[version][read("SENSOR_CONFIG_2", "X_Y_RANGE")]
    z_ut = 1e3 * RANGES_MT[version][read("SENSOR_CONFIG_2", "Z_RANGE")]
    duration_s = conversion_s(averages, len(axes))
    return Settings(axes, averages, (xy_ut, xy_ut, z_ut), duration_s)


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
