"""Every bridge on USB: claims, descriptors, names, and what a failed open gives back."""

from __future__ import annotations

from types import SimpleNamespace

import libusb_package
import pytest
import usb.backend.libusb1
import usb.core
import usb.util
from bridge_bench import (
    FIRST,
    IDENTITY,
    WHO,
    every_usb_bridge,
)

from holdfast.core.errors import (
    AccessDenied,
    DeviceLost,
    DeviceNotFound,
    LibraryMissing,
    TransferFailed,
)
from holdfast.drivers import usb as bridge_on_usb
from holdfast.drivers.bridges import bridges_on_usb, ids_of, open_bus
from holdfast.drivers.bus import Transfer
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.usb import Stalled, UsbPort, named_errors, real_backend
from holdfast.drivers.virtual.faults import Fault
from holdfast.drivers.virtual.usb_backend import VirtualBackend


@every_usb_bridge
def test_a_kernel_driver_is_away_while_a_bridge_is_open_and_back_afterwards(make, kind):
    bench = make(kind)
    interface = 0
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


def test_a_bridge_that_is_unplugged_takes_the_power_away_once(make):
    bench = make("ft232h", faults=[Fault("unplug", 1, 1), Fault("unplug", 3, 1)])
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
    bench = make("ft232h", faults=[Fault("unplug", 1, 1)])
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
    ],
)
def test_a_bridge_shows_its_maker_its_product_and_its_serial_number(
    make, kind, strings
):
    found = usb.core.find(backend=make(kind).backend)
    assert (found.manufacturer, found.product, found.serial_number) == strings


@every_usb_bridge
def test_a_bridge_that_does_not_open_is_given_back(make, kind):
    bench = make(kind, faults=[Fault("stall", 1, 1)])
    bench.clock.wait_until(1_500_000_000)
    bench.bus.close()
    with pytest.raises(TransferFailed):
        bench.open()
    assert bench.backend.is_kernel_driver_active(None, 0)
    bench.clock.wait_until(2_500_000_000)
    bench.bus = bench.open()


@pytest.mark.parametrize(
    ("raised", "error", "says"),
    [
        (usb.core.USBError("text", None, 19), DeviceLost, "no longer on USB"),
        (usb.core.USBError("text", None, 13), AccessDenied, "no udev rule"),
        (usb.core.USBError("text", None, 16), AccessDenied, "another program"),
        (usb.core.USBError("text", None, 110), TransferFailed, "no answer in time"),
        (usb.core.USBTimeoutError("text"), TransferFailed, "no answer in time"),
        (usb.core.USBError("text", None, 32), Stalled, "(stall)"),
        (usb.core.USBError("text", None, 5), TransferFailed, "USB error 5: text"),
        (usb.core.NoBackendError("text"), LibraryMissing, "no libusb"),
    ],
)
def test_each_error_of_usb_has_its_own(raised, error, says):
    with pytest.raises(error) as found, named_errors("ft232h"):
        raise raised
    assert type(found.value) is error
    assert str(found.value).startswith("ft232h: ")
    assert says in str(found.value)


@every_usb_bridge
def test_a_bridge_waits_for_a_transfer_as_long_as_that_may_take(make, kind):
    bench = make(kind)
    waits_ms = set()

    def noting(carry):
        def noted(*values):
            waits_ms.add(values[-1])
            return carry(*values)

        return noted

    bench.bus.close()
    for name in ("ctrl_transfer", "bulk_read", "bulk_write"):
        setattr(bench.backend, name, noting(getattr(bench.backend, name)))
    bench.bus = bench.open()
    bench.bus.scan([FIRST, WHO])
    # 5 ms: reading away what an earlier program left
    assert waits_ms == {5, 10}


def test_what_is_left_is_read_away_until_none_is_or_64_times(make):
    port = make("ft232h").bus._port
    for left, read in (
        ([5, 3, 2, 9], 3),
        ([5, 1, 9], 2),
        ([3] * 100, 64),
        ([9, None, 9], 2),
    ):
        asked = []

        def bring(*given, asked=asked, left=left):
            asked.append(given)
            length = left[len(asked) - 1]
            if length is None:
                raise TransferFailed("no answer in time")
            return bytes(length)

        port.read = bring
        port.drain(0x81, 512, empty=2)
        assert asked == [(0x81, 512, 5)] * read


def test_a_bridge_is_one_of_those_on_usb_by_its_number(make):
    backend = make("ft232h").backend
    with pytest.raises(DeviceNotFound, match=r"only 1 on USB.*0403:6014"):
        Ft232h(backend, number=1)


def test_bridges_on_usb_are_urls_with_their_numbers(make, monkeypatch):
    backend = make("ft232h").backend
    monkeypatch.setattr(bridge_on_usb, "real_backend", lambda: backend)
    assert bridges_on_usb() == ["usb://ft232h?number=0"]
    assert ids_of("ft232h") == ((0x0403, 0x6014),)
    with pytest.raises(AccessDenied, match="busy"):
        open_bus("usb", "ft232h")
    with pytest.raises(DeviceNotFound, match="only 1"):
        open_bus("usb", "ft232h", number=1)


@pytest.mark.parametrize("sent", [0, 2, 4])
def test_bytes_that_did_not_go_out_are_a_transfer_that_failed(make, sent):
    port = make("ft232h").bus._port
    device = port.device
    port.device = SimpleNamespace(
        write=lambda endpoint, data, wait: sent, ctrl_transfer=lambda *given: sent
    )
    with pytest.raises(TransferFailed, match=f"{sent} of 3 bytes went out"):
        port.write(0x02, b"abc")
    with pytest.raises(TransferFailed, match=f"{sent} of 3 bytes went out"):
        port.control_out(0x40, 0, 0, 0, b"abc")
    port.device = device


@pytest.mark.parametrize(
    ("active", "calls"),
    [
        (True, ["detach 0", "claim 0", "release 0", "attach 0", "dispose"]),
        (False, ["claim 0", "release 0", "dispose"]),
        (None, ["claim 0", "release 0", "dispose"]),
    ],
)
def test_only_a_kernel_driver_that_was_there_is_brought_back_and_once(
    monkeypatch, active, calls
):
    """None: a backend that knows of no kernel drivers."""
    called = []

    def is_active(interface):
        if active is None:
            raise NotImplementedError
        return active

    def noting(name):
        return lambda *given: called.append(" ".join([name, *map(str, given)]))

    device = SimpleNamespace(
        idVendor=1,
        idProduct=2,
        is_kernel_driver_active=is_active,
        detach_kernel_driver=noting("detach"),
        attach_kernel_driver=noting("attach"),
    )
    others = [SimpleNamespace(idVendor=v, idProduct=p) for v, p in ((1, 3), (3, 2))]
    monkeypatch.setattr(usb.core, "find", lambda **given: [*others, device])
    for name in ("claim", "release"):
        monkeypatch.setattr(
            usb.util, f"{name}_interface", lambda one, k, n=name: noting(n)(k)
        )
    monkeypatch.setattr(usb.util, "dispose_resources", lambda one: noting("dispose")())
    port = UsbPort("a", [(1, 2), (3, 4)], None)
    port.close()
    port.close()
    assert called == calls


def test_libusb_is_the_system_s_or_the_packaged_one_and_without_both_an_error(
    monkeypatch,
):
    for system, packaged, found in (("a", "b", "a"), (None, "b", "b")):
        monkeypatch.setattr(
            usb.backend.libusb1, "get_backend", lambda system=system: system
        )
        monkeypatch.setattr(
            libusb_package, "get_libusb1_backend", lambda packaged=packaged: packaged
        )
        assert real_backend() == found
    monkeypatch.setattr(libusb_package, "get_libusb1_backend", lambda: None)
    with pytest.raises(LibraryMissing, match=r"no libusb.*holdfast doctor"):
        real_backend()


# -- the bytes that the FT232H is sent

HIGH, SCL_ONLY, SDA_ONLY, LOW = (
    f"80 {levels} 03 " for levels in ("03", "01", "02", "00")
)
START, STOP = HIGH * 4 + SCL_ONLY * 4 + LOW, LOW * 4 + SCL_ONLY * 4 + HIGH * 4


def written(byte):
    return f"11 00 00 {byte} {SDA_ONLY}22 00 "


def sent_by(bus):
    """What goes out from now on, in hexadecimal."""
    port, sent = bus._port, []
    write = port.write
    port.write = lambda at, data, *wait: sent.append(data.hex(" ")) or write(at, data)
    return sent


def test_a_write_and_a_read_are_these_commands_and_begin_with_marks_that_alternate(
    make,
):
    bus = make("ft232h").bus
    sent = sent_by(bus)
    bus.scan([Transfer(0x70, b"\x01"), Transfer(0x35, b"\x0d", 2)])
    bus.scan([Transfer(0x35, b"")])
    bus.scan([Transfer(0x35, b"", 1)])
    read = "20 00 00 13 00 {} " + SDA_ONLY
    first = START + written("e0") + written("01") + STOP
    second = START + written("6a") + written("0d") + SDA_ONLY + START + written("6b")
    second += read.format("00") + read.format("ff") + STOP
    touch = START + written("6a") + STOP
    third = SDA_ONLY + START + written("6b") + read.format("ff") + STOP
    assert {one[:2] for one in sent} == {"aa", "ab"}
    assert sent[0][:2] == sent[2][:2] != sent[1][:2]
    assert [one[3:] for one in sent] == [
        f"81 {commands}81 87" for commands in (first + second, touch, third)
    ]


def test_an_ft232h_is_set_up_looked_at_and_cleared_by_these_commands(make):
    bus = make("ft232h", version=1).bus
    sent = sent_by(bus)
    asked, ask = [], bus._port.control_out
    bus._port.control_out = lambda *given: asked.append(given) or ask(*given)
    bus.clear()
    requests = [(0, 0), (0, 1), (0, 2), (9, 1), (11, 0), (11, 0x200), (0, 1), (0, 2)]
    assert asked == [(0x40, request, value, 1) for request, value in requests]
    mark, setup, wiring, clocks = sent
    assert mark[3:] == "87"
    assert setup == f"8a 97 8c 9e 07 00 85 86 31 00 {HIGH * 4}".strip()
    pulse = SDA_ONLY * 4 + LOW * 4 + "81 " + SDA_ONLY * 4 + HIGH * 4
    assert wiring[3:] == f"{pulse}87"
    nine = (SDA_ONLY * 4 + HIGH * 4) * 9
    assert clocks[3:] == f"{nine}{STOP}81 87"
