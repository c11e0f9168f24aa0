"""I2C-tiny-usb with four firmwares: what each does in its own way."""

from __future__ import annotations

import pytest
from bridge_bench import (
    ABSENT,
    FIRST,
    ID,
    IDENTITY,
    SECOND,
    WHO,
    A,
    C,
    every_firmware,
)

from holdfast.core.errors import TransferFailed
from holdfast.drivers.bus import NOT_ACKED, Reply, Transfer
from holdfast.drivers.tmag5273 import REGISTERS
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.tiny_usb import FIRMWARES, VirtualTinyUsb
from holdfast.drivers.virtual.usb_device import stall
from holdfast.drivers.virtual.virtual_hand import VirtualHand


@every_firmware
def test_tiny_usb_sets_100_khz_when_it_opens_and_after_a_reset(make, kind):
    bench = make(kind)
    assert bench.device.delay_us == 10
    bench.device.delay_us = 50
    bench.bus.clear()
    assert bench.device.delay_us == 10


def test_stale_data_of_the_rp2040_firmware_are_never_a_reply(make):
    bench = make("rp2040")
    bench.bus.scan([FIRST, WHO])
    raw = bench.backend.device.control_in(0xC1, 7, 1, ABSENT, 3)
    assert raw == IDENTITY  # what the firmware says of a chip that is not there
    for transfer in (Transfer(ABSENT, read=3), Transfer(ABSENT, bytes([ID]), 3)):
        assert bench.bus.scan([WHO, transfer, WHO])[1] == NOT_ACKED


@pytest.mark.parametrize(
    ("kind", "answer"), [("avr", b"\0\0\0"), ("rp2040", IDENTITY), ("stm32", b"")]
)
def test_firmwares_answer_a_missing_chip_each_in_its_own_way(make, kind, answer):
    bench = make(kind)
    bench.bus.scan([FIRST, WHO])
    assert bench.backend.device.control_in(0xC1, 7, 1, ABSENT, 3) == answer


@every_firmware
def test_a_chip_that_stops_answering_between_write_and_read_is_not_acked(make, kind):
    """It falls asleep with the write, so the read wakes it and is not acknowledged."""
    bench = make(kind)
    config = REGISTERS["DEVICE_CONFIG_2"]
    asleep = Transfer(A, bytes([config.address, config.value(OPERATING_MODE=1)]), 3)
    assert bench.bus.scan([FIRST, asleep])[1] == NOT_ACKED


@every_firmware
def test_tiny_usb_says_that_a_transfer_is_too_long(make, kind):
    for transfer in (Transfer(A, bytes(65)), Transfer(A, b"\0", 65)):
        with pytest.raises(TransferFailed, match="65 bytes"):
            make(kind).bus.scan([FIRST, transfer])


@every_firmware
def test_a_firmware_takes_its_largest_message_and_stalls_at_a_byte_more(make, kind):
    bench = make(kind)
    bench.bus.scan([FIRST])
    largest = FIRMWARES[kind].largest
    assert len(bench.device.control_in(0xC1, 7, 1, A, largest)) == largest
    with pytest.raises(type(stall())):
        bench.device.control_in(0xC1, 7, 1, A, largest + 1)


def test_a_firmware_that_swings_the_pins_itself_makes_no_second_start(make):
    device = make("avr").device
    device.control_out(0x41, 4 | 1, 0, 0x70, b"\1")
    device.control_out(0x41, 4 | 1 | 2, 0, ABSENT, b"\2")
    assert (
        device.control_in(0xC1, 3, 0, 0, 1) == b"\1"
    )  # the mux took the address for data


@every_firmware
def test_tiny_usb_brings_out_the_stop_that_a_failure_kept_back(make, kind):
    bench = make(kind)
    bench.bus.scan([FIRST])
    spoilt = bench.device._read
    bench.device._read = lambda request, address, length: (_ for _ in ()).throw(stall())
    with pytest.raises(TransferFailed):
        bench.bus.scan([WHO])
    bench.device._read = spoilt
    assert bench.bus.scan([SECOND, Transfer(C, bytes([ID]), 3), WHO])[1:] == [
        NOT_ACKED,
        Reply(IDENTITY, acked=True),
    ]


@every_firmware
def test_tiny_usb_reports_that_fewer_bytes_came_than_were_requested(make, kind):
    bench = make(kind)
    spoilt = bench.device._read
    bench.device._read = lambda *values: spoilt(*values)[:-1]
    with pytest.raises(TransferFailed, match="2 of 3 bytes"):
        bench.bus.scan([FIRST, WHO])


# -- the four emulated firmwares, request by request


TALK = """
in:0,a55a,0,2 5aa5/0 5aa5/0 5aa5/0 5aa5/0
in:0,a55a,0,1 5a/0 5a/0 5a/0 5a/0
in:1,0,0,4 0900ff0e/0 0900ff0e/0 0900ff0e/0 0900ff0e/0
in:1,0,0,3 0900ff/0 0900ff/0 0900ff/0 0900ff/0
in:3,0,0,1 00/0 00/0 00/0 00/0
in:3,0,0,0 -/0 -/0 -/0 -/0
in:2,0,0,1 stall/0 stall/0 stall/0 stall/0
in:8,1,0,1 stall/0 stall/0 stall/0 stall/0
in:4,0,35,1 stall/0 stall/0 stall/0 stall/0
out:2,32,0 -/0 -/0 -/0 -/0
out:2,a,0,00 stall/0 stall/0 stall/0 stall/0
out:1,0,0 stall/0 stall/0 stall/0 stall/0
out:8,0,70,01 stall/0 stall/0 stall/0 stall/0
out:7,1,70,01 stall/0 stall/0 stall/0 stall/0
out:7,0,70,01 -/20 -/20 -/20 -/20
in:3,0,0,1 01/0 01/0 01/0 01/0
in:7,1,70,2 0101/29 0101/29 0101/29 0101/29
out:5,0,35,0d -/19 -/19 -/19 -/19
in:3,0,0,1 01/0 01/0 01/0 01/0
in:6,1,35,3 014954/38 014954/38 014954/38 014954/38
in:3,0,0,1 01/0 01/0 01/0 01/0
in:7,1,11,3 000000/11 014954/11 -/11 stall/11
in:3,0,0,1 02/0 02/0 02/0 02/0
out:7,0,11,0102 -/11 -/11 -/11 stall/11
in:3,0,0,1 02/0 02/0 02/0 02/0
out:7,0,35 -/11 -/20 -/11 -/11
in:3,0,0,1 01/0 01/0 01/0 01/0
out:7,0,11 -/11 -/11 -/11 stall/11
in:3,0,0,1 02/0 02/0 02/0 02/0
out:7,0,20,00 -/20 -/20 -/20 -/20
in:3,0,0,1 01/0 01/0 01/0 01/0
out:7,0,20,00ff00 -/38 -/38 -/38 stall/38
in:3,0,0,1 01/0 02/0 02/0 01/0
out:5,0,20,00ffff -/37 -/38 -/38 stall/38
out:6,0,70,01 -/20 -/20 -/20 -/20
in:7,1,70,1 01/20 01/20 01/20 01/20
out:5,0,70,03 -/19 -/19 -/19 -/19
out:6,0,70,01 -/20 -/20 -/20 -/20
in:7,1,70,1 01/20 01/20 01/20 01/20
out:5,0,70,02 -/19 -/19 -/19 -/19
out:7,0,11,04 -/19 -/11 -/11 -/19
in:3,0,0,1 01/0 02/0 02/0 01/0
in:7,1,70,1 04/20 02/20 02/20 04/20
out:7,0,70,01 -/20 -/20 -/20 -/20
in:5,1,35,2 0000/28 0000/28 0000/28 0000/28
out:6,0,35,00 -/20 -/20 -/20 -/20
in:3,0,0,1 01/0 01/0 01/0 01/0
out:5,0,35,0d -/19 -/19 -/19 -/19
in:5,1,35,1 ff/18 01/19 01/19 ff/18
out:4,0,35,00 -/19 -/19 -/19 -/19
out:4,0,35 -/10 -/19 -/10 -/10
out:6,0,35,00 -/20 -/20 -/20 -/20
in:3,0,0,1 01/0 01/0 01/0 01/0
hold:- -/0 -/0 -/0 -/0
out:7,0,70,01 -/21 -/11 -/11 stall/21
in:3,0,0,1 01/0 02/0 02/0 01/0
in:7,1,70,1 01/20 01/11 -/11 01/20
in:3,0,0,1 01/0 02/0 02/0 01/0
hold:- -/0 -/0 -/0 -/0
in:7,1,70,1 ff/21 01/11 -/11 ff/21
hold:- -/0 -/0 -/0 -/0
out:5,0,70,05 -/20 -/11 -/11 stall/21
in:6,1,70,1 01/20 01/11 -/11 01/20
free:- -/0 -/0 -/0 -/0
in:7,1,70,1 01/20 01/20 01/20 01/20
out:7,0,35,LONG -/2297 -/2297 -/587 -/587
in:7,1,35,LONG 00000000..254/2297 00000000..254/2297 00000000..64/587 00000000..64/587
out:7,0,35,LONGER stall/0 stall/0 stall/0 stall/0
in:7,1,35,LONGER stall/0 stall/0 stall/0 stall/0
"""
"""A request, and for each of FIRMWARES its answer and the bits that it moves on the wire.

in: request, value, index (the address of a chip) and length. out: request, value, index and data.
hold: a chip holds SDA low; free: none does. LONG is the largest message of the firmware, LONGER has
a byte more; of more than ten bytes the first four are shown, then how many came."""
TIMES_NS = {
    "avr": (3_000_000, 20_000),
    "rp2040": (350_000, 2_500),
    "stm32": (350_000, 2_500),
    "pico": (350_000, 10_000),
}
"""Of a control transfer, and of a bit."""


class Deaf:
    """A chip at 0x20 that acknowledges its address and one byte."""

    def addressed(self, address: int, *, read: bool) -> bool:
        self.left = 1
        return address == 0x20

    def write(self, byte: int) -> bool:
        self.left -= 1
        return self.left >= 0

    def read(self) -> int:
        return 0xFF

    def stop(self) -> None:
        """Nothing ends."""


def bytes_of(device: VirtualTinyUsb, given: list[str]) -> bytes:
    """The data of an `out` of TALK."""
    longest = device.firmware.largest
    data = "".join(given)
    lengths = {"LONG": longest, "LONGER": longest + 1}
    return bytes(lengths[data]) if data in lengths else bytes.fromhex(data)


def answer_of(device: VirtualTinyUsb, act: str, given: str) -> str:
    """What it says to a line of TALK."""
    request, value, index, *rest = given.split(",")
    asked = (int(request, 16), int(value, 16), int(index, 16))
    try:
        if act == "out":
            device.control_out(0x41, *asked, bytes_of(device, rest))
            return "-"
        length = len(bytes_of(device, rest)) if "L" in rest[0] else int(rest[0])
        answer = device.control_in(0xC1, *asked, length).hex() or "-"
    except type(stall()):
        return "stall"
    return f"{answer[:8]}..{len(answer) // 2}" if len(answer) > 20 else answer


@pytest.mark.parametrize("column", range(4))
def test_an_emulated_firmware_answers_each_request_with_these_bytes_in_this_time(
    column,
):
    kind = list(FIRMWARES)[column]
    device = VirtualTinyUsb(VirtualHand(VirtualClock()), kind)
    wire, clock = device.hand.wire, device.hand.clock
    wire.targets.append(Deaf())
    acts = {"hold": wire.hold_low, "free": wire.power_on}
    transfer_ns, bit_ns = TIMES_NS[kind]
    for line in TALK.strip().split("\n"):
        request, *answers = line.split()
        act, _, given = request.partition(":")
        bits, begun_ns = wire.bits, clock.now_ns()
        if act in acts:
            acts[act]()
            continue
        moved = f"{answer_of(device, act, given)}/{wire.bits - bits}"
        assert [request, moved] == [request, answers[column]]
        took_ns = clock.now_ns() - begun_ns
        assert took_ns == transfer_ns + bit_ns * (wire.bits - bits)
    assert device.delay_us == 0x32
    with pytest.raises(type(stall())):
        device.control_out(0xC1, 2, 0, 0, b"")
    with pytest.raises(type(stall())):
        device.control_in(0x41, 3, 0, 0, 1)
    device.reset()
    assert (device.delay_us, answer_of(device, "in", "3,0,0,1")) == (10, "00")


@pytest.mark.parametrize(
    ("status", "says"), [(b"\7", "the status is 07,"), (b"", "the status is empty,")]
)
def test_a_status_that_says_neither_is_shown(make, status, says):
    bench = make("stm32")
    answer = bench.device.control_in
    bench.device.control_in = lambda *given: status if given[1] == 3 else answer(*given)
    with pytest.raises(TransferFailed, match=says):
        bench.bus.scan([FIRST])
