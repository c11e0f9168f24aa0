"""An emulated USB device: its descriptors as bytes, and how it answers."""

from __future__ import annotations

import struct
from typing import Any

import usb.core

STALL = 32
DEVICE, CONFIGURATION, STRING = 1, 2, 3
"""bDescriptorType."""
US_ENGLISH = 0x0409


def stall() -> Any:
    """What libusb raises on a STALL."""
    return usb.core.USBError("Pipe error", STALL, STALL)


class Device:
    """An emulated device with one interface; a bridge overrides how it answers.

    device_descriptor, configuration: bytes as in USB 2.0, tables 9-8 and 9-10; the configuration
    goes on with its interface and its endpoints. strings: by their index, from 1 on.
    """

    device_descriptor = b""
    configuration = b""
    strings: tuple[str, ...] = ()

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

    def descriptor(self, kind: int, number: int) -> bytes:
        """The answer to GET_DESCRIPTOR. Raises stall() where there is none."""
        if kind == DEVICE:
            return self.device_descriptor
        if kind == CONFIGURATION:
            return self.configuration
        if kind != STRING or number > len(self.strings):
            raise stall()
        if number == 0:
            return struct.pack("<BBH", 4, STRING, US_ENGLISH)
        text = self.strings[number - 1].encode("utf-16-le")
        return bytes([2 + len(text), STRING]) + text
