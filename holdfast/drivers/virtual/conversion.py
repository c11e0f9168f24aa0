"""One conversion of a TMAG5273 as its registers set it up (SLYS045A 7.5.2).

Covers channels, temperature, corrections and the angle. Where the data sheet is silent, the
emulation does what is harder for a driver: with averaging, the temperature takes the time of one
more channel, and a disabled channel keeps its last result.

The registers of a virtual TMAG5273: their bytes, what a write changes, and their bit fields.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

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
SLEEP_S = (1e-3, 5e-3, 10e-3, 15e-3, 20e-3, 30e-3, 50e-3, 0.1, 0.5, 1.0, 2.0, 5.0, 20.0)
"""SENSOR_CONFIG_1.SLEEPTIME."""
REFERENCE_DEGC, AT_REFERENCE, LSB_PER_DEGC = 25.0, 17508, 60.1
T_THRESHOLD_FIRST, T_THRESHOLD_FIRST_DEGC, T_THRESHOLD_STEP_DEGC = 0x1A, -41.0, 8.0
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
    """[rows][3] noise in uT of a chip's conversions, in turn; a seed of None is a chip without
    noise.

    Cached, because hands are opened again and again.
    """
    if seed is None:
        return ((0.0, 0.0, 0.0),)
    noise = (
        np.random.default_rng([seed, number]).normal(size=(NOISE_ROWS, 3)) * NOISE_UT
    )
    return tuple(map(tuple, noise.tolist()))


def signed(byte: int) -> int:
    """Two's complement of eight bits."""
    return byte - 256 if byte & 0x80 else byte


def temperature_raw(degc: float) -> int:
    """The inverse of equation 14: 16 bits."""
    return round(
        max(0.0, min(32767.0, AT_REFERENCE + LSB_PER_DEGC * (degc - REFERENCE_DEGC)))
    )


def angle_raw(first: int, second: int) -> int:
    """Of two axes: degrees from 0 to 360 in nine bits, and sixteenths in four (equation 15)."""
    return round(ANGLE_STEPS * math.degrees(math.atan2(second, first))) % CIRCLE


def magnitude_raw(first: int, second: int) -> int:
    """Of two axes: the root of the sum of squares, in codes of 8 bits."""
    return min(255, int(math.hypot(first, second) / CODES_OF_8_BITS))


@dataclass(frozen=True)
class Settings:
    """What the registers set. full_ut: full scale of each axis. sleep_s: of wake-and-sleep mode.

    gain, offset: of each axis, applied to the pair of ANGLE_EN; offset in 16-bit codes.
    """

    sequence: tuple[int, ...]
    averages: int
    temperature: bool
    full_ut: tuple[float, float, float]
    tempco_per_degc: float = 0.0
    pair: tuple[int, int] | None = None
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    offset: tuple[int, int, int] = (0, 0, 0)
    sleep_s: float = 0.0
    lasts_s: float = field(init=False)
    axes: tuple[int, ...] = field(init=False)
    quieter: tuple[float, ...] = field(init=False)
    """Averaging divides the noise of each axis by this."""

    def __post_init__(self) -> None:
        channels = len(self.sequence) + (self.temperature and self.averages > 1)
        derived = {
            "lasts_s": conversion_s(self.averages, channels),
            "axes": tuple(sorted(set(self.sequence))),
            "quieter": tuple(
                math.sqrt(self.averages * max(1, self.sequence.count(axis)))
                for axis in (X, Y, Z)
            ),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)

    def raw(
        self, field_ut: Sequence[float], noise_ut: Sequence[float], degc: float
    ) -> dict[int, int]:
        """Results of the enabled axes, 16 bits, signed.

        Plain numbers, faster here than an array.
        """
        warmer = 1.0 + self.tempco_per_degc * (degc - REFERENCE_DEGC)
        results = {}
        for axis in self.axes:
            share = (
                warmer * field_ut[axis] + noise_ut[axis] / self.quieter[axis]
            ) / self.full_ut[axis]
            code = (FULL_SCALE * share + self.offset[axis]) * self.gain[axis]
            results[axis] = round(max(-32768.0, min(32767.0, code)))
        return results

    def paired(self, results: dict[int, int]) -> tuple[int, int] | None:
        """The two results from which the angle is made; None where the angle or an axis is off."""
        if self.pair is None or not set(self.pair) <= results.keys():
            return None
        return results[self.pair[0]], results[self.pair[1]]


@lru_cache(maxsize=256)
def settings(registers: bytes, version: int) -> Settings:
    """From the configuration registers, by address; version 1 or 2. Cached: drivers repeat them."""

    def read(register: str, name: str) -> int:
        return REGISTERS[register].read(registers[REGISTERS[register].address], name)

    xy_mt, z_mt = (
        RANGES_MT[version][read("SENSOR_CONFIG_2", name)]
        for name in ("X_Y_RANGE", "Z_RANGE")
    )
    pair = ANGLE_PAIRS.get(read("SENSOR_CONFIG_2", "ANGLE_EN"))
    gain, offset = [1.0, 1.0, 1.0], [0, 0, 0]
    if pair is not None:
        corrected = pair[read("SENSOR_CONFIG_2", "MAG_GAIN_CH")]
        gain[corrected] = registers[REGISTERS["MAG_GAIN_CONFIG"].address] / 256 or 1.0
        for axis, name in zip(
            pair, ("MAG_OFFSET_CONFIG_1", "MAG_OFFSET_CONFIG_2"), strict=True
        ):
            offset[axis] = OFFSET_STEPS * signed(registers[REGISTERS[name].address])
    return Settings(
        sequence=SEQUENCES.get(read("SENSOR_CONFIG_1", "MAG_CH_EN"), ()),
        averages=1 << min(read("DEVICE_CONFIG_1", "CONV_AVG"), 5),
        temperature=bool(read("T_CONFIG", "T_CH_EN")),
        full_ut=(1e3 * xy_mt, 1e3 * xy_mt, 1e3 * z_mt),
        tempco_per_degc=TEMPCO_PER_DEGC.get(read("DEVICE_CONFIG_1", "MAG_TEMPCO"), 0.0),
        pair=pair,
        gain=(gain[X], gain[Y], gain[Z]),
        offset=(offset[X], offset[Y], offset[Z]),
        sleep_s=SLEEP_S[min(read("SENSOR_CONFIG_1", "SLEEPTIME"), len(SLEEP_S) - 1)],
    )


@dataclass(frozen=True)
class Interrupts:
    """When a chip in wake-and-sleep mode stays awake: at every result, or at a crossed threshold.

    thresholds: codes of 8 bits, by axis, 0 for none. both_poles: the same threshold for the other
    pole. below: crossed where the field is smaller. crossings: this many results in a row.
    hotter_degc: None for no threshold.
    """

    every_result: bool
    on_threshold: bool
    thresholds: tuple[int, int, int]
    both_poles: bool
    below: bool
    crossings: int
    hotter_degc: float | None

    @property
    def possible(self) -> bool:
        """Whether any result could keep the chip awake."""
        return self.every_result or (
            self.on_threshold and (any(self.thresholds) or self.hotter_degc is not None)
        )

    def crossed(self, results: dict[int, int], degc: float) -> bool:
        """Whether a result is beyond a threshold."""
        hot = self.hotter_degc is not None and degc > self.hotter_degc
        return hot or any(
            self._beyond(result, self.thresholds[axis])
            for axis, result in results.items()
        )

    def _beyond(self, result: int, code: int) -> bool:
        if not code:
            return False
        if self.both_poles:
            result, threshold = abs(result), CODES_OF_8_BITS * (code & 0x7F)
        else:
            threshold = CODES_OF_8_BITS * signed(code)
        return result < threshold if self.below else result > threshold


@lru_cache(maxsize=256)
def interrupts(registers: bytes) -> Interrupts:
    """From the configuration registers, by address."""

    def read(register: str, name: str) -> int:
        return REGISTERS[register].read(registers[REGISTERS[register].address], name)

    x, y, z = (registers[REGISTERS[f"{axis}_THR_CONFIG"].address] for axis in "XYZ")
    steps = read("T_CONFIG", "T_THR") - T_THRESHOLD_FIRST
    hot = read("T_CONFIG", "T_THR") and read("T_CONFIG", "T_CH_EN")
    return Interrupts(
        every_result=bool(read("INT_CONFIG_1", "RSLT_INT")),
        on_threshold=bool(read("INT_CONFIG_1", "THRSLD_INT")),
        thresholds=(x, y, z),
        both_poles=read("DEVICE_CONFIG_2", "THR_HYST") == 1,
        below=bool(read("SENSOR_CONFIG_2", "MAG_THR_DIR")),
        crossings=4 if read("SENSOR_CONFIG_2", "THRX_COUNT") else 1,
        hotter_degc=T_THRESHOLD_FIRST_DEGC + T_THRESHOLD_STEP_DEGC * steps
        if hot
        else None,
    )


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
