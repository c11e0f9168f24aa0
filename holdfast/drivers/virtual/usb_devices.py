"""Descriptors of an emulated USB device: as fields, for pyusb, and as bytes, for GET_DESCRIPTOR."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, Protocol

DEVICE, CONFIGURATION, STRING, INTERFACE, ENDPOINT, HID, REPORT = (
    1,
    2,
    3,
    4,
    5,
    0x21,
    0x22,
)
"""bDescriptorType."""
SPEEDS = {"low": 1, "full": 2, "high": 3}
VENDOR_CLASS = (0xFF, 0xFF, 0xFF)
US_ENGLISH = 0x0409
ATTRIBUTES, QUANTUM_MA = 0x80, 2
"""Powered by the bus; bMaxPower counts in steps of 2 mA."""


@dataclass(frozen=True)
class Endpoint:
    """address with its direction bit, BULK or INTERRUPT, and the largest packet."""

    address: int
    attributes: int
    packet: int


@dataclass(frozen=True)
class Interface:
    """usb_class: class, subclass and protocol. report: the HID report descriptor, if any."""

    endpoints: tuple[Endpoint, ...] = ()
    usb_class: tuple[int, int, int] = VENDOR_CLASS
    report: bytes = b""

    @property
    def extra(self) -> bytes:
        """The HID class descriptor that announces the report descriptor (HID 1.11, 6.2.1)."""
        return (
            struct.pack("<BBHBBBH", 9, HID, 0x0111, 0, 1, REPORT, len(self.report))
            if self.report
            else b""
        )


class UsbDescription(Protocol):
    """What descriptors are made from. strings: manufacturer, product, serial number.

    Empty for none.
    """

    vendor: int
    product: int
    release: int
    speed: str
    usb_class: tuple[int, int, int]
    current_ma: int
    interfaces: tuple[Interface, ...]
    strings: tuple[str, str, str]


def device_fields(device: UsbDescription, address: int) -> Any:
    """The device descriptor, with the device's place on the bus."""
    manufacturer, product, serial = (
        k + 1 if text else 0 for k, text in enumerate(device.strings)
    )
    usb_class, subclass, protocol = device.usb_class
    return SimpleNamespace(
        bLength=18,
        bDescriptorType=DEVICE,
        bcdUSB=0x0200,
        bDeviceClass=usb_class,
        bDeviceSubClass=subclass,
        bDeviceProtocol=protocol,
        bMaxPacketSize0=64,
        idVendor=device.vendor,
        idProduct=device.product,
        bcdDevice=device.release,
        iManufacturer=manufacturer,
        iProduct=product,
        iSerialNumber=serial,
        bNumConfigurations=1,
        address=address,
        bus=1,
        port_number=1,
        port_numbers=(1,),
        speed=SPEEDS[device.speed],
    )


def configuration_fields(device: UsbDescription) -> Any:
    """The only configuration."""
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=CONFIGURATION,
        wTotalLength=9 + len(_below(device)),
        bNumInterfaces=len(device.interfaces),
        bConfigurationValue=1,
        iConfiguration=0,
        bmAttributes=ATTRIBUTES,
        bMaxPower=device.current_ma // QUANTUM_MA,
        extra_descriptors=[],
    )


def interface_fields(device: UsbDescription, number: int) -> Any:
    """An interface without alternatives. Raises IndexError past the last."""
    interface = device.interfaces[number]
    usb_class, subclass, protocol = interface.usb_class
    return SimpleNamespace(
        bLength=9,
        bDescriptorType=INTERFACE,
        bInterfaceNumber=number,
        bAlternateSetting=0,
        bNumEndpoints=len(interface.endpoints),
        bInterfaceClass=usb_class,
        bInterfaceSubClass=subclass,
        bInterfaceProtocol=protocol,
        iInterface=0,
        extra_descriptors=list(interface.extra),
    )


def endpoint_fields(device: UsbDescription, number: int, interface: int) -> Any:
    """An endpoint of an interface. Raises IndexError past the last."""
    endpoint = device.interfaces[interface].endpoints[number]
    return SimpleNamespace(
        bLength=7,
        bDescriptorType=ENDPOINT,
        bEndpointAddress=endpoint.address,
        bmAttributes=endpoint.attributes,
        wMaxPacketSize=endpoint.packet,
        bInterval=1,
        bRefresh=0,
        bSynchAddress=0,
        extra_descriptors=[],
    )


def descriptor(
    device: UsbDescription, kind: int, number: int, index: int
) -> bytes | None:
    """The answer to GET_DESCRIPTOR; None where the descriptor does not exist.

    index: the interface or, for a string, its language.
    """
    if kind == DEVICE and not number:
        return _device_bytes(device)
    if kind == CONFIGURATION and not number:
        return _configuration_bytes(device)
    if kind == STRING:
        return _string_bytes(device, number)
    if kind in (HID, REPORT) and index < len(device.interfaces):
        interface = device.interfaces[index]
        return (interface.extra if kind == HID else interface.report) or None
    return None


def _device_bytes(device: UsbDescription) -> bytes:
    fields = list(vars(device_fields(device, 0)).values())
    return struct.pack("<BBHBBBBHHHBBBB", *fields[:14])


def _configuration_bytes(device: UsbDescription) -> bytes:
    fields = list(vars(configuration_fields(device)).values())
    return struct.pack("<BBHBBBBB", *fields[:8]) + _below(device)


def _below(device: UsbDescription) -> bytes:
    """Interfaces, their class descriptors and their endpoints, in order."""
    below = b""
    for number, interface in enumerate(device.interfaces):
        below += (
            bytes(list(vars(interface_fields(device, number)).values())[:9])
            + interface.extra
        )
        for k in range(len(interface.endpoints)):
            below += struct.pack(
                "<BBBBHB", *list(vars(endpoint_fields(device, k, number)).values())[:6]
            )
    return below


def _string_bytes(device: UsbDescription, number: int) -> bytes | None:
    """A string descriptor; number 0 lists the languages."""
    if number == 0:
        return struct.pack("<BBH", 4, STRING, US_ENGLISH)
    if number > len(device.strings) or not device.strings[number - 1]:
        return None
    text = device.strings[number - 1].encode("utf-16-le")
    return bytes([2 + len(text), STRING]) + text


def endpoints(*fields: tuple[int, int, int]) -> tuple[Endpoint, ...]:
    """Short for a tuple of endpoints."""
    return tuple(Endpoint(*one) for one in fields)
