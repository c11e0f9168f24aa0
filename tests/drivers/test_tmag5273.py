"""The sensor's registers and numbers, and the virtual chip behind an FT232H, driver and independent
client alike."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from bridge_bench import IDENTITY, A, Bench
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.errors import UsageError
from holdfast.drivers.bus import Transfer
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.tmag5273.driver import Driver
from holdfast.drivers.tmag5273.registers import REGISTERS, RESULTS, conversion_s, packet
from holdfast.drivers.virtual.virtual_hand import REST_UT


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench("ft232h")
    yield made
    made.end()


# -- numbers of the data sheet


def test_registers_lie_side_by_side_and_reset_to_what_the_data_sheet_says():
    assert [register.address for register in REGISTERS.values()] == list(range(0x1D))
    assert {name: r.reset for name, r in REGISTERS.items() if r.reset} == {
        "DEVICE_ID": 0x01,
        "MANUFACTURER_ID_LSB": 0x49,
        "MANUFACTURER_ID_MSB": 0x54,
        "CONV_STATUS": 0x10,
        "DEVICE_STATUS": 0x10,
    }


@pytest.mark.parametrize(
    ("averages", "microseconds"),
    [(1, 100), (2, 175), (4, 325), (8, 625), (16, 1225), (32, 2425)],
)
def test_a_conversion_takes_as_long_as_table_7_4_says(averages, microseconds):
    assert conversion_s(averages) == pytest.approx(1e-6 * microseconds)


def test_the_field_follows_its_equation():
    scale_ut = Driver().scale_ut(1)
    assert 32767 * scale_ut == pytest.approx([39998.8, 39998.8, 79997.6], abs=0.1)
    assert (-32768 * Driver().scale_ut(2)).tolist() == [-133e3, -133e3, -266e3]


@given(
    st.integers(-32768, 32767),
    st.integers(-32768, 32767),
    st.integers(-32768, 32767),
    st.integers(0, 255),
)
def test_a_packet_keeps_its_numbers(x, y, z, status):
    data = b"".join(
        value.to_bytes(2, "big", signed=True) for value in (x, y, z)
    ) + bytes([status])
    read = packet(data)
    assert (*read.raw, read.status) == (x, y, z, status)


# -- the chip


# -- the bridge


def test_a_transfer_that_no_packet_can_answer_is_refused(bench):
    with pytest.raises(UsageError, match="do not fit"):
        bench.bus.scan([Transfer(A, b"\x00", 600)])


# -- an independent client


@pytest.mark.filterwarnings("ignore::DeprecationWarning:pyftdi")
def test_pyftdi_unmodified_reads_the_sensors_of_the_virtual_bridge(monkeypatch):
    from pyftdi.i2c import I2cController, I2cNackError
    from pyftdi.usbtools import UsbTools

    made = Bench("ft232h")
    made.end()
    monkeypatch.setattr(
        UsbTools, "_load_backend", classmethod(lambda cls: made.backend)
    )
    UsbTools.flush_cache()
    controller = I2cController()
    controller.configure("ftdi://ftdi:232h/1", frequency=400_000)
    controller.get_port(0x70).write(b"\x01")
    chip = controller.get_port(A)
    assert bytes(chip.read_from(0x0D, 3)) == IDENTITY
    for register, value in Driver().registers():
        chip.write_to(register, bytes([value]))
    assert bytes(chip.read_from(0x00, 1)) == b"\x34"
    made.wait_s(0.01)
    assert packet(bytes(chip.read_from(RESULTS, 7))).raw[2] == round(
        REST_UT[2] / 80e3 * 32768
    )
    with pytest.raises(I2cNackError):
        controller.get_port(0x36).read_from(0x0D, 1)
    controller.close()
    UsbTools.flush_cache()


# -- the table of registers, the configuration and packets of the data sheet

FIELDS = """
DEVICE_CONFIG_1 MAG_TEMPCO=60 CONV_AVG=1c
DEVICE_CONFIG_2 LP_LN=10 OPERATING_MODE=03
SENSOR_CONFIG_1 MAG_CH_EN=f0
SENSOR_CONFIG_2 X_Y_RANGE=02 Z_RANGE=01
INT_CONFIG_1 MASK_INTB=01
CONV_STATUS SET_COUNT=e0 POR=10 DIAG_STATUS=02 RESULT_STATUS=01
DEVICE_STATUS OSC_ER=08 OTP_CRC_ER=02 VCC_UV_ER=01
"""


def test_each_field_has_the_bits_that_the_data_sheet_gives_it():
    masks = {
        f"{name} {field}": register.value(**{field: (1 << bits) - 1})
        for name, register in REGISTERS.items()
        for field, (_, bits) in register.fields.items()
    }
    expected = {}
    for line in FIELDS.split("\n")[1:-1]:
        name, *fields = line.split()
        expected |= {
            f"{name} {field}": int(mask, 16)
            for field, mask in (one.split("=") for one in fields)
        }
    assert masks == expected
    for name in masks:
        register, field = name.split()
        assert REGISTERS[register].read(masks[name], field) == max(
            REGISTERS[register].read(byte, field) for byte in range(256)
        )


def test_a_write_changes_what_the_data_sheet_lets_it_change():
    read_only = {n: (r.writable, r.write_one_clears) for n, r in REGISTERS.items()}
    assert {n for n, (writable, _) in read_only.items() if not writable} == {
        *(name for name in REGISTERS if "RESULT" in name or name.startswith("MANUF")),
        "DEVICE_ID",
        "CONV_STATUS",
        "DEVICE_STATUS",
    }
    assert {
        n: found for n, found in read_only.items() if found[0] in range(1, 255)
    } == {"SENSOR_CONFIG_2": (0x7F, 0)}
    assert {n: found[1] for n, found in read_only.items() if found[1]} == {
        "CONV_STATUS": 0x10,
        "DEVICE_STATUS": 0x0F,
    }


# -- limits of the FT232H


@pytest.mark.parametrize(
    ("bus_hz", "divider"),
    [(10_000, 1999), (70_000, 285), (100_000, 199), (400_000, 49), (1_000_000, 19)],
)
def test_the_ft232h_divides_its_clock_by_three_phases(bench, bus_hz, divider):
    bench.bus.close()
    bench.bus = Ft232h(bench.backend, bus_hz=bus_hz)
    assert bench.device._divider == divider
    for wrong_hz in (9_999, 1_000_001):
        with pytest.raises(UsageError, match="choose 10000 to 1000000 Hz"):
            Ft232h(bench.backend, bus_hz=wrong_hz)
