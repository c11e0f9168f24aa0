"""A pyusb backend whose devices are emulated: drivers use it as they use libusb.

Faults of the bridge happen here: a stall, a time-out whose reply comes late, half of an answer, a
device that is unplugged (and comes back as another one, after the sensors lost their power).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import usb.backend
import usb.core

from holdfast.core.contract import Json
from holdfast.drivers.virtual.ft232h import (
    IN_ENDPOINT,
    OUT_ENDPOINT,
    PACKET,
    VirtualFt232h,
    stall,
)

BUSY = 16
NO_DEVICE = 19
TIMED_OUT = 110
LIBUSB_ERROR_BUSY = -6
# An FT232H without strings, by the fields of USB 2.0 (tables 9-8, 9-10, 9-12 and 9-13).
DEVICE: Json = {
    "bLength": 18,
    "bDescriptorType": 1,
    "bcdUSB": 0x0200,
    "bDeviceClass": 0,
    "bDeviceSubClass": 0,
    "bDeviceProtocol": 0,
    "bMaxPacketSize0": 64,
    "idVendor": 0x0403,
    "idProduct": 0x6014,
    "bcdDevice": 0x0900,
    "iManufacturer": 0,
    "iProduct": 0,
    "iSerialNumber": 0,
    "bNumConfigurations": 1,
    "bus": 1,
    "port_number": 1,
    "port_numbers": (1,),
    "speed": 3,
}
"""Of high speed."""
CONFIGURATION = SimpleNamespace(
    bLength=9,
    bDescriptorType=2,
    wTotalLength=32,
    bNumInterfaces=1,
    bConfigurationValue=1,
    iConfiguration=0,
    bmAttributes=0x80,
    bMaxPower=50,
    extra_descriptors=[],
)
"""100 mA from the bus."""
INTERFACE = SimpleNamespace(
    bLength=9,
    bDescriptorType=4,
    bInterfaceNumber=0,
    bAlternateSetting=0,
    bNumEndpoints=2,
    bInterfaceClass=0xFF,
    bInterfaceSubClass=0xFF,
    bInterfaceProtocol=0xFF,
    iInterface=0,
    extra_descriptors=[],
)
"""One vendor's own."""
ENDPOINTS = (IN_ENDPOINT, OUT_ENDPOINT)
ENDPOINT: Json = {
    "bLength": 7,
    "bDescriptorType": 5,
    "bmAttributes": 2,
    "wMaxPacketSize": PACKET,
    "bInterval": 1,
    "bRefresh": 0,
    "bSynchAddress": 0,
    "extra_descriptors": [],
}
"""Bulk."""


def no_device() -> Any:
    """What libusb raises once a device is gone."""
    text = "No such device (it may have been disconnected)"
    return usb.core.USBError(text, NO_DEVICE, NO_DEVICE)


def timed_out() -> Any:
    """What libusb raises when no answer comes in time."""
    return usb.core.USBTimeoutError("Operation timed out", TIMED_OUT, TIMED_OUT)


def busy() -> Any:
    """What libusb raises when another handle or a kernel driver has the interface."""
    return usb.core.USBError("Resource busy", LIBUSB_ERROR_BUSY, BUSY)


@dataclass
class Traffic:
    """Transfers and payload bytes since it was last set to zero."""

    transfers: int = 0
    bytes_out: int = 0
    bytes_in: int = 0


@dataclass(eq=False)
class Handle:
    """A device as found or opened; it becomes invalid when the device leaves USB."""

    generation: int


class VirtualBackend(usb.backend.IBackend):  # type: ignore[misc]
    """One device on its own bus, with a kernel driver."""

    def __init__(self, device: VirtualFt232h) -> None:
        self.device = device
        self.traffic = Traffic()
        self._hand = device.hand
        self._generation = 0
        self._late: dict[int, list[bytes]] = {}
        self._claimed: Handle | None = None
        self._detached = False

    # -- what is there

    def enumerate_devices(self) -> Iterator[Any]:
        """The device, unless it is unplugged."""
        if not self._unplugged():
            yield Handle(self._generation)

    def get_parent(self, dev: Any) -> None:
        """No hub."""

    def get_device_descriptor(self, dev: Any) -> Any:
        """Its ids and its speed."""
        return SimpleNamespace(address=dev.generation + 1, **DEVICE)

    def get_configuration_descriptor(self, dev: Any, config: int) -> Any:
        return (CONFIGURATION,)[config]

    def get_interface_descriptor(
        self, dev: Any, intf: int, alt: int, config: int
    ) -> Any:
        """The only one, without alternatives."""
        return (INTERFACE,)[intf + alt]

    def get_endpoint_descriptor(
        self, dev: Any, ep: int, intf: int, alt: int, config: int
    ) -> Any:
        return SimpleNamespace(bEndpointAddress=ENDPOINTS[ep], **ENDPOINT)

    # -- opening

    def open_device(self, dev: Any) -> Any:
        """A new handle; a second one is allowed, but cannot claim the interface too."""
        self._require_there(dev)
        return Handle(dev.generation)

    def close_device(self, dev_handle: Any) -> None:
        if self._claimed is dev_handle:
            self._claimed = None

    def set_configuration(self, dev_handle: Any, config_value: int) -> None:
        """It has one, which is set already."""
        self._require_there(dev_handle)

    def get_configuration(self, dev_handle: Any) -> int:
        self._require_there(dev_handle)
        return 1

    def claim_interface(self, dev_handle: Any, intf: int) -> None:
        """Busy while the kernel's driver or another handle has it; one may claim it twice."""
        self._require_there(dev_handle)
        if not self._detached or self._claimed not in (None, dev_handle):
            raise busy()
        self._claimed = dev_handle

    def release_interface(self, dev_handle: Any, intf: int) -> None:
        self._require_there(dev_handle)
        self.close_device(dev_handle)

    def is_kernel_driver_active(self, dev_handle: Any, intf: int) -> bool:
        """As on a machine whose kernel has a driver for the bridge."""
        return not self._detached

    def detach_kernel_driver(self, dev_handle: Any, intf: int) -> None:
        """Detach it for every handle."""
        self._detached = True

    def attach_kernel_driver(self, dev_handle: Any, intf: int) -> None:
        """Attach it again; busy while the interface is claimed."""
        if self._claimed is not None:
            raise busy()
        self._detached = False

    def clear_halt(self, dev_handle: Any, ep: int) -> None:
        """No endpoint of it stays halted."""
        self._require_there(dev_handle)

    # -- transfers

    def ctrl_transfer(
        self,
        dev_handle: Any,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: Any,
        timeout: int,
    ) -> int:
        """Out; nothing asks this device for descriptors or the state of its port."""
        self._begin(dev_handle)
        self.device.control_out(request, value)
        self._spoilt(b"", timeout)
        self.traffic.bytes_out += len(data)
        return len(data)

    def bulk_write(
        self, dev_handle: Any, ep: int, intf: int, data: Any, timeout: int
    ) -> int:
        """To an OUT endpoint; its interface is claimed if it was not."""
        self._begin(dev_handle)
        self.claim_interface(dev_handle, intf)
        self.device.write(ep, bytes(data))
        self.traffic.bytes_out += len(data)
        return len(data)

    def bulk_read(
        self, dev_handle: Any, ep: int, intf: int, buff: Any, timeout: int
    ) -> int:
        """From an IN endpoint; a late reply comes before everything else."""
        self._begin(dev_handle)
        self.claim_interface(dev_handle, intf)
        # a late answer stays in the device's buffer until it is read
        late = self._late.get(ep)
        if late and not self._lasts("late"):
            return self._deliver(late.pop(0), buff)
        answer = self.device.read(ep, len(buff))
        if self._lasts("late") and answer:
            self._late.setdefault(ep, []).append(answer)
            answer = b""
        if not answer:
            self._hand.clock.spend(1_000_000 * timeout)
            raise timed_out()
        return self._deliver(self._spoilt(answer, timeout), buff)

    # -- faults

    def _deliver(self, answer: bytes, buff: Any) -> int:
        buff[: len(answer)] = type(buff)(buff.typecode, answer)
        self.traffic.bytes_in += len(answer)
        return len(answer)

    def _begin(self, handle: Any) -> None:
        self._require_there(handle)
        self.traffic.transfers += 1
        if self._lasts("stall"):
            raise stall()

    def _spoilt(self, answer: bytes, timeout: int) -> bytes:
        if self._lasts("late"):
            self._hand.clock.spend(1_000_000 * timeout)
            raise timed_out()
        return answer[: len(answer) // 2] if self._lasts("short") else answer

    def _require_there(self, handle: Any) -> None:
        if self._unplugged() or handle.generation != self._generation:
            raise no_device()

    def _unplugged(self) -> bool:
        """Whether it is away. A device that leaves drops all claims and late replies."""
        gone = self._hand.unplugged()
        if self._generation != self._hand.generation:
            self._generation = self._hand.generation
            self._claimed = None
            self._detached = False
            self._late.clear()
            self.device.reset()
        return gone

    def _lasts(self, kind: str) -> bool:
        return self._hand.faults.lasts(kind)
