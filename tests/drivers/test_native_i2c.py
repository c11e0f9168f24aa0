"""The board's own I2C bus, SMBus calls on it, and commands joined into one."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import smbus2
from bridge_bench import (
    ABSENT,
    FIRST,
    ID,
    IDENTITY,
    THRESHOLD,
    WHO,
    A,
    B,
)
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.errors import AccessDenied, BusStuck, DeviceNotFound
from holdfast.drivers.bus import NOT_ACKED, Reply, Transfer
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.native_i2c import NativeI2C
from holdfast.drivers.tmag5273 import GENERAL_CALL
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.ft232h import VirtualFt232h
from holdfast.drivers.virtual.native import VirtualI2cDev
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.virtual_hand import VirtualHand


@pytest.mark.parametrize("number", [errno.EREMOTEIO, errno.ENXIO])
def test_controllers_say_in_two_ways_that_no_chip_acknowledged(number):
    hand = VirtualHand(VirtualClock())
    with VirtualI2cDev(hand, 7, nack_errno=number):
        bus = NativeI2C(7)
        assert bus.scan([FIRST, Transfer(ABSENT, b"\0", 3), WHO])[1:] == [
            NOT_ACKED,
            Reply(IDENTITY, acked=True),
        ]
        bus.close()


def test_a_bus_that_is_absent_and_one_that_is_forbidden_have_different_errors():
    hand = VirtualHand(VirtualClock())
    with VirtualI2cDev(hand, 7, readable=False):
        with pytest.raises(AccessDenied):
            NativeI2C(7)
        with pytest.raises(DeviceNotFound):
            NativeI2C(987654)


def test_closing_the_board_s_bus_closes_its_file(make):
    bench = make("native")
    assert bench.backend.open_files == 1
    bench.bus.close()
    assert bench.backend.open_files == 0


@pytest.fixture
def smbus(make) -> Iterator[Any]:
    """smbus2's own bus on the virtual controller, the mux's first channel on."""
    make("native")
    with smbus2.SMBus(1) as bus:
        bus.write_byte(0x70, 1)
        yield bus


def test_smbus_calls_read_and_write_registers(smbus):
    smbus.write_byte_data(A, THRESHOLD, 0x5A)
    assert smbus.read_byte_data(A, THRESHOLD) == 0x5A
    smbus.write_word_data(A, THRESHOLD, 0x1234)
    assert smbus.read_word_data(A, THRESHOLD) == 0x1234
    assert smbus.read_i2c_block_data(A, THRESHOLD, 2) == [0x34, 0x12]
    smbus.write_i2c_block_data(A, THRESHOLD, [1, 2, 3])
    assert smbus.read_i2c_block_data(A, THRESHOLD, 3) == [1, 2, 3]
    assert bytes(smbus.read_i2c_block_data(A, ID, 3)) == IDENTITY


def test_smbus_calls_without_a_register_read_on_and_ask_whether_a_chip_is_there(smbus):
    smbus.write_byte(A, ID)
    assert [smbus.read_byte(A) for _ in range(3)] == list(IDENTITY)
    smbus.write_quick(A)
    with pytest.raises(OSError, match=os.strerror(errno.EREMOTEIO)):
        smbus.write_quick(ABSENT)
    assert smbus.read_byte(0x70) == 1


def test_a_block_is_written_with_its_length_and_a_process_call_reads_two_bytes(smbus):
    smbus.write_block_data(A, THRESHOLD, [7, 8])
    assert smbus.read_i2c_block_data(A, THRESHOLD, 3) == [2, 7, 8]
    smbus.write_i2c_block_data(A, THRESHOLD + 2, [0x56, 0x78])
    assert smbus.process_call(A, THRESHOLD, 0x1234) == 0x7856
    assert smbus.read_word_data(A, THRESHOLD) == 0x1234


def test_what_needs_a_length_from_the_chip_is_refused_as_by_a_controller_of_plain_i2c(
    smbus,
):
    assert not smbus.funcs & (
        smbus2.I2cFunc.SMBUS_READ_BLOCK_DATA | smbus2.I2cFunc.SMBUS_BLOCK_PROC_CALL
    )
    for call in (
        lambda: smbus.read_block_data(A, ID),
        lambda: smbus.block_process_call(A, ID, [1]),
    ):
        with pytest.raises(OSError, match=os.strerror(errno.EOPNOTSUPP)):
            call()
    with pytest.raises(OSError, match=os.strerror(errno.EINVAL)):
        smbus.read_i2c_block_data(A, ID, 0)
    with pytest.raises(OSError, match=os.strerror(errno.EINVAL)):
        smbus.read_byte(0x80)


def test_an_smbus_read_is_one_transfer_with_a_repeated_start(make):
    bench = make("native")
    with smbus2.SMBus(1) as bus:
        bus.write_byte(0x70, 1)
        bits, transfers = bench.hand.wire.bits, bench.backend.traffic.transfers
        bus.read_byte_data(A, ID)
    assert bench.backend.traffic.transfers - transfers == 1
    assert bench.hand.wire.bits - bits == 1 + 9 + 9 + 1 + 9 + 9 + 1


def test_the_shim_leaves_smbus2_as_it_was():
    module = sys.modules["smbus2.smbus2"]
    before = (vars(module)["os"], vars(module)["ioctl"])
    with VirtualI2cDev(VirtualHand(VirtualClock())):
        assert vars(module)["ioctl"] is not before[1]
    assert (vars(module)["os"], vars(module)["ioctl"]) == before


def test_the_controller_refuses_a_read_that_is_not_the_last_message():
    smbus2 = sys.modules["smbus2"]
    hand = VirtualHand(VirtualClock())
    with VirtualI2cDev(hand):
        bus = smbus2.SMBus(1)
        with pytest.raises(OSError, match="supported"):
            bus.i2c_rdwr(smbus2.i2c_msg.read(A, 1), smbus2.i2c_msg.write(A, [0]))
        bus.close()


class OneByOne(VirtualFt232h):
    """An engine that gets every command in a transfer of its own."""

    def write(self, endpoint: int, data: bytes) -> None:
        for k in range(len(data)):
            super().write(endpoint, data[k : k + 1])


class Still(VirtualClock):
    """Nothing takes time."""

    def spend(self, duration_ns: int) -> None:
        """None passes."""


TRANSFERS = st.builds(
    Transfer,
    st.sampled_from([A, B, 0x70, ABSENT, GENERAL_CALL]),
    st.binary(max_size=3),
    st.integers(0, 9),
)


@given(st.lists(TRANSFERS, min_size=1, max_size=6), st.booleans())
def test_commands_that_are_joined_do_what_each_alone_does(transfers, held):
    outcomes = []
    for engine in (VirtualFt232h, OneByOne):
        clock = Still()
        hand = VirtualHand(clock)
        bus = Ft232h(VirtualBackend(engine(hand), clock, hand.faults, hand.power_off))
        if held:
            hand.wire.hold_low()
        bits = hand.wire.bits
        try:
            replies: object = bus.scan([FIRST, *transfers, WHO])
        except BusStuck as error:
            replies = str(error)
        outcomes.append(
            (
                replies,
                hand.wire.bits - bits,
                [bytes(chip._bytes) for chip in hand.chips],
            )
        )
    assert outcomes[0] == outcomes[1]
