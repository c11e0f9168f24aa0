"""Every bridge when something fails: a transfer, a late reply, an unplugged cable, a bus that is
held low."""

from __future__ import annotations

from array import array
from typing import Any

import pytest
import usb.core
from bridge_bench import (
    ABSENT,
    FIRST,
    IDENTITY,
    SIX,
    THRESHOLD,
    WHO,
    A,
    B,
    every_bridge,
    every_usb_bridge,
)

from holdfast.core.errors import BusStuck, DeviceLost, DeviceNotFound, TransferFailed
from holdfast.drivers.bus import Reply, Transfer
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.faults import Fault, Faults
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.usb_device import Device


@every_bridge
@pytest.mark.parametrize("fault", ["stall", "late", "short"])
@pytest.mark.parametrize("during", [0.0, 0.3, 0.6, 0.9])
def test_a_bridge_that_fails_says_so_and_the_next_scan_is_right(
    make, kind, fault, during
):
    """during: how far into a scan it begins, as a part of one."""
    healthy = make(kind)
    begun_ns = healthy.clock.now_ns()
    healthy.bus.scan(SIX)
    scan_s = 1e-9 * (healthy.clock.now_ns() - begun_ns)
    bench = make(kind, faults=[Fault(fault, 1 + during * scan_s, 0.5)])
    bench.clock.wait_until(1_000_000_000)
    before = [FIRST, WHO, *SIX[2:5], Transfer(A, bytes([THRESHOLD]), 1), *SIX[5:]]
    expected = BusStuck if (kind, fault) == ("native", "late") else TransferFailed
    with pytest.raises(expected):
        bench.bus.scan(before)
    bench.clock.wait_until(3_000_000_000)
    for _ in range(2):
        assert bench.bus.scan([FIRST, WHO, Transfer(B, bytes([THRESHOLD]), 1)])[1:] == [
            Reply(IDENTITY, acked=True),
            Reply(b"\0", acked=True),
        ]


@every_usb_bridge
def test_a_late_reply_never_answers_the_next_question(make, kind):
    """Registers hold their own number, so that a reply says which question it answers."""
    numbered = [Transfer(A, bytes([register, register])) for register in range(4, 8)]
    questions = [Transfer(A, bytes([register]), 1) for register in range(4, 8)]
    for begins_ms in range(0, 60, 5):
        bench = make(kind, faults=[Fault("late", 1 + 1e-3 * begins_ms, 0.004)])
        bench.bus.scan([FIRST, *numbered])
        bench.clock.wait_until(1_000_000_000)
        for _ in range(20):
            try:
                replies = bench.bus.scan(questions)
            except TransferFailed:
                continue
            assert [reply.data for reply in replies] == [
                bytes([register]) for register in range(4, 8)
            ]
        assert bench.bus.scan(questions)[0].data == bytes([4])


@every_bridge
def test_an_unplugged_bridge_is_lost_and_found_again(make, kind):
    bench = make(kind, faults=[Fault("unplug", 1, 1)])
    bench.bus.scan([FIRST, WHO])
    bench.clock.wait_until(1_500_000_000)
    with pytest.raises(DeviceLost):
        bench.bus.scan([FIRST, WHO])
    with pytest.raises(DeviceNotFound):
        bench.open()
    bench.clock.wait_until(2_500_000_000)
    with pytest.raises(DeviceLost):
        bench.bus.scan([FIRST, WHO])
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@every_usb_bridge
def test_clearing_a_bus_that_is_free_does_no_harm(make, kind):
    bench = make(kind)
    bench.bus.clear()
    bench.bus.scan([FIRST, Transfer(ABSENT, b"\0")])
    bench.bus.clear()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


# -- the emulated bus


class Talking(Device):
    """One endpoint out and one in, which has what is left in `says`."""

    device_descriptor = bytes.fromhex(
        "12 01 00 02 00 00 00 40 34 12 78 56 00 01 00 01 00 01"
    )
    configuration = bytes.fromhex(
        "09 02 20 00 01 01 00 80 32  09 04 00 00 02 ff ff ff 00"
        "07 05 85 02 09 00 01  07 05 06 02 2c 01 01"
    )
    strings = ("Talking",)
    says: tuple[bytes, ...] = ()

    def read(self, endpoint: int, length: int) -> bytes:
        assert (endpoint, length) == (0x85, 9)
        first, *rest = self.says or (b"",)
        self.says = tuple(rest)
        return first

    def write(self, endpoint: int, data: bytes) -> None:
        self.says += (data,)

    def control_out(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> None:
        self.says += (bytes([request, value, index, *data]),)

    def control_in(
        self, request_type: int, request: int, value: int, index: int, length: int
    ) -> bytes:
        return bytes([request, value, index]).ljust(length, b"!")


class Bus:
    """It on a bus of its own, opened, with its kernel driver detached."""

    def __init__(self, *faults: Fault) -> None:
        self.device, self.clock = Talking(), VirtualClock(5_000)
        self.backend = VirtualBackend(self.device, self.clock, Faults(faults))
        self.handle = self.backend.open_device(next(self.backend.enumerate_devices()))
        self.backend.detach_kernel_driver(self.handle, 0)

    def read(self, wait_ms: int = 7) -> bytes:
        """What the endpoint has, as pyusb asks for it."""
        into = array("B", bytes(9))
        count = self.backend.bulk_read(self.handle, 0x85, 0, into, wait_ms)
        return bytes(into[:count])

    def write(self, data: bytes) -> int:
        return self.backend.bulk_write(self.handle, 0x06, 0, data, 7)

    def control(self, kind: int, data: array, *request: int) -> int:
        words: list[Any] = [self.handle, kind, *request, data, 7]
        return self.backend.ctrl_transfer(*words)

    def at(self, now_ms: float) -> None:
        """Go on to a time since it was made."""
        self.clock.wait_until(5_000 + round(1e6 * now_ms))


def test_pyusb_finds_an_emulated_device_by_what_its_descriptors_say():
    bus = Bus()
    found = usb.core.find(backend=bus.backend)
    assert (found.bus, found.address, found.speed) == (1, 1, 3)
    assert (found.port_number, found.port_numbers) == (1, (1,))
    assert (found.bNumConfigurations, found.iProduct, found.iSerialNumber) == (1, 1, 0)
    configuration = found[0]
    assert (configuration.bMaxPower, configuration.bNumInterfaces) == (50, 1)
    assert found.product == "Talking"
    endpoints = list(configuration[(0, 0)])
    assert [
        (e.bEndpointAddress, e.bmAttributes, e.wMaxPacketSize, e.bInterval)
        for e in endpoints
    ] == [(0x85, 2, 9, 1), (0x06, 2, 300, 1)]
    assert [(e.bRefresh, e.bSynchAddress) for e in endpoints] == [(0, 0)] * 2
    assert bus.backend.get_configuration(bus.handle) == 1
    with pytest.raises(IndexError):
        bus.backend.get_configuration_descriptor(bus.handle, 1)
    with pytest.raises(IndexError):
        bus.backend.get_interface_descriptor(bus.handle, 0, 1, 0)


def test_a_read_of_nothing_takes_its_time_out_and_nothing_else_does():
    bus = Bus()
    assert bus.write(b"abc") == 3
    assert bus.read() == b"abc"
    assert bus.clock.now_ns() == 5_000
    with pytest.raises(usb.core.USBTimeoutError) as late:
        bus.read(9)
    assert (late.value.errno, late.value.backend_error_code) == (110, 110)
    assert bus.clock.now_ns() == 9_005_000


def test_a_late_answer_comes_first_when_answers_are_in_time_again_and_once():
    bus = Bus(Fault("late", 0.001, 0.002))
    bus.at(1)
    bus.device.says = (b"one", b"two", b"three")
    for now_ms in (2, 3):
        with pytest.raises(usb.core.USBTimeoutError):
            bus.read(1)
        assert bus.clock.now_ns() == 5_000 + 1_000_000 * now_ms
    assert [bus.read() for _ in range(3)] == [b"one", b"two", b"three"]


def test_an_unplugged_cable_takes_late_answers_and_the_detached_driver_away():
    bus = Bus(Fault("late", 0.001, 0.001), Fault("unplug", 0.005, 0.001))
    bus.at(1)
    bus.device.says = (b"one",)
    with pytest.raises(usb.core.USBTimeoutError):
        bus.read(1)
    bus.at(5.5)
    with pytest.raises(usb.core.USBError) as gone:
        bus.read()
    assert (gone.value.errno, gone.value.backend_error_code) == (19, 19)
    bus.at(6)
    found = next(bus.backend.enumerate_devices())
    assert bus.backend.get_device_descriptor(found).address == 2
    bus.handle = bus.backend.open_device(found)
    assert bus.backend.is_kernel_driver_active(bus.handle, 0)
    bus.backend.detach_kernel_driver(bus.handle, 0)
    bus.device.says = (b"two",)
    assert bus.read() == b"two"


def test_half_of_an_answer_comes_where_one_is_short_and_a_stall_ends_every_transfer():
    bus = Bus(Fault("short", 0.001, 0.001), Fault("stall", 0.003, 0.001))
    bus.at(1)
    bus.device.says = (b"abcdefg",)
    assert bus.read() == b"abc"
    assert bus.control(0xC0, array("B", bytes(4)), 1, 2, 3) == 2
    bus.at(3)
    for act in (
        bus.read,
        lambda: bus.write(b"a"),
        lambda: bus.control(0x40, array("B"), 1, 2, 3),
    ):
        with pytest.raises(usb.core.USBError, match="Pipe"):
            act()
    assert bus.backend.traffic.transfers == 5
    bus.at(4)
    assert bus.write(b"a") == 1


def test_a_control_request_without_an_answer_in_time_was_carried_out_all_the_same():
    bus = Bus(Fault("late", 0, 0.001))
    with pytest.raises(usb.core.USBTimeoutError):
        bus.control(0x40, array("B", b"ab"), 1, 2, 3)
    assert bus.backend.traffic.bytes_out == 0
    assert bus.clock.now_ns() == 5_000 + 7_000_000
    assert bus.read() == b"\1\2\3ab"


def test_an_interface_that_is_given_back_by_another_handle_stays_claimed():
    bus = Bus()
    other = bus.backend.open_device(bus.handle)
    bus.backend.claim_interface(bus.handle, 0)
    with pytest.raises(usb.core.USBError, match="busy"):
        bus.backend.attach_kernel_driver(bus.handle, 0)
    bus.backend.release_interface(other, 0)
    bus.backend.close_device(other)
    with pytest.raises(usb.core.USBError, match="busy"):
        bus.backend.claim_interface(other, 0)
    bus.backend.release_interface(bus.handle, 0)
    bus.backend.claim_interface(other, 0)
    bus.backend.close_device(other)
    bus.backend.attach_kernel_driver(other, 0)
    assert bus.backend.is_kernel_driver_active(other, 0)


# -- the emulated board's bus
