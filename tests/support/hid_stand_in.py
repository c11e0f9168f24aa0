"""Stands in for the module `hid` (hidapi's libusb backend), with a virtual USB device instead of
libusb below it."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import usb.core
import usb.util

HID_CLASS = 3
FOREVER_MS = 60_000
"""Of virtual time: a read without a time-out that nothing answers ends all the same."""


class HidModule(ModuleType):
    """What `import hid` brings: enumerate and device."""

    def __init__(self, backend: Any) -> None:
        super().__init__("hid")
        self.backend = backend
        self.device = lambda: HidDevice(self)

    def enumerate(
        self, vendor_id: int = 0, product_id: int = 0
    ) -> list[dict[str, Any]]:
        """HID interfaces with these ids, 0 for any."""
        found = usb.core.find(find_all=True, backend=self.backend)
        return [
            shown
            for device in found
            if vendor_id in (0, device.idVendor) and product_id in (0, device.idProduct)
            for shown in _interfaces(device)
        ]


class HidDevice:
    """One device: opened by its ids or its path, written and read report by report."""

    def __init__(self, module: HidModule) -> None:
        self._module = module
        self._device: Any = None

    def open(
        self, vendor_id: int = 0, product_id: int = 0, serial_number: str | None = None
    ) -> None:
        """The first with these ids. Raises OSError."""
        for shown in self._module.enumerate(vendor_id, product_id):
            if serial_number in (None, shown["serial_number"]):
                self.open_path(shown["path"])
                return
        raise OSError("open failed")

    def open_path(self, path: bytes) -> None:
        """Detaches the kernel's driver and claims the interface. Raises OSError."""
        paths = [shown["path"] for shown in self._module.enumerate()]
        device = usb.core.find(backend=self._module.backend)
        if path not in paths or device is None:
            raise OSError("open failed")
        interface = int(path.decode().rpartition(".")[2])
        try:
            if device.is_kernel_driver_active(interface):
                device.detach_kernel_driver(interface)
            usb.util.claim_interface(device, interface)
        except usb.core.USBError:
            raise OSError("open failed") from None
        self._device = device
        self._in, self._out = sorted(
            device[0][(interface, 0)], key=lambda one: -one.bEndpointAddress
        )

    def close(self) -> None:
        """Give it back; twice does no harm."""
        device, self._device = self._device, None
        if device is not None:
            usb.util.dispose_resources(device)

    def __del__(self) -> None:
        """As hidapi's: EasyMCP2221 opens its device again without closing it."""
        self.close()

    def write(self, report: list[int] | bytes) -> int:
        """The number of the report first, 0 here and not sent; how many bytes, with it. -1: it
        failed."""
        try:
            return int(self._opened().write(self._out, bytes(report)[1:])) + 1
        except usb.core.USBError:
            return -1

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """A report, or nothing after the time-out; without one it waits. Raises OSError."""
        try:
            return list(
                self._opened().read(
                    self._in, max_length, timeout_ms if timeout_ms > 0 else FOREVER_MS
                )
            )
        except usb.core.USBTimeoutError:
            if timeout_ms > 0:
                return []
            raise OSError("read error") from None
        except usb.core.USBError:
            raise OSError("read error") from None

    def _opened(self) -> Any:
        if self._device is None:
            raise ValueError("not open")
        return self._device


def _interfaces(device: Any) -> list[dict[str, Any]]:
    return [
        _shown(device, one) for one in device[0] if one.bInterfaceClass == HID_CLASS
    ]


def _shown(device: Any, interface: Any) -> dict[str, Any]:
    number = interface.bInterfaceNumber
    return {
        "path": f"1-1:1.{number}".encode(),
        "vendor_id": device.idVendor,
        "product_id": device.idProduct,
        "serial_number": device.serial_number or "",
        "release_number": device.bcdDevice,
        "manufacturer_string": device.manufacturer,
        "product_string": device.product,
        "interface_number": number,
    }
