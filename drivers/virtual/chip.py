"""A TMAG5273 at register level: what the data sheet says it does, converting a field as time goes
by."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

import numpy as np

from drivers.tmag5273 import (
    BURST_8,
    BURST_16,
    CONTINUOUS,
    GENERAL_CALL,
    REGISTERS,
    RESULTS,
    SHORTEST_WAKE_S,
    SLEEP,
    STANDBY,
    TRIGGER,
    crc8,
)
from drivers.virtual.clock import Clock
from drivers.virtual.conversion import (
    REFERENCE_DEGC,
    angle_raw,
    interrupts,
    magnitude_raw,
    settings,
    temperature_raw,
)
from drivers.virtual.faults import Faults

Field = Callable[[float], Sequence[float]]
"""Time in s -> the field at the chip, [3] in uT."""
Temperature = Callable[[float], float]
"""Time in s -> degC of the chip."""
WAKE_AND_SLEEP = 3
"""DEVICE_CONFIG_2.OPERATING_MODE."""
ASLEEP = (SLEEP, WAKE_AND_SLEEP)
NOISE_UT = np.array([125.0, 125.0, 68.0])
"""Of one conversion (SYLS045A 6.7); averaging divides it by the root of the averages."""
NOISE_ROWS = 4096
LAST = max(register.address for register in REGISTERS.values())
BY_ADDRESS = {register.address: register for register in REGISTERS.values()}
STATUS = REGISTERS["CONV_STATUS"].address
TEMPERATURE, ANGLE = REGISTERS["T_MSB_RESULT"].address, REGISTERS["ANGLE_RESULT_MSB"].address
RESULT_READY = 0x01
"""Of CONV_STATUS."""
RESTARTING = tuple(
    REGISTERS[name]
    for name in ("DEVICE_CONFIG_1", "DEVICE_CONFIG_2", "SENSOR_CONFIG_1", "T_CONFIG")
)
"""A write to one of these begins conversions anew."""
CONFIGURATION_BYTES = REGISTERS["I2C_ADDRESS"].address
MOST_CHECKED_CHANNELS = 3
"""In a packet of 16 bits a channel there is no room for a check byte after more."""
IDS = (REGISTERS["MANUFACTURER_ID_LSB"].address, REGISTERS["MANUFACTURER_ID_MSB"].address)
WRONG_ID = 0x00
CHECKED_BYTES = 4
"""Register bytes before the check byte of a register read with CRC; longer reads have none
(SYLS045A 7.5.1.3.3)."""
NOTHING_SENT = 0xFF
"""What a master reads where no chip pulls SDA low."""


class Chip:
    """One chip. number: 1 .. 6, what faults call it; version 1 or 2; seed: of its noise, None for
    none."""

    def __init__(
        self,
        number: int,
        factory_address: int,
        version: int,
        field: Field,
        clock: Clock,
        faults: Faults,
        *,
        seed: int | None = None,
        degc: Temperature = lambda now_s: REFERENCE_DEGC,
    ) -> None:
        self.number, self.factory_address, self.version = number, factory_address, version
        self._field, self._degc, self._clock, self._faults = field, degc, clock, faults
        self._born_ns = clock.now_ns()
        noise = (
            np.zeros((1, 3))
            if seed is None
            else np.random.default_rng([seed, number]).normal(size=(NOISE_ROWS, 3))
        )
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
        self._crossings = 0
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
        if self._mode == WAKE_AND_SLEEP:
            self._doze()
        if self._mode in ASLEEP:
            self._set_mode(STANDBY)
            self._started_ns = None
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
        """The register's address first (its highest bit starts a conversion), then values, address
        by address."""
        if self._first_byte:
            self._first_byte = False
            self._pointer = byte & ~TRIGGER
            if (
                byte & TRIGGER
                and self._mode == STANDBY
                and not self._field_of("DEVICE_CONFIG_2", "TRIGGER_MODE")
            ):
                self._begin()
            return True
        self._store(self._pointer, byte)
        self._pointer += 1
        return True

    def read(self) -> int:
        """The next register, or the next byte of a packet where 1-byte reads are on."""
        if self._packet is not None:
            byte = (
                self._packet[self._packet_at]
                if self._packet_at < len(self._packet)
                else NOTHING_SENT
            )
            self._packet_at += 1
            return byte
        if self._checked:
            return self._read_checked()
        byte = self._load(self._pointer)
        self._pointer += 1
        return byte

    def _read_checked(self) -> int:
        """A register read with CRC_EN: four registers, the check byte over these four, and then
        nothing."""
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
        kept = (
            self._bytes[address] & ~register.writable & 0xFF & ~(register.write_one_clears & byte)
        )
        self._bytes[address] = kept | byte & register.writable
        if register is REGISTERS["I2C_ADDRESS"] and byte & 1:
            self._next_address = byte >> 1
            self._bytes[address] = byte & 0xFE
        self._configured()
        if register in RESTARTING:
            self._restart(mode)

    def _configured(self) -> None:
        """What the registers ask for, read once and not with every conversion."""
        self._mode = self._field_of("DEVICE_CONFIG_2", "OPERATING_MODE")
        configuration = bytes(self._bytes[:CONFIGURATION_BYTES])
        self._settings = settings(configuration, self.version)
        self._interrupts = interrupts(configuration)
        self._reads_as = self._field_of("DEVICE_CONFIG_1", "I2C_RD")
        self._checked = bool(self._field_of("DEVICE_CONFIG_1", "CRC_EN"))

    def _field_of(self, register: str, name: str) -> int:
        return REGISTERS[register].read(self._bytes[REGISTERS[register].address], name)

    # -- conversions

    def _set_mode(self, mode: int) -> None:
        address = REGISTERS["DEVICE_CONFIG_2"].address
        self._bytes[address] = self._bytes[address] & ~3 & 0xFF | mode
        self._configured()

    def _restart(self, mode_before: int) -> None:
        """A changed configuration begins its conversions anew; a chip that falls asleep forgets its
        results."""
        if self._mode in ASLEEP:
            self._forget()
        if self._mode in (CONTINUOUS, WAKE_AND_SLEEP):
            self._begin()
        elif mode_before in (CONTINUOUS, WAKE_AND_SLEEP):
            self._started_ns = None

    def _forget(self) -> None:
        self._bytes[TEMPERATURE:STATUS] = bytes(STATUS - TEMPERATURE)
        self._bytes[ANGLE : ANGLE + 3] = bytes(3)
        self._bytes[STATUS] &= ~RESULT_READY & 0xFF

    def _begin(self) -> None:
        self._started_ns, self._done, self._crossings = self._clock.now_ns(), 0, 0

    def _completed(self, period_s: float) -> int:
        """How many periods have passed since conversions began, none where nothing is converted."""
        if (
            self._started_ns is None
            or not (self._settings.axes or self._settings.temperature)
            or self._has("frozen")
        ):
            return 0
        return (self._clock.now_ns() - self._started_ns) // round(1e9 * period_s)

    def _update(self) -> None:
        """Finish the conversions that have been completed by now; only the last one leaves its
        result."""
        done = self._completed(self._settings.lasts_s)
        if self._mode == STANDBY:
            done = min(done, 1)
        if done <= self._done:
            return
        self._conversions += done - self._done
        self._done = done
        self._convert(self._middle_s(done * self._settings.lasts_s))

    def _doze(self) -> None:
        """Wake-and-sleep mode until now: every result is lost in the next sleep, unless it keeps
        the chip awake."""
        asked = self._settings
        period_s = asked.sleep_s + SHORTEST_WAKE_S + asked.lasts_s
        done = self._completed(period_s)
        if not self._interrupts.possible:
            self._conversions, self._done = self._conversions + done - self._done, done
            return
        while self._done < done and self._mode == WAKE_AND_SLEEP:
            self._done += 1
            self._conversions += 1
            if self._interrupting(self._convert(self._middle_s(self._done * period_s))):
                self._set_mode(STANDBY)
                self._started_ns = None
            else:
                self._forget()

    def _interrupting(self, results: dict[int, int]) -> bool:
        """Whether a result keeps the chip awake."""
        asked = self._interrupts
        crossed = asked.on_threshold and asked.crossed(results, self._degc(self._now_s()))
        self._crossings = self._crossings + 1 if crossed else 0
        return asked.every_result or self._crossings >= asked.crossings

    def _middle_s(self, ends_s: float) -> float:
        """Of the conversion that ends so long after conversions began; time as the field has it."""
        began_ns = self._born_ns if self._started_ns is None else self._started_ns
        return 1e-9 * (began_ns - self._born_ns) + ends_s - 0.5 * self._settings.lasts_s

    def _convert(self, middle_s: float) -> dict[int, int]:
        """One conversion into the result registers; its results by axis."""
        asked, degc = self._settings, self._degc(middle_s)
        noise_ut = self._noise_ut[self._conversions % len(self._noise_ut)]
        results = asked.raw(self._field(middle_s), noise_ut, degc)
        for axis, result in results.items():
            struct.pack_into(">h", self._bytes, RESULTS + 2 * axis, result)
        if asked.temperature:
            struct.pack_into(">H", self._bytes, TEMPERATURE, temperature_raw(degc))
        pair = asked.paired(results)
        if pair is not None:
            struct.pack_into(">HB", self._bytes, ANGLE, angle_raw(*pair), magnitude_raw(*pair))
        self._bytes[STATUS] = (
            self._bytes[STATUS] & 0x1E | (self._conversions % 8) << 5 | RESULT_READY
        )
        return results

    def _burst(self, address: int) -> bytes | None:
        """What a read without a register byte answers, or None where registers are read: T, X, Y, Z
        as they are on."""
        if self._reads_as not in (BURST_16, BURST_8):
            return None
        on = [TEMPERATURE] * self._settings.temperature + [
            RESULTS + 2 * axis for axis in self._settings.axes
        ]
        width = 2 if self._reads_as == BURST_16 else 1
        data = b"".join(self._bytes[at : at + width] for at in on) + bytes([self._load(STATUS)])
        if self._checked and (width == 1 or len(on) <= MOST_CHECKED_CHANNELS):
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
            self._forget()
            self._started_ns = None
