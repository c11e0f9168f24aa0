"""The bridges by name: one table of backends, and what opens one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from holdfast.core.errors import UsageError
from holdfast.drivers.bus import Bus

BRIDGES = {
    "ft232h": ("ft232h:Ft232h", "virtual.ft232h:VirtualFt232h"),
}
"""Name -> (driver, its emulation for virtual://), loaded when one is opened."""
MOST_DIGITS = 9
BUS_HZ = 400_000


def open_bus(scheme: str, name: str, *, number: int = 0, bus_hz: int = BUS_HZ) -> Bus:
    """A bus of this machine. scheme: "usb", with a name of BRIDGES, or "i2c" with a bus number.

    number: which of several bridges on USB. bus_hz: ignored where a firmware or the kernel decides.
    Raises a DeviceError or UsageError.
    """
    if scheme == "usb":
        # late: pyusb takes time to load, and the board's own bus does without it
        from holdfast.drivers.usb import real_backend

        return _driver(name, real_backend(), number, bus_hz)
    if not name.isdecimal() or len(name) > MOST_DIGITS:
        raise UsageError(
            f"i2c://{name}: not a bus number", next_step="i2c://1 means /dev/i2c-1"
        )
    # late: only this bus needs smbus2
    from holdfast.drivers.native_i2c import NativeI2C

    return NativeI2C(int(name))


def bridges_on_usb() -> list[str]:
    """URLs of the bridges that are plugged in. Raises LibraryMissing, AccessDenied."""
    from holdfast.drivers.usb import find_usb, real_backend

    backend = real_backend()
    urls = []
    for name in BRIDGES:
        count = len(find_usb(ids_of(name), backend))
        urls += [f"usb://{name}?number={k}" for k in range(count)]
    return urls


def ids_of(name: str) -> Sequence[tuple[int, int]]:
    """The USB ids of a bridge: (vendor, product), .."""
    ids: Sequence[tuple[int, int]] = _load(BRIDGES[name][0]).ids
    return ids


@dataclass(frozen=True)
class VirtualBridge:
    """Opens a driver on an emulated bridge, as often as called; backend counts its traffic."""

    name: str
    backend: Any
    bus_hz: int

    def __call__(self) -> Bus:
        """The driver, opened. Raises a DeviceError, as on a real bridge."""
        return _driver(self.name, self.backend, 0, self.bus_hz)


def open_virtual(name: str, hand: Any, bus_hz: int = BUS_HZ) -> VirtualBridge:
    """An emulated bridge in front of a virtual hand."""
    from holdfast.drivers.virtual.usb_backend import VirtualBackend

    device = _load(BRIDGES[name][1])(hand)
    backend = VirtualBackend(device, hand.clock, hand.faults, hand.power_off)
    return VirtualBridge(name, backend, bus_hz)


def _driver(name: str, backend: Any, number: int, bus_hz: int) -> Bus:
    bus: Bus = _load(BRIDGES[name][0])(backend, number=number, bus_hz=bus_hz)
    return bus


def _load(path: str) -> Any:
    """A class by its module within this package and its name."""
    module, _, name = path.partition(":")
    return getattr(import_module(f"holdfast.drivers.{module}"), name)
