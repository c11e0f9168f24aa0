"""The bridges by name: the driver, and its emulation for virtual://."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from holdfast.core.errors import UsageError
from holdfast.drivers.bus import Bus

BRIDGES = {
    "ft232h": (
        "holdfast.drivers.ft232h:Ft232h",
        "holdfast.drivers.virtual.ft232h:VirtualFt232h",
        "holdfast.drivers.ft232h:FT232H_IDS",
    ),
    "tiny-usb": (
        "holdfast.drivers.tiny_usb:TinyUsb",
        "holdfast.drivers.virtual.tiny_usb:VirtualTinyUsb",
        "holdfast.drivers.tiny_usb:TINY_USB_IDS",
    ),
    "mcp2221": (
        "holdfast.drivers.mcp2221:Mcp2221",
        "holdfast.drivers.virtual.mcp2221:VirtualMcp2221",
        "holdfast.drivers.mcp2221:MCP2221_IDS",
    ),
}
"""Name -> (driver, emulation, USB ids)."""
OWN_SPEED = ("ft232h", "mcp2221")
"""Bridges whose bus speed the driver sets; the firmware of the others decides."""


def open_usb(name: str, number: int, bus_hz: int) -> Bus:
    """The driver on the machine's USB. Raises a DeviceError."""
    from holdfast.drivers.usb import real_backend

    return _driver(name, real_backend(), number, bus_hz)


def bridges_on_usb() -> list[str]:
    """URLs of the bridges that are plugged in. Raises LibraryMissing, AccessDenied."""
    from holdfast.drivers.usb import find_usb, real_backend

    backend = real_backend()
    found = {name: find_usb(ids_of(name), backend) for name in BRIDGES}
    return [
        f"usb://{name}?number={k}"
        for name, devices in found.items()
        for k in range(len(devices))
    ]


def ids_of(name: str) -> Any:
    """The USB ids of a bridge: (vendor, product), .."""
    return _load(BRIDGES[name][2])


def open_native(name: str) -> Bus:
    """The board's own bus, by its number. Raises a DeviceError or UsageError."""
    if not name.isdecimal() or len(name) > 9:
        raise UsageError(
            f"i2c://{name}: not a bus number", next_step="i2c://1 means /dev/i2c-1"
        )
    bus: Bus = _load("holdfast.drivers.native_i2c:NativeI2C")(int(name))
    return bus


@dataclass(frozen=True)
class VirtualBridge:
    """Opens a driver on an emulated bridge, as often as called; backend counts its traffic."""

    name: str
    backend: Any
    bus_hz: int

    def __call__(self) -> Bus:
        """The driver, opened. Raises a DeviceError, as on a real bridge."""
        return _driver(self.name, self.backend, 0, self.bus_hz)


def open_virtual(name: str, hand: Any, bus_hz: int) -> VirtualBridge:
    """An emulated bridge in front of a virtual hand."""
    from holdfast.drivers.virtual.usb_backend import VirtualBackend

    backend = VirtualBackend(
        _load(BRIDGES[name][1])(hand), hand.clock, hand.faults, hand.power_off
    )
    return VirtualBridge(name, backend, bus_hz)


def _driver(name: str, backend: Any, number: int, bus_hz: int) -> Bus:
    driver = _load(BRIDGES[name][0])
    options = {"bus_hz": bus_hz} if name in OWN_SPEED else {}
    bus: Bus = driver(backend, number=number, **options)
    return bus


def _load(path: str) -> Any:
    module, _, name = path.partition(":")
    return getattr(import_module(module), name)
