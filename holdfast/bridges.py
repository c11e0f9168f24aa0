"""The bridges by name: the driver, and its emulation for virtual://."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from drivers.bus import Bus
from edge_runtime.errors import UsageError

BRIDGES = {
    "ft232h": ("drivers.ft232h:Ft232h", "drivers.virtual.ft232h:VirtualFt232h"),
}
"""Name -> (driver, emulation)."""


def open_usb(name: str, number: int, bus_hz: int) -> Bus:
    """The driver on the machine's USB. Raises a DeviceError."""
    from drivers.usb import real_backend

    return _driver(name, real_backend(), number, bus_hz)


def open_native(name: str) -> Bus:
    """The board's own bus, by its number. Raises a DeviceError, UsageError."""
    if not name.isdecimal():
        raise UsageError(f"i2c://{name}: no number of a bus", next_step="i2c://1 for /dev/i2c-1")
    bus: Bus = _load("drivers.native_i2c:NativeI2C")(int(name))
    return bus


def open_virtual(name: str, hand: Any, bus_hz: int) -> Callable[[], Bus]:
    """What opens the driver on an emulated bridge before a virtual hand; it may be called again after a fault."""
    from drivers.virtual.usb_backend import VirtualBackend

    backend = VirtualBackend(_load(BRIDGES[name][1])(hand), hand.clock, hand.faults, hand.power_off)
    return lambda: _driver(name, backend, 0, bus_hz)


def _driver(name: str, backend: Any, number: int, bus_hz: int) -> Bus:
    driver = _load(BRIDGES[name][0])
    bus: Bus = driver(backend, number=number, bus_hz=bus_hz) if name == "ft232h" else driver(backend, number=number)
    return bus


def _load(path: str) -> Any:
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)
