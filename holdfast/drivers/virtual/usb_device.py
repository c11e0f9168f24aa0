"""An emulated USB device: its endpoints, its descriptors as bytes, and how it answers."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import usb.core

BULK = 2
"""bmAttributes of an endpoint."""
STALL = 32
DEVICE, CONFIGURATION, STRING, INTERFACE, ENDPOINT = 1, 2, 3, 4, 5
"""bDescriptorType."""
VENDOR_CLASS = (0xFF, 0xFF, 0xFF)
US_ENGLISH = 0x0409
BUS_POWERED = 0x80
QUANTUM_MA = 2
"""bMaxPower counts in steps of 2 mA."""


def stall() -> Any:
    """What libusb raises on a STALL."""
    return usb.core.USBError("Pipe error", STALL, STALL)


@dataclass(frozen=True)
class Endpoint:
    """address with its direction bit, its attributes, and the largest packet."""

    address: int
    attributes: int
    packet: int

    @property
    def descriptor(self) -> bytes:
        """USB 2.0, table 9-13; an interval of 1."""
        return struct.pack(
            "<BBBBHB", 7, ENDPOINT, self.address, self.attributes, self.packet, 1
        )


@dataclass(frozen=True)
class Interface:
    """usb_class: class, subclass and protocol."""

    endpoints: tuple[Endpoint, ...] = ()
    usb_class: tuple[int, int, int] = VENDOR_CLASS

    def descriptor(self, number: int) -> bytes:
        """USB 2.0, table 9-12; no alternative, no string."""
        head = bytes([9, INTERFACE, number, 0, len(self.endpoints)])
        return head + bytes(self.usb_class) + b"\0"


class Device:
    """An emulated device; a bridge overrides how it answers.

    interfaces: by number. kernel_driver: interfaces that a kernel driver is bound to. strings:
    manufacturer, product and serial number, empty for none.
    """

    vendor = product = 0
    release = 0x0100
    speed = "full"
    usb_class = (0, 0, 0)
    current_ma = 100
    strings = ("", "", "")
    interfaces: tuple[Interface, ...] = (Interface(),)
    kernel_driver: frozenset[int] = frozenset()

    def control_out(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> None:
        """A control transfer with data from the host; raise stall() for one it does not know."""
        raise stall()

    def control_in(
        self, request_type: int, request: int, value: int, index: int, length: int
    ) -> bytes:
        """A control transfer that asks for data."""
        raise stall()

    def write(self, endpoint: int, data: bytes) -> None:
        """Data for an OUT endpoint."""
        raise stall()

    def read(self, endpoint: int, length: int) -> bytes:
        """What an IN endpoint has, at most length bytes; nothing is a time-out."""
        raise stall()

    def reset(self) -> None:
        """Back to what it is after being plugged in."""

    # -- descriptors

    @property
    def device_descriptor(self) -> bytes:
        """USB 2.0, table 9-8: 64 bytes in a control packet, one configuration."""
        head = struct.pack("<BBH", 18, DEVICE, 0x0200)
        kind = bytes(self.usb_class) + bytes([64])
        ids = struct.pack("<HHH", self.vendor, self.product, self.release)
        # a string that is empty has no descriptor, and index 0 says so
        strings = [k if text else 0 for k, text in enumerate(self.strings, 1)]
        return head + kind + ids + bytes(strings) + bytes([1])

    @property
    def configuration_descriptor(self) -> bytes:
        """USB 2.0, table 9-10, with the interfaces and endpoints behind it."""
        below = b""
        for number, interface in enumerate(self.interfaces):
            below += interface.descriptor(number)
            for endpoint in interface.endpoints:
                below += endpoint.descriptor
        total = 9 + len(below)
        power = self.current_ma // QUANTUM_MA
        head = struct.pack("<BBHB", 9, CONFIGURATION, total, len(self.interfaces))
        return head + bytes([1, 0, BUS_POWERED, power]) + below

    def string_descriptor(self, number: int) -> bytes | None:
        """One of the strings; number 0 lists the languages."""
        if number == 0:
            return struct.pack("<BBH", 4, STRING, US_ENGLISH)
        if number > len(self.strings) or not self.strings[number - 1]:
            return None
        text = self.strings[number - 1].encode("utf-16-le")
        return bytes([2 + len(text), STRING]) + text

    def descriptor(self, kind: int, number: int) -> bytes | None:
        """The answer to GET_DESCRIPTOR; None where the descriptor does not exist."""
        if kind == DEVICE and not number:
            return self.device_descriptor
        if kind == CONFIGURATION and not number:
            return self.configuration_descriptor
        if kind == STRING:
            return self.string_descriptor(number)
        return None
