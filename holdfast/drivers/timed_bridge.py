"""EXPERIMENT: the FT232H that times its own scans, on USB and emulated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from holdfast.drivers.bridges import VirtualBridge
from holdfast.drivers.bus import Bus


def open_timed_usb(number: int, bus_hz: int, now_ns: Callable[[], int]) -> Bus:
    """The driver on the machine's USB. Raises a DeviceError."""
    from holdfast.drivers.ft232h_timed import TimedFt232h
    from holdfast.drivers.usb import real_backend

    return TimedFt232h(real_backend(), number=number, bus_hz=bus_hz, now_ns=now_ns)


def timed_virtual(
    bridge: VirtualBridge, now_ns: Callable[[], int]
) -> Callable[[], Bus]:
    """Opens the driver on an emulated bridge, which takes a block at once.

    The bridge's hand needs a device_clock.
    """
    from holdfast.drivers.ft232h_timed import TimedFt232h
    from holdfast.drivers.virtual.usb_devices import AtOnce

    return lambda: TimedFt232h(
        bridge.backend, bus_hz=bridge.bus_hz, now_ns=now_ns, writer=AtOnce()
    )


def device_clock(clock: Any) -> Any:
    """The clock of an emulated hand that is read while its host is away."""
    from holdfast.drivers.virtual.clock import DeviceClock

    return DeviceClock(clock)
