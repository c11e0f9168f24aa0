"""A TMAG5273 at register level, as the data sheet says, in a field that changes with time."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

from holdfast.drivers.tmag5273 import (
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
from holdfast.drivers.virtual.clock import Clock
from holdfast.drivers.virtual.conversion import (
    LAST,
    REFERENCE_DEGC,
    RegisterFile,
    angle_raw,
    interrupts,
    magnitude_raw,
    noise_of,
    settings,
    temperature_raw,
)
from holdfast.drivers.virtual.faults import Faults

FieldSource = Callable[[float], Sequence[float]]
"""Time in s -> the field at the chip, [3] in uT."""
Temperature = Callable[[float], float]
"""Time in s -> degC of the chip."""
WAKE_AND_SLEEP = 3
"""DEVICE_CONFIG_2.OPERATING_MODE."""
ASLEEP = (SLEEP, WAKE_AND_SLEEP)
STATUS = REGISTERS["CONV_STATUS"].address
TEMPERATURE, ANGLE = (
    REGISTERS["T_MSB_RESULT"].address,
    REGISTERS["ANGLE_RESULT_MSB"].address,
)
RESULT_READY = 0x01
"""Of CONV_STATUS."""
RESTARTING = tuple(
    REGISTERS[name]
    for name in ("DEVICE_CONFIG_1", "DEVICE_CONFIG_2", "SENSOR_CONFIG_1", "T_CONFIG")
)
"""A write to one of these registers restarts the conversions."""
MOST_CHECKED_CHANNELS = 3
"""A packet of 16 bits a channel has no room for a check byte after more channels."""
IDS = (
    REGISTERS["MANUFACTURER_ID_LSB"].address,
    REGISTERS["MANUFACTURER_ID_MSB"].address,
)
WRONG_ID = 0x00
CHECKED_BYTES = 4
"""Register bytes before the check byte of a register read with CRC (SLYS045A 7.5.1.3.3).

Longer reads have no check byte.
"""
NOTHING_SENT = 0xFF
"""What a master reads where no chip pulls SDA low."""


class Chip:
    """One chip. number: 1 .. 6, its name in faults; version 1 or 2; seed.

    Of its noise, None for none.
    """

    def __init__(
        self,
        number: int,
        factory_address: int,
        version: int,
        field: FieldSource,
        clock: Clock,
        faults: Faults,
        *,
        seed: int | None = None,
        degc: Temperature = lambda now_s: REFERENCE_DEGC,
    ) -> None:
        self.number, self.factory_address, self.version = (
            number,
            factory_address,
            version,
        )
        self._field, self._degc, self._clock, self._faults = field, degc, clock, faults
        self._born_ns = clock.now_ns()
        self._noise_ut = noise_of(seed, number)
        self.power_on()

    def power_on(self) -> None:
        """Every register as after power-up, and the factory address."""
        self._registers = RegisterFile(self.factory_address, self.version)
        self._bytes = self._registers.bytes
        self.address = self.factory_address
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
        """The register's address first, then values in order.

        The address's highest bit starts a conversion.
        """
        if self._first_byte:
            self._first_byte = False
            self._pointer = byte & ~TRIGGER
            if (
                byte & TRIGGER
                and self._mode == STANDBY
                and not self._registers.field("DEVICE_CONFIG_2", "TRIGGER_MODE")
            ):
                self._begin()
            return True
        self._store(self._pointer, byte)
        self._pointer += 1
        return True

    def read(self) -> int:
        """The next register, or the next byte of a packet in 1-byte mode."""
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
        """A register read with CRC_EN: four registers, their check byte, and then nothing."""
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
        mode, register = self._mode, self._registers.store(address, byte)
        if register is None:
            return
        if register is REGISTERS["I2C_ADDRESS"] and byte & 1:
            self._next_address = byte >> 1
            self._bytes[address] = byte & 0xFE
        self._configured()
        if register in RESTARTING:
            self._restart(mode)

    def _configured(self) -> None:
        """Decode the registers once, not at every conversion."""
        self._mode = self._registers.field("DEVICE_CONFIG_2", "OPERATING_MODE")
        configuration = self._registers.configuration
        self._settings = settings(configuration, self.version)
        self._interrupts = interrupts(configuration)
        self._reads_as = self._registers.field("DEVICE_CONFIG_1", "I2C_RD")
        self._checked = bool(self._registers.field("DEVICE_CONFIG_1", "CRC_EN"))

    # -- conversions

    def _set_mode(self, mode: int) -> None:
        self._registers.set_mode(mode)
        self._configured()

    def _restart(self, mode_before: int) -> None:
        """A changed configuration restarts the conversions.

        A chip that falls asleep forgets its results.
        """
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
        """Periods that have passed since conversions began; 0 where the chip does not convert."""
        if (
            self._started_ns is None
            or not (self._settings.axes or self._settings.temperature)
            or self._has("frozen")
        ):
            return 0
        return (self._clock.now_ns() - self._started_ns) // round(1e9 * period_s)

    def _update(self) -> None:
        """Complete the conversions that are due by now; only the last one leaves its result."""
        done = self._completed(self._settings.lasts_s)
        if self._mode == STANDBY:
            done = min(done, 1)
        if done <= self._done:
            return
        self._conversions += done - self._done
        self._done = done
        self._convert(self._middle_s(done * self._settings.lasts_s))

    def _doze(self) -> None:
        """Wake-and-sleep mode until now.

        Each sleep erases the result, unless it keeps the chip awake.
        """
        wanted = self._settings
        period_s = wanted.sleep_s + SHORTEST_WAKE_S + wanted.lasts_s
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
        rules = self._interrupts
        crossed = rules.on_threshold and rules.crossed(
            results, self._degc(self._now_s())
        )
        self._crossings = self._crossings + 1 if crossed else 0
        return rules.every_result or self._crossings >= rules.crossings

    def _middle_s(self, ends_s: float) -> float:
        """The middle of the conversion that ends this long after the first began, in field time."""
        began_ns = self._born_ns if self._started_ns is None else self._started_ns
        return 1e-9 * (began_ns - self._born_ns) + ends_s - 0.5 * self._settings.lasts_s

    def _convert(self, middle_s: float) -> dict[int, int]:
        """One conversion into the result registers; returns its results by axis."""
        wanted, degc = self._settings, self._degc(middle_s)
        noise_ut = self._noise_ut[self._conversions % len(self._noise_ut)]
        results = wanted.raw(self._field(middle_s), noise_ut, degc)
        for axis, result in results.items():
            struct.pack_into(">h", self._bytes, RESULTS + 2 * axis, result)
        if wanted.temperature:
            struct.pack_into(">H", self._bytes, TEMPERATURE, temperature_raw(degc))
        pair = wanted.paired(results)
        if pair is not None:
            struct.pack_into(
                ">HB", self._bytes, ANGLE, angle_raw(*pair), magnitude_raw(*pair)
            )
        self._bytes[STATUS] = (
            self._bytes[STATUS] & 0x1E | (self._conversions % 8) << 5 | RESULT_READY
        )
        return results

    def _burst(self, address: int) -> bytes | None:
        """The packet of a read without a register byte; None in register reads.

        T, X, Y and Z as they are enabled, then the status and perhaps a check byte.
        """
        if self._reads_as not in (BURST_16, BURST_8):
            return None
        on = [TEMPERATURE] * self._settings.temperature + [
            RESULTS + 2 * axis for axis in self._settings.axes
        ]
        width = 2 if self._reads_as == BURST_16 else 1
        data = b"".join(self._bytes[at : at + width] for at in on) + bytes(
            [self._load(STATUS)]
        )
        if self._checked and (width == 1 or len(on) <= MOST_CHECKED_CHANNELS):
            data += bytes([crc8(bytes([address << 1 | 1]) + data)])
        return data

    # -- faults

    def _now_s(self) -> float:
        return 1e-9 * (self._clock.now_ns() - self._born_ns)

    def _has(self, fault: str) -> bool:
        """Whether this chip has a fault now."""
        return bool(self._faults) and self._faults.lasts(
            fault, self._now_s(), self.number
        )

    def _suffer(self) -> None:
        if self._faults.happened("por", self._now_s(), self.number):
            self.power_on()
        if self._faults.happened("sleep", self._now_s(), self.number):
            self._set_mode(SLEEP)
            self._forget()
            self._started_ns = None
