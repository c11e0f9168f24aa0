"""Every bridge on USB: claims, descriptors, names, and what a failed open gives back."""

from __future__ import annotations

import errno
import struct

import pytest
import usb.core
from bridge_bench import (
    FIRST,
    IDENTITY,
    WHO,
    every_usb_bridge,
)

from holdfast.core.errors import AccessDenied, DeviceNotFound, TransferFailed
from holdfast.drivers.mcp2221 import Mcp2221
from holdfast.drivers.tiny_usb import TinyUsb
from holdfast.drivers.virtual.faults import Fault
from holdfast.drivers.virtual.usb_backend import VirtualBackend


@every_usb_bridge
def test_a_kernel_driver_is_away_while_a_bridge_is_open_and_back_afterwards(make, kind):
    bench = make(kind)
    interface = 2 if kind == "mcp2221" else 0
    assert not bench.backend.is_kernel_driver_active(None, interface)
    bench.bus.close()
    assert bench.backend.is_kernel_driver_active(None, interface)


@every_usb_bridge
def test_a_bridge_that_is_open_cannot_be_opened_again_until_it_is_closed(make, kind):
    bench = make(kind)
    with pytest.raises(AccessDenied, match="busy"):
        bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_a_second_claim_fails_as_with_libusb_and_another_interface_is_free(make):
    backend = make("mcp2221").backend
    found = next(backend.enumerate_devices())
    second = backend.open_device(found)
    with pytest.raises(usb.core.USBError) as refused:
        backend.claim_interface(second, 2)
    assert (refused.value.errno, refused.value.backend_error_code) == (errno.EBUSY, -6)
    with pytest.raises(usb.core.USBError, match="busy"):
        backend.bulk_write(second, 0x03, 2, bytes(64), 10)
    backend.detach_kernel_driver(second, 0)
    backend.claim_interface(second, 0)
    backend.claim_interface(second, 0)


def test_only_a_request_for_an_interface_that_is_no_vendor_s_claims_it(make):
    backend = make("stm32").backend
    second = backend.open_device(next(backend.enumerate_devices()))
    set_delay = 2
    assert backend.ctrl_transfer(second, 0x41, set_delay, 10, 0, b"", 10) == 0
    with pytest.raises(usb.core.USBError, match="busy"):
        backend.ctrl_transfer(second, 0x21, set_delay, 10, 0, b"", 10)


def test_a_bridge_that_is_unplugged_takes_the_power_away_once(make):
    bench = make("stm32", faults=[Fault("unplug", 1, 1), Fault("unplug", 3, 1)])
    off = []
    backend = VirtualBackend(
        bench.device, bench.clock, bench.hand.faults, lambda: off.append(1)
    )
    counted = []
    for now_s in (0.5, 1.2, 1.8, 2.5, 3.2, 3.8):
        bench.clock.wait_until(round(1e9 * now_s))
        list(backend.enumerate_devices())
        counted.append(len(off))
    assert counted == [0, 1, 1, 1, 2, 2]


def test_a_handle_that_is_closed_or_unplugged_claims_nothing_any_more(make):
    bench = make("stm32", faults=[Fault("unplug", 1, 1)])
    bench.bus.close()
    first, second = (
        bench.backend.open_device(next(bench.backend.enumerate_devices()))
        for _ in range(2)
    )
    bench.backend.detach_kernel_driver(first, 0)
    bench.backend.claim_interface(first, 0)
    bench.backend.close_device(first)
    bench.backend.claim_interface(second, 0)
    bench.clock.wait_until(1_500_000_000)
    assert list(bench.backend.enumerate_devices()) == []
    bench.clock.wait_until(2_500_000_000)
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@pytest.mark.parametrize(
    ("kind", "strings"),
    [
        ("ft232h", ("FTDI", "Single RS232-HS", "FTHOLD01")),
        ("rp2040", ("Till Harbaum", "i2c-tiny-usb", "HOLDFAST-RP2040")),
        (
            "mcp2221",
            ("Microchip Technology Inc.", "MCP2221 USB-I2C/UART Combo", "0000000001"),
        ),
    ],
)
def test_a_bridge_shows_its_maker_its_product_and_its_serial_number(
    make, kind, strings
):
    found = usb.core.find(backend=make(kind).backend)
    assert (found.manufacturer, found.product, found.serial_number) == strings


@every_usb_bridge
def test_descriptors_by_request_are_those_that_libusb_shows(make, kind):
    bench = make(kind)
    found = usb.core.find(backend=bench.backend)
    device = bytes(found.ctrl_transfer(0x80, 6, 0x0100, 0, 64))
    assert (len(device), device[0]) == (18, 18)
    configuration = bytes(found.ctrl_transfer(0x80, 6, 0x0200, 0, 255))
    assert len(configuration) == found[0].wTotalLength
    kinds = []
    at = 0
    while at < len(configuration):
        kinds.append(configuration[at + 1])
        at += configuration[at]
    assert at == len(configuration)
    assert (kinds.count(4), kinds.count(5)) == (
        found[0].bNumInterfaces,
        sum(i.bNumEndpoints for i in found[0]),
    )
    with pytest.raises(usb.core.USBError):
        found.ctrl_transfer(0x80, 6, 0x03FF, 0, 64)


def test_the_mcp2221_announces_a_hid_interface_of_64_bytes_each_way(make):
    bench = make("mcp2221")
    bench.bus.close()
    found = usb.core.find(backend=bench.backend)
    found.detach_kernel_driver(2)
    interface = found[0][(2, 0)]
    assert (interface.bInterfaceClass, [e.wMaxPacketSize for e in interface]) == (
        3,
        [64, 64],
    )
    length, kind, _, _, _, report_kind, report_length = struct.unpack(
        "<BBHBBBH", bytes(interface.extra_descriptors)
    )
    assert (length, kind, report_kind) == (9, 0x21, 0x22)
    report = bytes(found.ctrl_transfer(0x80 | 1, 6, 0x2200, 2, 255))
    assert len(report) == report_length
    assert report.startswith(b"\x06\x00\xff\x09\x01")  # usage page 0xFF00, usage 1
    assert report.count(b"\x95\x40") == 1  # 64 bytes a report


def test_no_bridge_on_usb_is_named_with_its_ids(make):
    bench = make("mcp2221")
    with pytest.raises(DeviceNotFound, match="0403:c631 or 1c40:0534"):
        TinyUsb(bench.backend)
    with pytest.raises(DeviceNotFound, match="04d8:00dd"):
        Mcp2221(make("avr").backend)


@every_usb_bridge
def test_a_bridge_that_does_not_open_is_given_back(make, kind):
    bench = make(kind, faults=[Fault("stall", 1, 1)])
    bench.clock.wait_until(1_500_000_000)
    bench.bus.close()
    with pytest.raises(TransferFailed):
        bench.open()
    assert bench.backend.is_kernel_driver_active(None, 2 if kind == "mcp2221" else 0)
    bench.clock.wait_until(2_500_000_000)
    bench.bus = bench.open()
