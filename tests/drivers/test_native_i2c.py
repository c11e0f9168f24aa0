"""The board's own I2C bus, and MPSSE commands joined into one."""

from __future__ import annotations

import errno
import os
import sys

import pytest
from bridge_bench import (
    ABSENT,
    FIRST,
    IDENTITY,
    WHO,
    A,
    B,
)
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.errors import (
    AccessDenied,
    BusStuck,
    DeviceLost,
    DeviceNotFound,
    LibraryMissing,
    TransferFailed,
    UsageError,
)
from holdfast.drivers.bridges import open_bus
from holdfast.drivers.bus import NOT_ACKED, Reply, Transfer, freeing
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


def test_the_controller_takes_42_messages_at_once_and_no_more():
    smbus2 = sys.modules["smbus2"]
    with VirtualI2cDev(VirtualHand(VirtualClock())):
        bus = smbus2.SMBus(1)
        message = smbus2.i2c_msg.write(0x70, [1])
        bus.i2c_rdwr(*[message] * 42)
        with pytest.raises(OSError, match="argument"):
            bus.i2c_rdwr(*[message] * 43)
        bus.close()


def test_a_message_with_another_flag_is_written_and_not_read():
    smbus2 = sys.modules["smbus2"]
    with VirtualI2cDev(VirtualHand(VirtualClock())) as device:
        bus = smbus2.SMBus(1)
        message = smbus2.i2c_msg.write(0x70, [1])
        message.flags |= 0x1000  # I2C_M_IGNORE_NAK
        bus.i2c_rdwr(message)
        bus.close()
        assert (device.traffic.bytes_out, device.traffic.bytes_in) == (1, 0)


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
def test_commands_that_come_byte_by_byte_do_what_a_batch_does(transfers, held):
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


@pytest.mark.parametrize("name", ["one", "-1", "", "1" * 40])
def test_a_bus_of_the_board_is_named_by_a_number(name: str) -> None:
    with pytest.raises(UsageError, match="not a bus number"):
        open_bus("i2c", name)


def test_a_bus_that_the_board_does_not_have_is_not_found() -> None:
    with pytest.raises((DeviceNotFound, LibraryMissing)):
        open_bus("i2c", "987")


class Refusing(VirtualI2cDev):
    """The kernel refuses to open the file, or every transfer, with an error of this number."""

    opens = transfers = 0

    def open(self, path: str, flags: int) -> int | None:
        if self.opens:
            raise OSError(self.opens, os.strerror(self.opens))
        return super().open(path, flags)

    def _suffer(self) -> None:
        if self.transfers:
            raise OSError(self.transfers, os.strerror(self.transfers))


@pytest.mark.parametrize(
    ("opens", "transfers", "error", "says"),
    [
        (errno.EACCES, 0, AccessDenied, "group i2c"),
        (errno.EPERM, 0, AccessDenied, "group i2c"),
        (errno.ENOENT, 0, DeviceNotFound, "no /dev/i2c-1"),
        (errno.ENODEV, 0, DeviceNotFound, "no /dev/i2c-1"),
        (errno.ENXIO, 0, DeviceNotFound, "no /dev/i2c-1"),
        (errno.EIO, 0, TransferFailed, "cannot be opened: Input/output error"),
        (0, errno.ETIMEDOUT, BusStuck, "SDA or SCL is held low"),
        (0, errno.ENODEV, DeviceLost, "no longer there"),
        (0, errno.ENOENT, DeviceLost, "no longer there"),
        (0, errno.EIO, TransferFailed, "a transfer failed: Input/output error"),
        (0, errno.EHOSTDOWN, TransferFailed, "a transfer failed: Host is down"),
    ],
)
def test_each_error_of_the_kernel_has_its_own(opens, transfers, error, says):
    with Refusing(VirtualHand(VirtualClock())) as device:
        device.opens, device.transfers = opens, transfers
        with pytest.raises(error) as raised:
            NativeI2C(1).scan([FIRST])
    assert type(raised.value) is error
    assert str(raised.value).startswith("i2c-1: ")
    assert says in str(raised.value)


def test_the_kernel_carries_8192_bytes_in_a_message(make):
    bus = make("native").bus
    assert bus.scan([Transfer(ABSENT, bytes(8192))]) == [NOT_ACKED]
    with pytest.raises(TransferFailed, match=r"8193 bytes.*at most 8192"):
        bus.scan([Transfer(ABSENT, bytes(8193))])


def test_a_bus_number_has_nine_digits_at_most():
    with pytest.raises(DeviceNotFound):
        open_bus("i2c", "9" * 9)
    with pytest.raises(UsageError):
        open_bus("i2c", "9" * 10)


def test_a_bus_that_is_held_low_is_cleared_nine_times_at_most():
    class Stuck:
        name, held, cleared = "stuck", 9, 0

        def clear(self) -> None:
            self.cleared += 1
            self.held -= 1

        def act(self) -> str:
            if self.held:
                raise BusStuck("held low", where=self.name)
            return "done"

    bus = Stuck()
    assert (freeing(bus, bus.act), bus.cleared) == ("done", 9)
    bus.held = 10
    with pytest.raises(BusStuck):
        freeing(bus, bus.act)
    assert bus.cleared == 18
