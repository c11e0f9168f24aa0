"""One conversion of a TMAG5273 as its registers set it up (SLYS045A 7.5.2).

Covers channels, temperature, corrections and the angle. Where the data sheet is silent, the
emulation does what is harder for a driver: with averaging, the temperature takes the time of one
more channel, and a disabled channel keeps its last result. The interrupts of wake-and-sleep mode
are missing: to this chip that mode is sleep.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from holdfast.drivers.tmag5273 import RANGES_MT, REGISTERS, Register, conversion_s

X, Y, Z = 0, 1, 2
SEQUENCES: dict[int, tuple[int, ...]] = {
    1: (X,),
    2: (Y,),
    3: (X, Y),
    4: (Z,),
    5: (X, Z),
    6: (Y, Z),
    7: (X, Y, Z),
    8: (X, Y, X),
    9: (Y, X, Y),
    10: (Y, Z, Y),
    11: (X, Z, X),
}
"""SENSOR_CONFIG_1.MAG_CH_EN: the channels in order; a channel that occurs twice keeps its mean."""
ANGLE_PAIRS = {1: (X, Y), 2: (Y, Z), 3: (X, Z)}
"""SENSOR_CONFIG_2.ANGLE_EN."""
TEMPCO_PER_DEGC = {1: 0.0012, 3: 0.002}
"""DEVICE_CONFIG_1.MAG_TEMPCO: the rise of the gain for each degC above 25 degC."""
REFERENCE_DEGC, AT_REFERENCE, LSB_PER_DEGC = 25.0, 17508, 60.1
NOISE_UT = np.array([125.0, 125.0, 68.0])
"""Noise of one conversion (SLYS045A 6.7); averaging divides it by the root of the averages."""
NOISE_ROWS = 4096
FULL_SCALE = 32768
CODES_OF_8_BITS = 256
OFFSET_STEPS = 16
"""16-bit codes of one step of MAG_OFFSET_CONFIG: 2 / 2^12 of the full scale (equation 16)."""
ANGLE_STEPS, CIRCLE = 16, 360 * 16
"""Steps of ANGLE_RESULT in a degree, and in a circle."""


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


def temperature_raw(degc: float) -> int:
    """The inverse of equation 14: 16 bits."""
    raw = AT_REFERENCE + LSB_PER_DEGC * (degc - REFERENCE_DEGC)
    return round(max(0.0, min(32767.0, raw)))


def angle_raw(first: int, second: int) -> int:
    """Of two axes: degrees from 0 to 360 in nine bits, and sixteenths in four (equation 15)."""
    return round(ANGLE_STEPS * math.degrees(math.atan2(second, first))) % CIRCLE


def magnitude_raw(first: int, second: int) -> int:
    """Of two axes: the root of the sum of squares, in codes of 8 bits."""
    return min(255, int(math.hypot(first, second) / CODES_OF_8_BITS))


@dataclass(frozen=True)
class Settings:
    """What the registers set. full_ut: full scale of each axis.

    gain, offset: of each axis, applied to the pair of ANGLE_EN; offset in 16-bit codes.
    """

    sequence: tuple[int, ...]
    averages: int
    temperature: bool
    full_ut: tuple[float, float, float]
    tempco_per_degc: float
    pair: tuple[int, int] | None
    gain: tuple[float, ...]
    offset: tuple[int, ...]

    @cached_property
    def duration_s(self) -> float:
        """Time of one conversion of all channels."""
        channels = len(self.sequence)
        if self.temperature and self.averages > 1:
            channels += 1
        return conversion_s(self.averages, channels)

    @cached_property
    def axes(self) -> tuple[int, ...]:
        """The axes that are converted, in the order of their registers."""
        return tuple(sorted(set(self.sequence)))

    @cached_property
    def noise_divisors(self) -> list[float]:
        """Averaging divides the noise of each axis by this."""
        times = [max(1, self.sequence.count(axis)) for axis in (X, Y, Z)]
        return [math.sqrt(self.averages * n) for n in times]

    def raw(
        self, field_ut: Sequence[float], noise_ut: Sequence[float], degc: float
    ) -> dict[int, int]:
        """Results of the enabled axes, 16 bits, signed.

        Plain numbers, faster here than an array.
        """
        warmer = 1.0 + self.tempco_per_degc * (degc - REFERENCE_DEGC)
        results = {}
        for axis in self.axes:
            noise = noise_ut[axis] / self.noise_divisors[axis]
            share = (warmer * field_ut[axis] + noise) / self.full_ut[axis]
            code = (FULL_SCALE * share + self.offset[axis]) * self.gain[axis]
            results[axis] = round(max(-32768.0, min(32767.0, code)))
        return results


@lru_cache(maxsize=256)
def settings(registers: bytes, version: int) -> Settings:
    """From the configuration registers, by address; version 1 or 2. Cached: drivers repeat them."""

    def byte(register: str) -> int:
        return registers[REGISTERS[register].address]

    def read(register: str, name: str) -> int:
        return REGISTERS[register].read(byte(register), name)

    xy_ut = 1e3 * RANGES_MT[version][read("SENSOR_CONFIG_2", "X_Y_RANGE")]
    z_ut = 1e3 * RANGES_MT[version][read("SENSOR_CONFIG_2", "Z_RANGE")]
    pair = ANGLE_PAIRS.get(read("SENSOR_CONFIG_2", "ANGLE_EN"))
    gain, offset = [1.0, 1.0, 1.0], [0, 0, 0]
    if pair is not None:
        corrected = pair[read("SENSOR_CONFIG_2", "MAG_GAIN_CH")]
        gain[corrected] = byte("MAG_GAIN_CONFIG") / 256 or 1.0
        offset[pair[0]] = OFFSET_STEPS * _signed(byte("MAG_OFFSET_CONFIG_1"))
        offset[pair[1]] = OFFSET_STEPS * _signed(byte("MAG_OFFSET_CONFIG_2"))
    return Settings(
        sequence=SEQUENCES.get(read("SENSOR_CONFIG_1", "MAG_CH_EN"), ()),
        averages=1 << min(read("DEVICE_CONFIG_1", "CONV_AVG"), 5),
        temperature=bool(read("T_CONFIG", "T_CH_EN")),
        full_ut=(xy_ut, xy_ut, z_ut),
        tempco_per_degc=TEMPCO_PER_DEGC.get(read("DEVICE_CONFIG_1", "MAG_TEMPCO"), 0.0),
        pair=pair,
        gain=tuple(gain),
        offset=tuple(offset),
    )


def _signed(byte: int) -> int:
    """Two's complement of eight bits."""
    return byte - 256 if byte & 0x80 else byte


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
