"""The board's own I2C bus, MPSSE commands joined into one, and those that the FT232H takes."""

from __future__ import annotations

import errno
import os
from typing import Any

import pytest
from bridge_bench import ABSENT, FIRST, IDENTITY, WHO, A, B
from hypothesis import given, settings
from hypothesis import strategies as st
from virtual_i2c import VirtualI2cDev

from holdfast.core.errors import (
    AccessDenied,
    BusStuck,
    DeviceLost,
    DeviceNotFound,
    TransferFailed,
    UsageError,
)
from holdfast.drivers.bridges import open_bus
from holdfast.drivers.bus import NOT_ACKED, Reply, Transfer, freeing
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.native_i2c import NativeI2C
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.drivers.virtual.ft232h import IN_ENDPOINT, OUT_ENDPOINT, VirtualFt232h
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


def test_closing_the_board_s_bus_closes_its_file(make):
    bench = make("native")
    assert bench.backend.open_files == 1
    bench.bus.close()
    assert bench.backend.open_files == 0


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
    st.sampled_from([A, B, 0x70, ABSENT, 0x00]),
    st.binary(max_size=3),
    st.integers(0, 9),
)


@settings(max_examples=40)
@given(st.lists(TRANSFERS, min_size=1, max_size=6), st.booleans())
def test_commands_that_come_byte_by_byte_do_what_a_batch_does(transfers, held):
    outcomes = []
    for engine in (VirtualFt232h, OneByOne):
        clock = Still()
        hand = VirtualHand(clock)
        bus = Ft232h(VirtualBackend(engine(hand)))
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


@pytest.mark.parametrize("name", ["one", "-1", ""])
def test_a_bus_of_the_board_is_named_by_a_number(name: str) -> None:
    with pytest.raises(UsageError, match="not a bus number"):
        open_bus("i2c", name)


class Refusing(VirtualI2cDev):
    """The kernel refuses to open the file, or every transfer, with an error of this number."""

    opens = transfers = 0

    def open(self, number: int) -> Any:
        if self.opens:
            raise OSError(self.opens, os.strerror(self.opens))
        return super().open(number)

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


# -- the emulated FT232H, command by command


TALKS = {
    "a mux and a chip": """
set:b,200 - 0 0
set:9,1 - 0 0
w:800303800103800003110000e08002032200110000018002032200800003800103800303 - 128333 20
r:64 32600000 1125000 0
w:8003038001038000031100006a80020322001100000d8002032200 - 128167 19
w:8003038003038001038000031100006b8002032200 - 126667 10
r:64 3260000000 1125000 0
w:20000087 - 126500 9
r:64 326001 125000 0
w:1300008002032000008713007f200000 - 128000 18
r:64 32604954 125000 0
w:13008020000087 - 126500 9
r:64 3260ff 125000 0
w:800003800103800303 - 125167 1
w:8003038001038000031100002380020322002000002200800003800103800303220087 - 128333 20
r:64 326001ff0307 125000 0
""",
    "a chip holds SDA low": """
set:b,200 - 0 0
set:9,1 - 0 0
hold: - 0 0
w:81 - 125000 0
w:80030380010380000387 - 125000 0
w:110000e022002000002200810087 - 128000 18
r:64 32600300ff0000fa00 125000 0
hold: - 0 0
w:8002038003038103 - 125167 1
w:800203800303 - 125167 1
w:8002038003038002038003038002038003038002 - 125500 3
w:03800303800203800303800203800303800203800303800203800303 - 125667 4
w:8187 - 125000 0
r:64 326003fa0307 125000 0
hold: - 0 0
w:20030081 - 130667 34
w:13008081 - 125000 0
w:20000081 - 126500 9
w:110000e081 - 126500 9
r:64 32600000ffff0606ff0600 1125000 0
""",
    "packets of 512 bytes": """
set:b,200 - 0 0
set:9,1 - 0 0
w:20fd0187 - 890000 4590
r:600 3260ffff..514 125000 0
w:20fc0187 - 888500 4581
r:1024 3260ffff..511 125000 0
w:20fd0187 - 890000 4590
r:512 3260ffff..512 125000 0
w:20fe0187 - 891500 4599
r:1024 3260ffff..515 125000 0
w:20fe0187 - 891500 4599
r:512 3260ffff..512 125000 0
r:512 3260ff 125000 0
w:20ff0387 - 1661000 9216
r:515 3260ffff..515 125000 0
r:514 3260ffff..514 125000 0
r:513 3260ffffff 125000 0
""",
}
"""What is done, what it answers, how many ns it takes, and the bits that it moves on the wire.

set: a control request, and its value. w: commands (FTDI AN 108). r: the largest
number of bytes that are read; of more than 50 the first four are shown, then how many came. hold:
a chip holds SDA low."""


def said(device: VirtualFt232h, act: str, given: str) -> bytes:
    """One act of TALKS."""
    if act == "set":
        request, value = (int(one, 16) for one in given.split(","))
        device.control_out(request, value)
    elif act == "w":
        device.write(OUT_ENDPOINT, bytes.fromhex(given))
    elif act == "r":
        return device.read(IN_ENDPOINT, int(given))
    else:
        device.hand.wire.hold_low()
    return b""


def shown(device: VirtualFt232h, act: str, given: str) -> str:
    """Its answer as TALKS have it."""
    answer = said(device, act, given).hex() or "-"
    many = f"{answer[:8]}..{len(answer) // 2}"
    return many if len(answer) > 100 else answer


@pytest.mark.parametrize("subject", TALKS)
def test_the_emulated_ft232h_answers_each_command_with_these_bytes_in_this_time(
    subject,
):
    device = VirtualFt232h(VirtualHand(VirtualClock()))
    wire, clock = device.hand.wire, device.hand.clock
    for line in TALKS[subject].strip().split("\n"):
        act, _, given = line.split()[0].partition(":")
        bits, begun_ns = wire.bits, clock.now_ns()
        answer = shown(device, act, given)
        took_ns = clock.now_ns() - begun_ns
        assert f"{act}:{given} {answer} {took_ns} {wire.bits - bits}" == line
