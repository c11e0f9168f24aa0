"""What opens a bus: a bridge on USB, the board's own, or an emulated one."""

from __future__ import annotations

from functools import partial
from typing import Any

from holdfast.core.errors import UsageError
from holdfast.drivers.bus import BRIDGE, Bus

BUS_HZ = 400_000


def open_bus(scheme: str, name: str, *, number: int = 0, bus_hz: int = BUS_HZ) -> Bus:
    """A bus of this machine. scheme: "usb", or "i2c" with a bus number as its name.

    number: which of several bridges on USB. bus_hz: ignored where the kernel decides. Raises a
    DeviceError or UsageError.
    """
    if scheme == "usb":
        # late: pyusb takes time to load
        from holdfast.drivers.ft232h import Ft232h
        from holdfast.drivers.usb import real_backend

        return Ft232h(real_backend(), number=number, bus_hz=bus_hz)
    if not name.isdecimal():
        raise UsageError(
            f"i2c://{name}: not a bus number", next_step="i2c://1 means /dev/i2c-1"
        )
    # late: only this bus needs smbus2
    from holdfast.drivers.native_i2c import NativeI2C

    return NativeI2C(int(name))


def bridges_on_usb() -> list[str]:
    """URLs of the bridges that are plugged in. Raises LibraryMissing, AccessDenied."""
    from holdfast.drivers.usb import find_usb, real_backend

    found = enumerate(find_usb(real_backend()))
    return [f"usb://{BRIDGE}?number={number}" for number, _ in found]


def open_virtual(hand: Any, bus_hz: int = BUS_HZ) -> partial[Any]:
    """What opens the driver on an emulated FT232H before a virtual hand, as often as called.

    Its first argument is the bridge's backend, which counts traffic. It raises a DeviceError, as on
    a real bridge.
    """
    from holdfast.drivers.ft232h import Ft232h
    from holdfast.drivers.virtual.ft232h import VirtualFt232h
    from holdfast.drivers.virtual.usb_backend import VirtualBackend

    return partial(Ft232h, VirtualBackend(VirtualFt232h(hand)), bus_hz=bus_hz)
