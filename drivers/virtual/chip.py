"""A TMAG5273 at register level: what the data sheet says it does, converting a field as time goes by."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from drivers.tmag5273 import (
    BURST_8,
    BURST_16,
    CONTINUOUS,
    GENERAL_CALL,
    LAYOUT,
    RANGES_MT,
    REGISTERS,
    RESULTS,
    SHORTEST_WAKE_S,
    SLEEP,
    STANDBY,
    TRIGGER,
    conversion_s,
    crc8,
)
from drivers.virtual.clock import Clock
from drivers.virtual.faults import Faults

Field = Callable[[float], Iterable[float]]
"""Time in s -> the field at the chip, [3] in uT."""
NOISE_UT = np.array([125.0, 125.0, 68.0])
"""Of one conversion (SYLS045A 6.7); averaging divides it by the root of the averages."""
NOISE_ROWS = 4096
LAST = max(register.address for register in REGISTERS.values())
BY_ADDRESS = {register.address: register for register in REGISTERS.values()}
STATUS = REGISTERS["CONV_STATUS"].address
IDS = (REGISTERS["MANUFACTURER_ID_LSB"].address, REGISTERS["MANUFACTURER_ID_MSB"].address)
WRONG_ID = 0x00
CHECKED_BYTES = 4
"""Register bytes before the check byte of a register read with CRC; longer reads have none (SYLS045A 7.5.1.3.3)."""
NOTHING_SENT = 0xFF
"""What a master reads where no chip pulls SDA low."""


class Chip:
    """One chip. number: 1 .. 6, what faults call it; version 1 or 2; seed: of its noise, None for none."""

    def __init__(
        self, number: int, factory_address: int, version: int, field: Field, clock: Clock, faults: Faults,
        *, seed: int | None = None,
    ) -> None:  # fmt: skip
        self.number, self.factory_address, self.version = number, factory_address, version
        self._field, self._clock, self._faults = field, clock, faults
        self._born_ns = clock.now_ns()
        noise = np.zeros((1, 3)) if seed is None else np.random.default_rng([seed, number]).normal(size=(NOISE_ROWS, 3))
        self._noise_ut: list[list[float]] = (noise * NOISE_UT).tolist()
        self.power_on()

    def power_on(self) -> None:
        """Every register as after power-up, the factory address too."""
        self._bytes = bytearray(LAST + 1)
        for register in REGISTERS.values():
            self._bytes[register.address] = register.reset
        self.address = self.factory_address
        self._bytes[REGISTERS["I2C_ADDRESS"].address] = self.factory_address << 1
        self._bytes[REGISTERS["DEVICE_ID"].address] = self.version
        self._configured()
        self._pointer = 0
        self._next_address: int | None = None
        self._conversions = 0
        self._done = 0
        self._started_ns: int | None = None
        self._awake_ns = 0
        self._packet: bytes | None = None
        self._packet_at = 0
        self._first_byte = False
        self._sent = bytearray()

    # -- the wire

    def addressed(self, address: int, *, read: bool) -> bool:
        """Whether it acknowledges; a sleeping chip wakes and does not."""
        if self._faults:
            self._suffer()
        called = address == self.address or (address == GENERAL_CALL and not read)
        if not called or self._has("nack"):
            return False
        if self._mode == SLEEP:
            self._set_mode(STANDBY)
            self._awake_ns = self._clock.now_ns() + round(1e9 * SHORTEST_WAKE_S)
            return False
        if self._clock.now_ns() < self._awake_ns:
            return False
        self._update()
        self._first_byte = not read
        self._packet = self._burst(address) if read else None
        self._packet_at = 0
        self._sent.clear()
        return True

    def write(self, byte: int) -> bool:
        """The register's address first (its highest bit starts a conversion), then values, address by address."""
        if self._first_byte:
            self._first_byte = False
            self._pointer = byte & ~TRIGGER
            if byte & TRIGGER and self._mode == STANDBY:
                self._begin()
            return True
        self._store(self._pointer, byte)
        self._pointer += 1
        return True

    def read(self) -> int:
        """The next register, or the next byte of a packet where 1-byte reads are on."""
        if self._packet is not None:
            byte = self._packet[self._packet_at] if self._packet_at < len(self._packet) else NOTHING_SENT
            self._packet_at += 1
            return byte
        if self._checked:
            return self._read_checked()
        byte = self._load(self._pointer)
        self._pointer += 1
        return byte

    def _read_checked(self) -> int:
        """A register read with CRC_EN: four registers, the check byte over these four, and then nothing."""
        if len(self._sent) > CHECKED_BYTES:
            return NOTHING_SENT
        if len(self._sent) == CHECKED_BYTES:
            byte = crc8(bytes(self._sent))
        else:
            byte = self._load(self._pointer)
            self._pointer += 1
        self._sent.append(byte)
        return byte

    def stop(self) -> None:
        """A new address counts from here on."""
        if self._next_address is not None:
            self.address, self._next_address = self._next_address, None

    # -- registers

    def _load(self, address: int) -> int:
        if address > LAST:
            return 0
        if address in IDS and self._has("wrong"):
            return WRONG_ID
        byte = self._bytes[address]
        if address == STATUS and self._has("diag"):
            byte |= 1 << REGISTERS["CONV_STATUS"].fields["DIAG_STATUS"][0]
        return byte

    def _store(self, address: int, byte: int) -> None:
        register = BY_ADDRESS.get(address)
        if register is None:
            return
        mode = self._mode
        kept = self._bytes[address] & ~register.writable & 0xFF & ~(register.write_one_clears & byte)
        self._bytes[address] = kept | byte & register.writable
        if register is REGISTERS["I2C_ADDRESS"] and byte & 1:
            self._next_address = byte >> 1
            self._bytes[address] = byte & 0xFE
        self._configured()
        if register in (REGISTERS["DEVICE_CONFIG_1"], REGISTERS["DEVICE_CONFIG_2"], REGISTERS["SENSOR_CONFIG_1"]):
            self._restart(mode)

    def _configured(self) -> None:
        """What the registers ask for, read once and not with every conversion."""
        self._mode = self._field_of("DEVICE_CONFIG_2", "OPERATING_MODE")
        self._channels = self._field_of("SENSOR_CONFIG_1", "MAG_CH_EN")
        self._averages = 1 << min(self._field_of("DEVICE_CONFIG_1", "CONV_AVG"), 5)
        self._lasts_s = conversion_s(self._averages)
        self._reads_as = self._field_of("DEVICE_CONFIG_1", "I2C_RD")
        self._checked = bool(self._field_of("DEVICE_CONFIG_1", "CRC_EN"))
        ranges_mt = RANGES_MT[self.version]
        xy_mt, z_mt = (ranges_mt[self._field_of("SENSOR_CONFIG_2", name)] for name in ("X_Y_RANGE", "Z_RANGE"))
        self._full_ut = (1e3 * xy_mt, 1e3 * xy_mt, 1e3 * z_mt)

    def _field_of(self, register: str, name: str) -> int:
        return REGISTERS[register].read(self._bytes[REGISTERS[register].address], name)

    # -- conversions

    def _set_mode(self, mode: int) -> None:
        address = REGISTERS["DEVICE_CONFIG_2"].address
        self._bytes[address] = self._bytes[address] & ~3 & 0xFF | mode
        self._configured()

    def _restart(self, mode_before: int) -> None:
        """A changed configuration begins its conversions anew."""
        if self._mode == CONTINUOUS:
            self._begin()
        elif mode_before == CONTINUOUS:
            self._started_ns = None

    def _begin(self) -> None:
        self._started_ns, self._done = self._clock.now_ns(), 0

    def _update(self) -> None:
        """Finish the conversions that have been completed by now; only the last one leaves its result."""
        if self._started_ns is None or not self._channels or self._has("frozen"):
            return
        done = int(1e-9 * (self._clock.now_ns() - self._started_ns) / self._lasts_s + 1e-6)
        if self._mode == STANDBY:
            done = min(done, 1)
        if done <= self._done:
            return
        self._conversions += done - self._done
        self._done = done
        end_s = 1e-9 * (self._started_ns - self._born_ns) + done * self._lasts_s
        self._convert(end_s - 0.5 * self._lasts_s)

    def _convert(self, middle_s: float) -> None:
        """In plain numbers: for three of them an array costs more than the chip's arithmetic."""
        noise_ut = self._noise_ut[self._conversions % len(self._noise_ut)]
        quieter = math.sqrt(self._averages)
        shares = [
            (field_ut + one_ut / quieter) / full_ut
            for field_ut, one_ut, full_ut in zip(self._field(middle_s), noise_ut, self._full_ut, strict=True)
        ]
        raw = [round(max(-32768.0, min(32767.0, 32768.0 * share))) for share in shares]
        status = self._bytes[STATUS] & 0x1E | (self._conversions % 8) << 5 | 1
        LAYOUT.pack_into(self._bytes, RESULTS, *raw, status)

    def _burst(self, address: int) -> bytes | None:
        """What a read without a register byte answers, or None where registers are read."""
        if self._reads_as not in (BURST_16, BURST_8):
            return None
        results = bytes(self._bytes[RESULTS : RESULTS + 6])
        data = (results if self._reads_as == BURST_16 else results[::2]) + bytes([self._load(STATUS)])
        if self._checked:
            data += bytes([crc8(bytes([address << 1 | 1]) + data)])
        return data

    # -- faults

    def _now_s(self) -> float:
        return 1e-9 * (self._clock.now_ns() - self._born_ns)

    def _has(self, fault: str) -> bool:
        """Whether a fault of this chip lasts now."""
        return bool(self._faults) and self._faults.lasts(fault, self._now_s(), self.number)

    def _suffer(self) -> None:
        if self._faults.happened("por", self._now_s(), self.number):
            self.power_on()
        if self._faults.happened("sleep", self._now_s(), self.number):
            self._set_mode(SLEEP)
            self._started_ns = None
