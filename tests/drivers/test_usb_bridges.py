"""Every bridge on USB: claims, descriptors, names, and what a failed open gives back."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import MagicMock

import libusb_package
import pytest
import usb.backend.libusb1
import usb.core
import usb.util
from bridge_bench import FIRST, IDENTITY, WHO, every_usb_bridge

from holdfast.core.errors import (
    AccessDenied,
    DeviceLost,
    DeviceNotFound,
    LibraryMissing,
    TransferFailed,
)
from holdfast.drivers import usb as bridge_on_usb
from holdfast.drivers.bridges import bridges_on_usb, open_bus
from holdfast.drivers.usb import Stalled, UsbPort, named_errors, real_backend
from holdfast.drivers.virtual.faults import Fault


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


def test_bridges_on_usb_are_urls_with_their_numbers(make, monkeypatch):
    backend = make("ft232h").backend
    monkeypatch.setattr(bridge_on_usb, "real_backend", lambda: backend)
    assert bridges_on_usb() == ["usb://ft232h?number=0"]
    with pytest.raises(AccessDenied, match="busy"):
        open_bus("usb", "ft232h")
    with pytest.raises(DeviceNotFound, match="only 1"):
        open_bus("usb", "ft232h", number=1)


@pytest.mark.parametrize("sent", [0, 2, 4])
def test_bytes_that_did_not_go_out_are_a_transfer_that_failed(make, sent):
    port = make("ft232h").bus._port
    device = port.device
    port.device = SimpleNamespace(write=lambda endpoint, data, wait: sent)
    with pytest.raises(TransferFailed, match=f"{sent} of 3 bytes went out"):
        port.write(0x02, b"abc")
    port.device = device


@pytest.mark.parametrize(
    ("active", "brought_back"), [(True, 1), (False, 0), (NotImplementedError, 0)]
)
def test_only_a_kernel_driver_that_was_there_is_brought_back_and_once(
    monkeypatch, active, brought_back
):
    """NotImplementedError: a backend that knows of no kernel drivers."""
    device = MagicMock()
    device.is_kernel_driver_active.side_effect = [active]
    monkeypatch.setattr(usb.core, "find", lambda **given: [device])
    monkeypatch.setattr(usb, "util", MagicMock())
    port = UsbPort(None)
    port.close()
    port.close()
    assert device.detach_kernel_driver.call_count == brought_back
    assert device.attach_kernel_driver.call_count == brought_back


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
