"""Every bridge, by the same sentences: FT232H, tiny-usb with four firmwares, the MCP2221A, and the board's own I2C."""

from __future__ import annotations

import errno
import os
import struct
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import smbus2
import usb.core
from hypothesis import given
from hypothesis import strategies as st

from drivers.bus import NOT_ACKED, Bus, Reply, Transfer
from drivers.ft232h import Ft232h
from drivers.mcp2221 import TIMEOUT_MS, Mcp2221
from drivers.native_i2c import NativeI2C
from drivers.tiny_usb import TinyUsb
from drivers.tmag5273 import (
    FACTORY_ADDRESSES,
    GENERAL_CALL,
    PACKET_BYTES,
    REGISTERS,
    RESULTS,
    Setup,
    field_ut,
    packet,
)
from drivers.virtual.clock import VirtualClock
from drivers.virtual.faults import Fault
from drivers.virtual.ft232h import VirtualFt232h
from drivers.virtual.hand import Track, VirtualHand
from drivers.virtual.mcp2221 import VirtualMcp2221
from drivers.virtual.native import VirtualI2cDev
from drivers.virtual.tiny_usb import FIRMWARES, VirtualTinyUsb
from drivers.virtual.usb_backend import Device, VirtualBackend, stall
from edge_runtime.errors import (
    AccessDenied,
    BusStuck,
    DeviceLost,
    DeviceNotFound,
    TransferFailed,
    UsageError,
)

A, B, C, D = FACTORY_ADDRESSES
ABSENT = 0x11
ID = REGISTERS["DEVICE_ID"].address
IDENTITY = bytes([0x01, 0x49, 0x54])
FIRST, SECOND = Transfer(0x70, bytes([1])), Transfer(0x70, bytes([2]))
WHO = Transfer(A, bytes([ID]), 3)
THRESHOLD = REGISTERS["X_THR_CONFIG"].address
SIX = (
    FIRST, *(Transfer(a, bytes([RESULTS]), PACKET_BYTES) for a in (A, B, C, D)),
    SECOND, *(Transfer(a, bytes([RESULTS]), PACKET_BYTES) for a in (A, B)),
)  # fmt: skip
TINY = tuple(FIRMWARES)
ON_USB = (*TINY, "mcp2221", "ft232h")
ALL = (*ON_USB, "native")
CANNOT_CLOCK = ("rp2040", "stm32", "mcp2221", "native")
"""A chip that holds SDA low."""


class Bench:
    """A virtual hand on a bridge of its own. kind: one of ALL."""

    def __init__(self, kind: str, **told: Any) -> None:
        self.clock = VirtualClock()
        self.hand = VirtualHand(self.clock, **told)
        self.device: Device | None = None
        self.backend: Any
        self.open: Callable[[], Bus]
        if kind == "native":
            self.backend = VirtualI2cDev(self.hand).__enter__()
            self.open = lambda: NativeI2C(1)
        else:
            emulated: dict[str, Callable[[], Device]] = {
                "mcp2221": lambda: VirtualMcp2221(self.hand), "ft232h": lambda: VirtualFt232h(self.hand),
            }  # fmt: skip
            self.device = emulated.get(kind, lambda: VirtualTinyUsb(self.hand, kind))()
            self.backend = VirtualBackend(self.device, self.clock, self.hand.faults, self.hand.power_off)
            driver: Any = {"mcp2221": Mcp2221, "ft232h": Ft232h}.get(kind, TinyUsb)
            self.open = lambda: driver(self.backend)
        self.bus = self.open()

    def end(self) -> None:
        self.bus.close()
        if isinstance(self.backend, VirtualI2cDev):
            self.backend.__exit__(None, None, None)

    def wait_s(self, duration_s: float) -> None:
        self.clock.spend(round(1e9 * duration_s))

    def engine(self) -> VirtualMcp2221:
        assert isinstance(self.device, VirtualMcp2221)
        return self.device


Make = Callable[..., Bench]


@pytest.fixture
def make() -> Iterator[Make]:
    """Benches that are taken apart in the end, the last first."""
    made: list[Bench] = []

    def one(kind: str, **told: Any) -> Bench:
        made.append(Bench(kind, **told))
        return made[-1]

    yield one
    for bench in reversed(made):
        bench.end()


every_bridge = pytest.mark.parametrize("kind", ALL)
every_usb_bridge = pytest.mark.parametrize("kind", ON_USB)
every_firmware = pytest.mark.parametrize("kind", TINY)


# -- what every bridge does


@every_bridge
def test_a_chip_is_identified_through_the_mux(make, kind):
    assert make(kind).bus.scan([FIRST, WHO]) == [Reply(b"", acked=True), Reply(IDENTITY, acked=True)]


@every_bridge
def test_a_register_that_was_written_reads_back(make, kind):
    write, read = Transfer(B, bytes([THRESHOLD, 0x5A, 0xA5])), Transfer(B, bytes([THRESHOLD]), 2)
    assert make(kind).bus.scan([FIRST, write, read])[2] == Reply(b"\x5a\xa5", acked=True)


@every_bridge
def test_a_read_goes_on_where_the_last_one_ended(make, kind):
    replies = make(kind).bus.scan([FIRST, Transfer(A, bytes([ID]), 1), Transfer(A, read=2)])
    assert [reply.data for reply in replies] == [b"", IDENTITY[:1], IDENTITY[1:]]


@every_bridge
def test_an_absent_chip_costs_only_itself(make, kind):
    absent = [Transfer(ABSENT, bytes([ID]), 3), Transfer(ABSENT, read=3), Transfer(ABSENT, b"\0\0"), Transfer(ABSENT)]
    replies = make(kind).bus.scan([FIRST, *(one for gone in absent for one in (gone, WHO))])
    assert replies[1::2] == [NOT_ACKED] * 4
    assert replies[2::2] == [Reply(IDENTITY, acked=True)] * 4


@pytest.mark.parametrize("kind", [kind for kind in ALL if kind != "avr"])  # harbaum's: TODO, set status
def test_a_byte_that_is_not_acknowledged_is_told(make, kind):
    bench = make(kind)
    bench.bus.scan([FIRST])
    heard = bench.hand.wire.write
    bench.hand.wire.write = lambda byte: byte != 0xEE and heard(byte)
    for transfer in (Transfer(A, bytes([THRESHOLD, 0xEE])), Transfer(A, bytes([THRESHOLD, 0xEE]), 3)):
        assert bench.bus.scan([WHO, transfer, WHO]) == [Reply(IDENTITY, True), NOT_ACKED, Reply(IDENTITY, True)]


@every_bridge
def test_an_address_alone_asks_whether_a_chip_is_there(make, kind):
    assert [reply.acked for reply in make(kind).bus.scan([FIRST, Transfer(A), Transfer(ABSENT), Transfer(B)])] == [
        True, True, False, True,
    ]  # fmt: skip


@every_bridge
def test_a_chip_behind_another_channel_is_not_there(make, kind):
    replies = make(kind).bus.scan([SECOND, Transfer(C, bytes([ID]), 3), WHO])
    assert [reply.acked for reply in replies] == [True, False, True]


@every_bridge
def test_a_burst_decodes_to_the_field_of_the_track(make, kind):
    told_ut = np.arange(18.0).reshape(6, 3) * 1000 + 500
    bench = make(kind, track=Track(np.array([0.0]), told_ut[None]))
    for channel, address in ((FIRST, A), (FIRST, B), (FIRST, C), (FIRST, D), (SECOND, A), (SECOND, B)):
        replies = bench.bus.scan([channel, *(Transfer(address, bytes(byte)) for byte in Setup().registers())])
        assert all(reply.acked for reply in replies)
    bench.wait_s(0.01)
    found = [packet(reply.data) for reply in bench.bus.scan(SIX) if reply.data]
    read_ut = np.array([field_ut(one.raw, 1.0) * Setup().range_mt(1) for one in found])
    np.testing.assert_allclose(read_ut, told_ut, atol=1.3)  # half a step of the widest range


@every_bridge
def test_one_byte_reads_bring_the_same_packet(make, kind):
    bench = make(kind)
    bench.bus.scan([FIRST, *(Transfer(A, bytes(byte)) for byte in Setup(burst=True).registers())])
    bench.wait_s(0.01)
    reply = bench.bus.scan([FIRST, Transfer(A, read=PACKET_BYTES)])[1]
    assert packet(reply.data).raw == (0, 0, round(23730 / 80000 * 32768))


@every_bridge
def test_a_write_then_read_does_not_stop_between(make, kind):
    bench = make(kind)
    stops = []
    heard, bench.hand.wire.stop = bench.hand.wire.stop, lambda: (stops.append(1), heard())[1]
    bench.bus.scan([FIRST, WHO])
    assert len(stops) == 2


@every_bridge
def test_a_read_alone_is_one_start_and_one_stop(make, kind):
    bench = make(kind)
    bench.bus.scan([FIRST])
    bits = bench.hand.wire.bits
    bench.bus.scan([Transfer(A, read=1)])
    assert bench.hand.wire.bits - bits == 1 + 9 + 9 + 1


@every_bridge
def test_a_bridge_can_be_closed_twice_and_opened_again(make, kind):
    bench = make(kind)
    bench.bus.close()
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@every_bridge
def test_nothing_asked_is_nothing_answered(make, kind):
    assert make(kind).bus.scan([]) == []


@pytest.mark.parametrize(
    ("kind", "transfers", "bytes_out", "bytes_in", "milliseconds"),
    [
        ("avr", 28, 8, 56, (90, 100)),
        ("rp2040", 28, 8, 56, (10, 15)),
        ("stm32", 28, 8, 56, (10, 15)),
        ("pico", 28, 8, 56, (15, 20)),
        ("mcp2221", 58, 29 * 64, 29 * 64, (85, 90)),
        ("native", 8, 8, 42, (1.5, 3)),
    ],
)
def test_a_scan_of_six_sensors_takes_this_much_traffic_and_time(
    make, kind, transfers, bytes_out, bytes_in, milliseconds
):
    bench = make(kind)
    bench.bus.scan(SIX)
    traffic, begun_ns = bench.backend.traffic, bench.clock.now_ns()
    traffic.transfers = traffic.bytes_out = traffic.bytes_in = 0
    assert all(reply.acked for reply in bench.bus.scan(SIX))
    assert (traffic.transfers, traffic.bytes_out, traffic.bytes_in) == (transfers, bytes_out, bytes_in)
    assert milliseconds[0] < 1e-6 * (bench.clock.now_ns() - begun_ns) < milliseconds[1]


WALKS = {0x11: 4, 0x13: 3, 0x20: 3, 0x22: 2, 0x80: 3, 0x86: 3}
"""Bytes of the MPSSE commands that have arguments; the driver sends one byte at a time."""


class BitByBit(VirtualFt232h):
    """An FT232H whose driver clocks every bit by itself, where it would send whole bytes."""

    def write(self, endpoint: int, data: bytes) -> None:
        at, told = 0, b""
        while at < len(data):
            command = data[at : at + WALKS.get(data[at], 1)]
            at += len(command)
            if command[0] == 0x11:
                command = b"".join(bytes([0x13, 0, command[3] << k & 0xFF]) for k in range(8))
            told += b"\x22\x07" if command[0] == 0x20 else command
        super().write(endpoint, told)


class Computing(VirtualClock):
    """A clock on which an emulation that computes takes time: so much for every look at it."""

    looks = 0

    def now_ns(self) -> int:
        self.looks += 1
        self.spend(100)
        return super().now_ns()


def scans(bridge: type[VirtualFt232h], clock: VirtualClock) -> tuple[list[Reply], float]:
    """What three scans of a noisy, changing hand answer, and how long they take, s."""
    track = Track(np.array([0.0, 0.02]), np.stack([np.full((6, 3), -9e3), np.full((6, 3), 2e4)]))
    hand = VirtualHand(clock, track=track, seed=3, faults=[Fault("frozen", 1e6, sensor=1)])  # which it looks out for
    bus = Ft232h(VirtualBackend(bridge(hand), clock, hand.faults, hand.power_off))
    begun_ns = clock.now_ns()
    asked = [Transfer(A, bytes([*pair])) for pair in Setup(averages=1).registers()]
    replies = bus.scan([FIRST, *asked])
    replies += [reply for _ in range(3) for reply in bus.scan([WHO, Transfer(ABSENT, read=2), *SIX])]
    return replies, 1e-9 * (clock.now_ns() - begun_ns)


def test_an_emulated_ft232h_carries_bytes_as_it_carries_bits():
    (whole, whole_s), (bits, bits_s) = scans(VirtualFt232h, VirtualClock()), scans(BitByBit, VirtualClock())
    assert whole == bits
    assert whole_s == bits_s
    assert len({reply.data for reply in whole if len(reply.data) == PACKET_BYTES}) > 3


def test_what_an_emulated_ft232h_takes_to_compute_is_part_of_what_its_wire_takes():
    clock = Computing()
    (replies, lasts_s), (_, plain_s) = scans(VirtualFt232h, clock), scans(VirtualFt232h, VirtualClock())
    assert any(reply.acked for reply in replies)
    assert clock.looks > 300
    assert lasts_s - plain_s < 0.2 * 100e-9 * clock.looks


def test_a_track_between_its_rows_is_a_line_to_the_last_bit_and_its_ends_hold():
    rng = np.random.default_rng(0)
    t_s, field_ut_ = np.cumsum(rng.uniform(1e-4, 2e-3, 50)), 1e4 * rng.normal(size=(50, 6, 3))
    track = Track(t_s, field_ut_)
    for now_s in (-1.0, *t_s, *rng.uniform(0.0, t_s[-1], 200), 9.0):
        told = [np.interp(now_s, t_s, field_ut_[:, 4, axis]) for axis in range(3)]
        assert track.at(float(now_s), 4) == told


# -- faults


@every_bridge
@pytest.mark.parametrize("fault", ["stall", "late", "short"])
@pytest.mark.parametrize("during", [0.0, 0.3, 0.6, 0.9])
def test_a_bridge_that_fails_says_so_and_the_next_scan_is_right(make, kind, fault, during):
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
            Reply(IDENTITY, acked=True), Reply(b"\0", acked=True),
        ]  # fmt: skip


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
            assert [reply.data for reply in replies] == [bytes([register]) for register in range(4, 8)]
        assert bench.bus.scan(questions)[0].data == bytes([4])


class SlowMcp2221(VirtualMcp2221):
    """Replies come when they come: late_ns after the command, once for each command named, and in order."""

    def __init__(self, hand: VirtualHand, slow: int) -> None:
        self.queue: list[tuple[int, bytes]] = []
        self.slow, self.late_ns = slow, 0
        super().__init__(hand)

    def write(self, endpoint: int, data: bytes) -> None:
        super().write(endpoint, data)
        late_ns = self.late_ns if data[0] == self.slow else 0
        self.late_ns -= late_ns
        self.queue.append((self.hand.clock.now_ns() + late_ns, self._reply))

    def read(self, endpoint: int, length: int) -> bytes:
        self.hand.clock.spend(1_500_000)
        return self.queue.pop(0)[1] if self.queue and self.queue[0][0] <= self.hand.clock.now_ns() else b""


@pytest.mark.parametrize("slow", [0x10, 0x40, 0x93, 0x94])
@pytest.mark.parametrize("late_ms", [1, 4, 7, 10, 15, 58, 150])
def test_a_reply_that_comes_after_the_late_ones_were_read_away_answers_nothing_either(slow, late_ms):
    """late_ms: after the driver has given up."""
    clock = VirtualClock()
    hand = VirtualHand(clock)
    device = SlowMcp2221(hand, slow)
    bus = Mcp2221(VirtualBackend(device, clock, hand.faults, hand.power_off))
    bus.scan([FIRST, *(Transfer(A, bytes([register, register])) for register in range(4, 8))])
    questions = [Transfer(A, bytes([register]), 1) for register in range(4, 8)]
    device.late_ns = 1_000_000 * (TIMEOUT_MS + late_ms)
    failed = 0
    for _ in range(9):
        try:
            replies = bus.scan(questions)
        except TransferFailed:
            failed += 1
            continue
        assert [reply.data for reply in replies] == [bytes([register]) for register in range(4, 8)]
    assert 0 < failed < 6
    bus.close()


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


@pytest.mark.parametrize("kind", CANNOT_CLOCK)
def test_a_bus_that_stays_held_low_cannot_be_cleared(make, kind):
    bench = make(kind, faults=[Fault("stuck", 1)])
    bench.bus.scan([FIRST, WHO])
    bench.clock.wait_until(1_000_000_000)
    if kind in TINY:
        assert bench.bus.scan([FIRST, WHO]) == [NOT_ACKED, NOT_ACKED]
    else:
        with pytest.raises(BusStuck):
            bench.bus.scan([FIRST, WHO])
    with pytest.raises(BusStuck, match="next:"):
        bench.bus.clear()


@pytest.mark.parametrize("kind", ["avr", "pico"])
def test_a_firmware_that_swings_the_pins_itself_frees_the_bus_without_knowing(make, kind):
    bench = make(kind, faults=[Fault("stuck", 1)])
    bench.bus.scan([FIRST, WHO])
    bench.clock.wait_until(1_000_000_000)
    assert bench.bus.scan([Transfer(A, bytes([ID]), 3)])[0].data != IDENTITY
    bench.bus.clear()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@pytest.mark.parametrize("kind", CANNOT_CLOCK)
def test_a_bus_that_is_let_go_carries_again(make, kind):
    bench = make(kind, faults=[Fault("stuck", 1)])
    bench.bus.scan([FIRST, WHO])
    bench.clock.wait_until(1_000_000_000)
    bench.hand.suffer()
    with pytest.raises(BusStuck):
        bench.bus.clear()
    while bench.hand.wire.held_low:
        bench.hand.wire.clock()
    if kind != "native":
        bench.bus.clear()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@every_usb_bridge
def test_clearing_a_bus_that_is_free_does_no_harm(make, kind):
    bench = make(kind)
    bench.bus.clear()
    bench.bus.scan([FIRST, Transfer(ABSENT, b"\0")])
    bench.bus.clear()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


# -- on USB


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


def test_a_handle_that_is_closed_or_unplugged_claims_nothing_any_more(make):
    bench = make("stm32", faults=[Fault("unplug", 1, 1)])
    bench.bus.close()
    first, second = (bench.backend.open_device(next(bench.backend.enumerate_devices())) for _ in range(2))
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
        ("mcp2221", ("Microchip Technology Inc.", "MCP2221 USB-I2C/UART Combo", "0000000001")),
    ],
)
def test_a_bridge_shows_its_maker_its_product_and_its_serial_number(make, kind, strings):
    found = usb.core.find(backend=make(kind).backend)
    assert (found.manufacturer, found.product, found.serial_number) == strings


@every_usb_bridge
def test_descriptors_by_request_are_those_that_libusb_shows(make, kind):
    bench = make(kind)
    found = usb.core.find(backend=bench.backend)
    device = bytes(found.ctrl_transfer(0x80, 6, 0x0100, 0, 64))
    assert (len(device), device[0]) == (18, 18)
    assert struct.unpack_from("<HHH", device, 8) == (found.idVendor, found.idProduct, found.bcdDevice)
    configuration = bytes(found.ctrl_transfer(0x80, 6, 0x0200, 0, 255))
    assert len(configuration) == struct.unpack_from("<H", configuration, 2)[0] == found[0].wTotalLength
    kinds, at = [], 0
    while at < len(configuration):
        kinds.append(configuration[at + 1])
        at += configuration[at]
    assert at == len(configuration)
    assert (kinds.count(4), kinds.count(5)) == (found[0].bNumInterfaces, sum(i.bNumEndpoints for i in found[0]))
    with pytest.raises(usb.core.USBError):
        found.ctrl_transfer(0x80, 6, 0x03FF, 0, 64)


def test_the_mcp2221_announces_a_hid_interface_of_64_bytes_each_way(make):
    bench = make("mcp2221")
    bench.bus.close()
    found = usb.core.find(backend=bench.backend)
    found.detach_kernel_driver(2)
    interface = found[0][(2, 0)]
    assert (interface.bInterfaceClass, [e.wMaxPacketSize for e in interface]) == (3, [64, 64])
    length, kind, _, _, _, report_kind, report_length = struct.unpack("<BBHBBBH", bytes(interface.extra_descriptors))
    assert (length, kind, report_kind) == (9, 0x21, 0x22)
    report = bytes(found.ctrl_transfer(0x80 | 1, 6, 0x2200, 2, 255))
    assert len(report) == report_length
    assert report.startswith(b"\x06\x00\xff\x09\x01")  # usage page 0xFF00, usage 1
    assert report.count(b"\x95\x40") == 1  # 64 bytes a report


def test_no_bridge_on_usb_is_named_with_its_ids(make):
    bench = make("mcp2221")
    with pytest.raises(DeviceNotFound, match="0403:c631, 1c40:0534"):
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


# -- tiny-usb


@every_firmware
def test_tiny_usb_sets_100_khz_when_it_opens_and_after_a_reset(make, kind):
    bench = make(kind)
    assert bench.device.delay_us == 10
    bench.bus.close()
    slow = TinyUsb(bench.backend, delay_us=50)
    assert bench.device.delay_us == 50
    slow.clear()
    assert bench.device.delay_us == 50
    slow.close()


def test_tiny_usb_refuses_a_delay_that_is_none(make):
    with pytest.raises(UsageError):
        TinyUsb(make("avr").backend, delay_us=0)


def test_stale_data_of_the_rp2040_firmware_are_never_a_reply(make):
    bench = make("rp2040")
    bench.bus.scan([FIRST, WHO])
    raw = bench.backend.device.control_in(0xC1, 7, 1, ABSENT, 3)
    assert raw == IDENTITY  # what the firmware says of a chip that is not there
    for transfer in (Transfer(ABSENT, read=3), Transfer(ABSENT, bytes([ID]), 3)):
        assert bench.bus.scan([WHO, transfer, WHO])[1] == NOT_ACKED


@pytest.mark.parametrize(("kind", "answer"), [("avr", b"\0\0\0"), ("rp2040", IDENTITY), ("stm32", b"")])
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


def test_a_firmware_that_swings_the_pins_itself_makes_no_second_start(make):
    device = make("avr").device
    device.control_out(0x41, 4 | 1, 0, 0x70, b"\1")
    device.control_out(0x41, 4 | 1 | 2, 0, ABSENT, b"\2")
    assert device.control_in(0xC1, 3, 0, 0, 1) == b"\1"  # the mux took the address for data


@every_firmware
def test_tiny_usb_brings_out_the_stop_that_a_failure_kept_back(make, kind):
    bench = make(kind)
    bench.bus.scan([FIRST])
    spoilt = bench.device._read
    bench.device._read = lambda request, address, length: (_ for _ in ()).throw(stall())
    with pytest.raises(TransferFailed):
        bench.bus.scan([WHO])
    bench.device._read = spoilt
    assert bench.bus.scan([SECOND, Transfer(C, bytes([ID]), 3), WHO])[1:] == [NOT_ACKED, Reply(IDENTITY, acked=True)]


@every_firmware
def test_tiny_usb_says_that_fewer_bytes_came_than_were_asked_for(make, kind):
    bench = make(kind)
    spoilt = bench.device._read
    bench.device._read = lambda *told: spoilt(*told)[:-1]
    with pytest.raises(TransferFailed, match="2 of 3 bytes"):
        bench.bus.scan([FIRST, WHO])


# -- MCP2221A


def test_a_cancel_of_an_engine_that_was_never_used_hangs_it(make):
    bench = make("mcp2221")
    bench.engine().write(0x03, bytes([0x10, 0, 0x10]))
    with pytest.raises(TransferFailed, match="0x62"):
        bench.bus.scan([FIRST])
    bench.bus._port.reset()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_the_driver_never_cancels_an_engine_that_was_never_used(make):
    bench = make("mcp2221")
    bench.bus.clear()
    bench.bus.close()
    bench.bus = bench.open()
    bench.bus.scan([])
    bench.bus.clear()
    assert not bench.engine().hangs
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_a_confused_engine_makes_its_next_transfer_bogus(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST, WHO])
    engine = bench.engine()
    engine.tick_sda()
    engine.write(0x03, bytes([0x91, 3, 0, ABSENT << 1 | 1]))
    engine.write(0x03, bytes([0x40]))
    assert engine.read(0x83, 64)[1:7] == bytes([0, 0x55, 3, 0xFF, 0xFF, 0xFF])


def test_the_driver_cancels_a_confused_engine_first(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST, WHO])
    bench.engine().tick_sda()
    assert bench.bus.scan([WHO])[0].data == IDENTITY


def test_an_engine_that_is_confused_in_the_middle_of_a_scan_is_cancelled(make):
    bench = make("mcp2221")
    engine = bench.engine()
    write = engine._write
    engine._write = lambda kind, *told: (write(kind, *told), engine.tick_sda() if kind == 0x90 else None)
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_the_mcp2221_says_that_fewer_bytes_came_than_were_asked_for(make):
    bench = make("mcp2221")
    engine = bench.engine()
    read = engine._read
    engine._read = lambda address, length: read(address, length - 1)
    with pytest.raises(TransferFailed, match="2 of 3 bytes"):
        bench.bus.scan([FIRST, WHO])
    engine._read = read
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_an_engine_that_was_never_used_is_not_cancelled_while_sda_is_low(make):
    bench = make("mcp2221")
    bench.hand.wire.hold_low()
    for ask in (bench.bus.clear, lambda: bench.bus.scan([FIRST]), bench.bus.clear):
        with pytest.raises(BusStuck, match="SDA"):
            ask()
    bench.bus.close()
    with pytest.raises(BusStuck, match="SDA"):
        bench.open()
    while bench.hand.wire.held_low:
        bench.hand.wire.clock()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_a_transfer_after_a_nack_that_was_not_cancelled_is_bogus(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    engine = bench.engine()
    engine.write(0x03, bytes([0x90, 1, 0, ABSENT << 1]))
    assert engine.state == 0x25
    engine.write(0x03, bytes([0x90, 1, 0, 0xE0, 2]))
    assert engine.state == 0x00
    assert bench.hand.mux.control == 1  # the write to the mux never was on the wire


def test_an_engine_that_another_program_left_in_a_nack_is_cancelled_when_it_is_opened(make):
    bench = make("mcp2221")
    bench.engine().write(0x03, bytes([0x90, 1, 0, ABSENT << 1]))
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@pytest.mark.parametrize("command", [[0x94, 1, 0, A << 1, ID], [0x91, 3, 0, A << 1 | 1]])
def test_an_engine_left_in_the_middle_of_a_transfer_is_cancelled(make, command):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    bench.engine().write(0x03, bytes(command))
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@pytest.mark.parametrize("length", [1, 60])
def test_the_mcp2221_carries_up_to_60_bytes(make, length):
    bench = make("mcp2221")
    assert len(bench.bus.scan([FIRST, Transfer(A, b"\0", length)])[1].data) == length
    assert bench.bus.scan([Transfer(A, bytes(length))])[0].acked


def test_the_mcp2221_says_that_a_transfer_is_too_long(make):
    bench = make("mcp2221")
    for transfer in (Transfer(A, bytes(61)), Transfer(A, b"\0", 61)):
        with pytest.raises(TransferFailed, match=r"61 bytes.*60 at most"):
            bench.bus.scan([FIRST, transfer])
    assert bench.hand.mux.control == 0  # and nothing of such a scan is carried out


@pytest.mark.parametrize("bus_hz", [47_000, 100_000, 400_000])
def test_the_mcp2221_runs_at_the_speed_it_is_told(make, bus_hz):
    bench = make("mcp2221")
    bench.bus.close()
    bench.bus = Mcp2221(bench.backend, bus_hz=bus_hz)
    assert bench.engine().bus_hz == pytest.approx(bus_hz, rel=0.01)
    assert len(bench.bus.scan([FIRST, Transfer(A, b"\0", 60)])[1].data) == 60
    assert bench.bus.scan([FIRST, Transfer(A, bytes(60)), WHO])[2].data == IDENTITY


@pytest.mark.parametrize("bus_hz", [46_000, 400_001])
def test_the_mcp2221_refuses_other_speeds(make, bus_hz):
    with pytest.raises(UsageError):
        Mcp2221(make("mcp2221").backend, bus_hz=bus_hz)


def test_an_engine_that_hangs_ends_in_an_error_and_not_in_a_loop(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    bench.engine().hangs = True
    bench.backend.traffic.transfers = 0
    with pytest.raises(TransferFailed, match="0x62"):
        bench.bus.scan([Transfer(ABSENT, b"\0")])
    assert bench.backend.traffic.transfers < 100


# -- the board's own


@pytest.mark.parametrize("number", [errno.EREMOTEIO, errno.ENXIO])
def test_controllers_say_in_two_ways_that_nobody_acknowledged(number):
    hand = VirtualHand(VirtualClock())
    with VirtualI2cDev(hand, 7, nack_errno=number):
        bus = NativeI2C(7)
        assert bus.scan([FIRST, Transfer(ABSENT, b"\0", 3), WHO])[1:] == [NOT_ACKED, Reply(IDENTITY, acked=True)]
        bus.close()


def test_a_bus_that_is_not_there_and_one_that_is_not_allowed_are_told_apart():
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


def test_what_needs_a_length_from_the_chip_is_refused_as_by_a_controller_of_plain_i2c(smbus):
    assert not smbus.funcs & (smbus2.I2cFunc.SMBUS_READ_BLOCK_DATA | smbus2.I2cFunc.SMBUS_BLOCK_PROC_CALL)
    for call in (lambda: smbus.read_block_data(A, ID), lambda: smbus.block_process_call(A, ID, [1])):
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
    Transfer, st.sampled_from([A, B, 0x70, ABSENT, GENERAL_CALL]), st.binary(max_size=3), st.integers(0, 9)
)


@given(st.lists(TRANSFERS, min_size=1, max_size=6), st.booleans())
def test_commands_that_are_joined_do_what_each_alone_does(transfers, held):
    told = []
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
        told.append((replies, hand.wire.bits - bits, [bytes(chip._bytes) for chip in hand.chips]))
    assert told[0] == told[1]
