"""The virtual TMAG5273 against the numbers printed in its data sheet, read over the virtual
wire."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from holdfast.drivers.tmag5273.emulation import Chip
from holdfast.drivers.tmag5273.registers import (
    CONTINUOUS,
    FACTORY_ADDRESSES,
    RANGES_MT,
    REGISTERS,
    RESULTS,
    XYZ,
)
from holdfast.drivers.virtual.faults import Fault, Faults, VirtualClock
from holdfast.drivers.virtual.virtual_hand import Wire

A = FACTORY_ADDRESSES[0]


def emulated_version(number: int) -> type[Chip]:
    """Emulated chips of version 1 or 2."""
    return type("Version", (Chip,), {"version": number})


class ChipOnWire:
    """One chip at 0x35, alone on a wire. field_ut: x, y, z at a time in s. seed: of its noise."""

    def __init__(
        self,
        field_ut: Callable[[float], list[float]] = lambda now_s: [0.0, 0.0, 0.0],
        *faults: Fault,
        number: int = 1,
        version: int = 1,
        seed: int | None = None,
    ) -> None:
        self.clock = VirtualClock(5)
        suffers = Faults(self.clock, faults)
        emulation = emulated_version(version)
        self.chip = emulation(number, A, field_ut, self.clock, suffers, seed=seed)
        self.wire = Wire([self.chip])

    def write(self, *data: int) -> bool:
        """START, address, data, STOP: whether all was acknowledged."""
        self.wire.start()
        acked = all([self.wire.write(byte) for byte in (A << 1, *data)])
        self.wire.stop()
        return acked

    def read(self, length: int, register: int | None = None) -> bytes:
        """A 3-byte read of a register, or a 1-byte read where no register is given."""
        if register is not None:
            self.wire.start()
            assert all([self.wire.write(A << 1), self.wire.write(register)])
        self.wire.start()
        assert self.wire.write(A << 1 | 1)
        data = bytes(self.wire.read() for _ in range(length))
        self.wire.stop()
        return data

    def configure(self, **options: int) -> None:
        """Write registers by name, in this order."""
        for name, value in options.items():
            assert self.write(REGISTERS[name].address, value)

    def convert(self, conversions: int, config: int = 0) -> None:
        """Convert x, y, z continuously without averaging, until this many conversions are
        complete."""
        self.configure(
            SENSOR_CONFIG_1=XYZ << 4, DEVICE_CONFIG_1=config, DEVICE_CONFIG_2=CONTINUOUS
        )
        self.wait_us(conversions * 100 + 10)

    def wait_us(self, duration_us: float) -> None:
        """Let time pass."""
        self.clock.spend(round(1e3 * duration_us))

    def status(self, name: str) -> int:
        """A field of CONV_STATUS."""
        register = REGISTERS["CONV_STATUS"]
        return register.read(self.read(1, register.address)[0], name)

    def results(self) -> list[int]:
        """X, Y, Z: 16 bits, signed."""
        return [int(one) for one in np.frombuffer(self.read(6, RESULTS), ">i2")]


def raw_field(*raw: int) -> Callable[[float], list[float]]:
    """A constant field whose results are these numbers in the narrow range of version 1."""
    field_ut = [1e3 * RANGES_MT[1][0] * one / 32768 for one in raw]
    return lambda now_s: field_ut


# -- channels (register 0x02) and their time (section 6.11)


# -- sleep, and wake-and-sleep (section 7.4)


def test_results_are_lost_in_sleep_and_the_configuration_is_not():
    on = ChipOnWire(raw_field(1, 2, 3))
    on.convert(1)
    on.configure(DEVICE_CONFIG_2=1)
    assert not on.write(0x00)
    on.wait_us(50)
    assert on.results() == [0, 0, 0]
    assert on.status("RESULT_STATUS") == 0
    assert on.read(1, 0x02) == bytes([XYZ << 4])
    assert on.read(1, 0x1C) == b"\x10"


# -- time, and what goes wrong at what time


def test_virtual_time_never_runs_backwards():
    clock = VirtualClock(7)
    for duration_ns, now_ns in ((0, 7), (-5, 7), (1, 8)):
        clock.spend(duration_ns)
        assert clock.now_ns() == now_ns
    for t_ns, now_ns in ((3, 8), (9, 9)):
        clock.wait_until(t_ns)
        assert clock.now_ns() == now_ns


def test_averages_are_powers_of_two_up_to_32_and_shorten_no_conversion():
    for code, averages in enumerate((1, 2, 4, 8, 16, 32, 32, 32)):
        on = ChipOnWire(raw_field(5, 6, 7))
        on.configure(
            SENSOR_CONFIG_1=XYZ << 4,
            DEVICE_CONFIG_1=code << 2,
            DEVICE_CONFIG_2=CONTINUOUS,
        )
        on.wait_us(25 * (3 * averages + 1) - 1)
        assert on.status("RESULT_STATUS") == 0
        on.wait_us(1)
        assert on.status("RESULT_STATUS") == 1
        assert on.status("SET_COUNT") == 1
        on.wait_us(8 * 25 * (3 * averages + 1))
        assert on.status("SET_COUNT") == 1


def test_a_woken_chip_answers_after_50_microseconds():
    on = ChipOnWire()
    on.configure(DEVICE_CONFIG_2=1)
    assert not on.write(0x00)
    on.clock.spend(49_999)
    assert not on.write(0x00)
    on.clock.spend(1)
    assert on.write(0x00)


# -- a chip's registers, noise and faults


def test_a_chip_has_these_registers_after_power_on():
    on = ChipOnWire()
    assert (
        on.read(0x1D, 0).hex()
        == "0000000000000000000000006a01495400000000000000001000000010"
    )
    assert on.read(2, 0x1D).hex() == "0000", "behind the last register there is nothing"
    on.chip.power_on()
    assert (on.chip.address, on.write(0), on.status("POR")) == (A, True, 1)


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("wide", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_a_field_is_read_over_its_full_scale_and_held_at_its_ends(version, wide):
    xy, z = (RANGES_MT[version][one] for one in wide)
    for field_ut, raw in (
        ([1e3 * xy / 4, -1e3 * xy / 8, 1e3 * z / 2], [8192, -4096, 16384]),
        ([1e9, -1e9, 1e9], [32767, -32768, 32767]),
    ):
        on = ChipOnWire(lambda now_s, field_ut=field_ut: field_ut, version=version)
        on.configure(SENSOR_CONFIG_2=wide[0] << 1 | wide[1])
        on.convert(1)
        assert on.results() == raw
