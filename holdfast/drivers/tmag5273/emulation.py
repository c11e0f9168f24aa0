"""A TMAG5273 at register level, as the data sheet says, in a field that changes with time.

Covers what a driver of three axes sets: the channels, averaging and ranges, with register reads
(SLYS045A 7.5). The 1-byte read formats, check bytes, temperature, angle, repeated channels,
triggers, the general call, another address and the interrupts of wake-and-sleep mode are missing:
their registers can be written and have no effect, and wake-and-sleep is sleep. Where the data sheet
is silent, the emulation does what is harder for a driver: a disabled channel keeps its last result.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from holdfast.drivers.tmag5273.registers import (
    CONTINUOUS,
    FACTORY_ADDRESSES,
    RANGES_MT,
    REGISTERS,
    RESULTS,
    SHORTEST_WAKE_S,
    SLEEP,
    STANDBY,
    conversion_s,
)
from holdfast.drivers.virtual.virtual_hand import EmulatedChip

WAKE_AND_SLEEP = 3
"""DEVICE_CONFIG_2.OPERATING_MODE."""
ASLEEP = (SLEEP, WAKE_AND_SLEEP)
STATUS = REGISTERS["CONV_STATUS"].address
RESULT_READY = 0x01
DIAG_FAILED = 0x02
"""Of CONV_STATUS."""
RESTARTING = ("DEVICE_CONFIG_1", "DEVICE_CONFIG_2", "SENSOR_CONFIG_1", "T_CONFIG")
"""A write to one of these registers restarts the conversions."""
IDS = (
    REGISTERS["MANUFACTURER_ID_LSB"].address,
    REGISTERS["MANUFACTURER_ID_MSB"].address,
)
WRONG_ID = 0x00
AXES = range(3)
FULL_SCALE = 32768
MOST_AVERAGING = 5
"""Of CONV_AVG: 2^5 averages; larger values mean the same."""


@dataclass(frozen=True)
class Settings:
    """What the registers set. axes: that are converted; full_ut: full scale of each axis."""

    axes: tuple[int, ...]
    averages: int
    full_ut: tuple[float, float, float]
    duration_s: float
    """Time of one conversion of all its axes."""

    def raw(self, measured_ut: Sequence[float]) -> dict[int, int]:
        """Results of the enabled axes, 16 bits, signed."""
        results = {}
        for axis in self.axes:
            share = measured_ut[axis] / self.full_ut[axis]
            results[axis] = round(max(-32768.0, min(32767.0, FULL_SCALE * share)))

        return results


@lru_cache(maxsize=256)
def settings(registers: bytes, version: int) -> Settings:
    """From the configuration registers, by address; version 1 or 2. Cached: drivers repeat them."""

    def read(register: str, name: str) -> int:
        return REGISTERS[register].read(registers[REGISTERS[register].address], name)

    mask = read("SENSOR_CONFIG_1", "MAG_CH_EN")
    axes = tuple(axis for axis in AXES if mask >> axis & 1)
    averaging = min(read("DEVICE_CONFIG_1", "CONV_AVG"), MOST_AVERAGING)
    averages = 1 << averaging
    ranges_mt = RANGES_MT[version]
    xy_ut = 1e3 * ranges_mt[read("SENSOR_CONFIG_2", "X_Y_RANGE")]
    z_ut = 1e3 * ranges_mt[read("SENSOR_CONFIG_2", "Z_RANGE")]
    duration_s = conversion_s(averages, len(axes))
    return Settings(axes, averages, (xy_ut, xy_ut, z_ut), duration_s)


LAST = max(register.address for register in REGISTERS.values())
BY_ADDRESS = {register.address: register for register in REGISTERS.values()}
MODE = REGISTERS["DEVICE_CONFIG_2"]
CONFIGURATION_BYTES = REGISTERS["I2C_ADDRESS"].address


class Chip(EmulatedChip):
    """One chip, as virtual_hand.py describes it."""

    addresses = FACTORY_ADDRESSES
    noise_ut = (125.0, 125.0, 68.0)
    """Of one conversion (SLYS045A 6.7); averaging divides it by the root of the averages."""
    version = 1
    """1 or 2."""

    def power_on(self) -> None:
        """Every register as after power-up."""
        self._bytes = bytearray(LAST + 1)
        for register in REGISTERS.values():
            self._bytes[register.address] = register.reset
        self._bytes[REGISTERS["I2C_ADDRESS"].address] = self.address << 1
        self._bytes[REGISTERS["DEVICE_ID"].address] = self.version
        self._configured()
        self._pointer = 0
        self._conversions = 0
        self._done = 0
        self._started_ns: int | None = None
        self._awake_ns = 0
        self._first_byte = False

    # -- the wire

    def addressed(self, address: int, *, read: bool) -> bool:
        """Whether it acknowledges; a sleeping chip wakes and does not."""
        if not self._hears(address):
            return False
        if self._mode in ASLEEP:
            # an address wakes the chip, which is too late to acknowledge it
            self._set_mode(STANDBY)
            self._started_ns = None
            self._awake_ns = self._clock.now_ns() + round(1e9 * SHORTEST_WAKE_S)
            return False
        if self._clock.now_ns() < self._awake_ns:
            return False
        self._update()
        self._first_byte = not read
        return True

    def write(self, byte: int) -> bool:
        """The register's address first, then values in order."""
        if not self._first_byte:
            self._store(self._pointer, byte)
            self._pointer += 1
            return True
        self._first_byte = False
        self._pointer = byte
        return True

    def read(self) -> int:
        """The register at the pointer, which moves on."""
        byte = self._load(self._pointer)
        self._pointer += 1
        return byte

    def stop(self) -> None:
        """Nothing waits for the end of a transfer."""

    # -- registers

    def _load(self, address: int) -> int:
        if address > LAST:
            return 0
        if address in IDS and self._has("wrong"):
            return WRONG_ID
        byte = self._bytes[address]
        if address == STATUS and self._has("diag"):
            byte |= DIAG_FAILED
        return byte

    def _store(self, address: int, byte: int) -> None:
        register = BY_ADDRESS.get(address)
        if register is None:
            return
        cleared = register.write_one_clears & byte
        read_only = ~register.writable & 0xFF
        kept = self._bytes[address] & read_only & ~cleared
        self._bytes[address] = kept | byte & register.writable
        mode = self._mode
        self._configured()
        if any(register is REGISTERS[name] for name in RESTARTING):
            self._restart(mode)

    def _configured(self) -> None:
        """Decode the registers once, not at every conversion."""
        self._mode = MODE.read(self._bytes[MODE.address], "OPERATING_MODE")
        self._settings = settings(
            bytes(self._bytes[:CONFIGURATION_BYTES]), self.version
        )

    # -- conversions

    def _set_mode(self, mode: int) -> None:
        self._bytes[MODE.address] = self._bytes[MODE.address] & ~3 & 0xFF | mode
        self._configured()

    def fall_asleep(self) -> None:
        """As a write of the mode would do."""
        self._set_mode(SLEEP)
        self._forget()
        self._started_ns = None

    def _restart(self, mode_before: int) -> None:
        """A changed configuration restarts the conversions.

        A chip that falls asleep forgets its results.
        """
        if self._mode in ASLEEP:
            self._forget()
        if self._mode == CONTINUOUS:
            self._begin()
        elif mode_before == CONTINUOUS:
            self._started_ns = None

    def _forget(self) -> None:
        self._bytes[RESULTS:STATUS] = bytes(STATUS - RESULTS)
        self._bytes[STATUS] &= ~RESULT_READY & 0xFF

    def _begin(self) -> None:
        self._started_ns = self._clock.now_ns()
        self._done = 0

    def _update(self) -> None:
        """Complete the conversions that are due by now; only the last one leaves its result."""
        wanted = self._settings
        if self._started_ns is None or not wanted.axes or self._has("frozen"):
            return
        done = self._completed(self._started_ns, wanted.duration_s)
        if done <= self._done:
            return
        # conversions in between leave no result, but count
        self._conversions += done - self._done
        self._done = done
        measured_ut = self._measured_ut(
            self._started_ns,
            done,
            wanted.duration_s,
            wanted.averages,
            self._conversions,
        )
        for axis, result in wanted.raw(measured_ut).items():
            place = RESULTS + 2 * axis
            struct.pack_into(">h", self._bytes, place, result)
        # SET_COUNT rolls over after eight conversions
        count = (self._conversions % 8) << 5
        self._bytes[STATUS] = self._bytes[STATUS] & 0x1E | count | RESULT_READY
