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
from holdfast.drivers.virtual.tiny_usb import FIRMWARES
from holdfast.drivers.virtual.usb_device import stall


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
