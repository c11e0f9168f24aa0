"""The sensor's registers and numbers, and the virtual chip behind an FT232H, driver and independent
client alike."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from bridge_bench import FIRST, ID, IDENTITY, SECOND, SIX, A, B, Bench, C, D
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.errors import BusStuck, UsageError
from holdfast.drivers.bus import Transfer
from holdfast.drivers.tmag5273 import (
    PACKET_BYTES,
    REGISTERS,
    RESULTS,
    Packet,
    Setup,
    conversion_s,
    crc8,
    field_ut,
    packet,
)
from holdfast.drivers.virtual.faults import Fault
from holdfast.drivers.virtual.virtual_hand import REST_UT, Track

BOTH = Transfer(0x70, bytes([0b11]))


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


def test_crc_has_the_vectors_of_the_data_sheet():
    vectors = {
        "00": 0xF3,
        "ff": 0x00,
        "80": 0x7A,
        "4c": 0x10,
        "e0": 0x5D,
        "00000000": 0xD1,
        "ffffffff": 0x0F,
    }
    assert {data: crc8(bytes.fromhex(data)) for data in vectors} == vectors


def test_the_field_follows_its_equation():
    assert field_ut([32767, -32768, 0], 80.0) == pytest.approx(
        [79997.6, -80000.0, 0.0], abs=0.1
    )


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
    assert read.set_count == status >> 5


def test_the_default_setup_is_what_the_fact_sheet_recommends():
    assert Setup().registers() == [
        (0x08, 0x01),
        (0x02, 0x70),
        (0x03, 0x01),
        (0x07, 0x00),
        (0x00, 0x34),
        (0x01, 0x12),
    ]
    assert Setup(burst=True).registers()[4] == (0x00, 0x35)


# -- the chip


def answer(bench: Bench, register: int, length: int) -> bytes:
    """What the chip at A answers to a register read."""
    return bench.bus.scan([Transfer(A, bytes([register]), length)])[0].data


def converted(bench: Bench) -> Packet:
    """The newest results of the chip at A."""
    return packet(answer(bench, RESULTS, PACKET_BYTES))


def test_read_only_registers_do_not_take_what_is_written(bench):
    bench.bus.scan([FIRST, Transfer(A, bytes([ID, 0xFF, 0xFF, 0xFF]))])
    assert answer(bench, ID, 3) == IDENTITY


def test_results_are_the_field_in_the_chosen_ranges(bench):
    bench.configure(A)
    bench.wait_s(0.01)
    read_ut = field_ut(converted(bench).raw, Setup().range_mt(1))
    assert read_ut == pytest.approx(REST_UT, abs=1.3)


def test_a_field_beyond_the_range_is_clipped():
    made = Bench("ft232h", track=Track(np.array([0.0]), np.full((1, 6, 3), 5e5)))
    made.configure(A)
    made.wait_s(0.01)
    assert converted(made).raw == (32767,) * 3


def test_set_count_rolls_with_every_conversion_and_not_with_every_read(bench):
    bench.configure(A)
    bench.wait_s(0.0025)
    count = converted(bench).set_count
    assert converted(bench).set_count == count
    bench.wait_s(0.002425)
    assert converted(bench).set_count == (count + 1) % 8
    bench.wait_s(8 * 0.002425 - 0.0002)
    assert converted(bench).set_count in ((count + 1) % 8, count)


def test_the_mean_of_a_conversion_has_the_noise_of_the_data_sheet():
    made = Bench("ft232h", seed=1)
    made.configure(A)
    rows = []
    for _ in range(600):
        made.wait_s(0.0025)
        rows.append(converted(made).raw)
    spread = np.std(field_ut(rows, Setup().range_mt(1)), axis=0)
    assert spread == pytest.approx([22.1, 22.1, 12.0], rel=0.12)


def test_power_on_is_remembered_until_it_is_cleared(bench):
    bench.configure(A)
    status = REGISTERS["CONV_STATUS"].address
    bench.bus.scan([Transfer(A, bytes([status, 0x10]))])
    assert not answer(bench, status, 1)[0] & 0x10
    bench.hand.chips[0].power_on()
    assert answer(bench, status, 1)[0] & 0x10


def test_a_sleeping_chip_wakes_by_an_address_it_does_not_acknowledge(bench):
    bench.bus.scan([FIRST, Transfer(A, bytes([0x01, 0x01]))])
    assert answer(bench, ID, 1) == b""
    bench.wait_s(60e-6)
    assert answer(bench, ID, 1) == IDENTITY[:1]


def test_a_new_address_counts_from_the_stop_on_and_is_lost_with_power(bench):
    bench.bus.scan([FIRST, Transfer(A, bytes([0x0C, 0x36 << 1 | 1]))])
    old, new = bench.bus.scan([Transfer(A, b"\x0d", 1), Transfer(0x36, b"\x0d", 1)])
    assert (old.acked, new.acked) == (False, True)
    bench.hand.chips[0].power_on()
    assert answer(bench, ID, 1) == IDENTITY[:1]


def test_a_general_call_reaches_every_chip_on_joined_channels(bench):
    bench.bus.scan([BOTH, Transfer(0x00, bytes([0x02, 0x70]))])
    for channel, addresses in ((FIRST, (A, B, C, D)), (SECOND, (A, B))):
        reads = [Transfer(address, b"\x02", 1) for address in addresses]
        replies = bench.bus.scan([channel, *reads])[1:]
        assert [reply.data for reply in replies] == [b"\x70"] * len(addresses)


def test_a_triggered_conversion_comes_once(bench):
    bench.bus.scan([FIRST, Transfer(A, bytes([0x02, 0x70])), Transfer(A, b"\x80")])
    bench.wait_s(0.01)
    first = converted(bench)
    bench.wait_s(0.01)
    assert converted(bench).set_count == first.set_count
    assert first.raw[2] > 0


def test_one_byte_reads_answer_packets_instead_of_registers_and_can_be_left_by_a_write(
    bench,
):
    bench.configure(A, burst=True)
    bench.wait_s(0.01)
    assert answer(bench, ID, 3) != IDENTITY
    bench.bus.scan([Transfer(A, b"\x00\x00")])
    assert answer(bench, ID, 3) == IDENTITY


def test_two_chips_at_one_address_answer_together_and_zeros_win(bench):
    bench.bus.scan([FIRST, Transfer(A, bytes([0x04, 0b1100]))])
    bench.bus.scan([SECOND, Transfer(A, bytes([0x04, 0b1010]))])
    bench.bus.scan([BOTH])
    assert answer(bench, 0x04, 1) == bytes([0b1000])


# -- the bridge


def test_six_fingers_are_one_transfer_out_and_one_in_and_leave_400_scans_a_second(
    bench,
):
    bench.backend.traffic.transfers = 0
    before_ns = bench.clock.now_ns()
    assert all(reply.acked for reply in bench.bus.scan(SIX))
    assert bench.backend.traffic.transfers == 2
    assert bench.clock.now_ns() - before_ns < 1e9 / 400


def test_a_long_list_is_cut_where_a_packet_is_full(bench):
    replies = bench.bus.scan([FIRST, *[Transfer(A, b"\x00", 20)] * 60])
    assert all(len(reply.data) == 20 for reply in replies[1:])


def test_a_transfer_that_no_packet_can_answer_is_refused(bench):
    with pytest.raises(UsageError, match="do not fit"):
        bench.bus.scan([Transfer(A, b"\x00", 600)])


def test_a_bus_held_low_is_an_error_and_nine_clocks_free_it():
    made = Bench("ft232h", faults=[Fault("stuck", 0.0)])
    with pytest.raises(BusStuck):
        made.bus.scan([FIRST])
    made.bus.clear()
    assert made.bus.scan([FIRST, Transfer(A, b"\x0d", 1)])[1].acked


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
    for register, value in Setup().registers():
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
