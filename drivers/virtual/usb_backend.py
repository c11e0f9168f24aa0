"""A pyusb backend whose devices are emulated: drivers talk to it as they talk to libusb.

Faults of the bridge happen here, the same way for every device: a stall, a time-out whose reply comes late, half of
an answer, a device that is unplugged (and comes back as another one, with the sensors' power gone).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import usb.backend
import usb.core

from drivers.virtual.clock import Clock
from drivers.virtual.faults import Faults

BULK, INTERRUPT = 2, 3
"""bmAttributes of an endpoint."""
NO_DEVICE, STALL, TIMED_OUT = 19, 32, 110
SPEED = {"low": 1, "full": 2, "high": 3}


def no_device() -> Any:
    """What libusb raises once a device is gone."""
    return usb.core.USBError("No such device (it may have been disconnected)", NO_DEVICE, NO_DEVICE)


def stall() -> Any:
    """What libusb raises on a STALL."""
    return usb.core.USBError("Pipe error", STALL, STALL)


def timed_out() -> Any:
    """What libusb raises when nothing came in time."""
    return usb.core.USBTimeoutError("Operation timed out", TIMED_OUT, TIMED_OUT)


@dataclass(frozen=True)
class Endpoint:
    """address with its direction bit, BULK or INTERRUPT, largest packet."""

    address: int
    attributes: int
    packet: int


@dataclass
class Traffic:
    """Transfers and payload bytes since it was last set to zero."""

    transfers: int = 0
    bytes_out: int = 0
    bytes_in: int = 0


class Device:
    """An emulated device; a bridge overrides what it answers.

    interfaces: endpoints of each interface, by number. kernel_driver: interfaces that one is bound to.
    """

    vendor = product = 0
    speed = "full"
    interfaces: tuple[tuple[Endpoint, ...], ...] = ((),)
    kernel_driver: frozenset[int] = frozenset()

    def control_out(self, request_type: int, request: int, value: int, index: int, data: bytes) -> None:
        """A control transfer with data from the host; raise stall() for one it does not know."""
        raise stall()

    def control_in(self, request_type: int, request: int, value: int, index: int, length: int) -> bytes:
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


@dataclass
class Handle:
    """One plugging-in of the device: dies with the unplugging."""

    generation: int
    detached: set[int] = field(default_factory=set)


class VirtualBackend(usb.backend.IBackend):  # type: ignore[misc]
    """One device on a bus of its own. power_off: called when it is unplugged; traffic counts its transfers."""

    def __init__(
        self, device: Device, clock: Clock, faults: Faults, power_off: Callable[[], None] = lambda: None
    ) -> None:
        self.device, self.traffic = device, Traffic()
        self._clock, self._faults, self._power_off = clock, faults, power_off
        self._born_ns, self._generation, self._gone = clock.now_ns(), 0, False
        self._late: dict[int, list[bytes]] = {}

    # -- what is there

    def enumerate_devices(self) -> Iterator[Any]:
        """The device, unless it is unplugged."""
        if not self._unplugged():
            yield Handle(self._generation)

    def get_parent(self, dev: Any) -> None:
        """No hub."""

    def get_device_descriptor(self, dev: Any) -> Any:
        """Its ids and speed."""
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=self.device.vendor, idProduct=self.device.product, bcdDevice=0x0900,
            iManufacturer=0, iProduct=0, iSerialNumber=0, bNumConfigurations=1, address=dev.generation + 1, bus=1,
            port_number=1, port_numbers=(1,), speed=SPEED[self.device.speed],
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: Any, config: int) -> Any:
        """The only one."""
        if config:
            raise IndexError(config)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=9, bNumInterfaces=len(self.device.interfaces),
            bConfigurationValue=1, iConfiguration=0, bmAttributes=0x80, bMaxPower=50, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: Any, intf: int, alt: int, config: int) -> Any:
        """One without alternatives."""
        if alt or intf >= len(self.device.interfaces):
            raise IndexError(intf)
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=intf, bAlternateSetting=0,
            bNumEndpoints=len(self.device.interfaces[intf]), bInterfaceClass=0xFF, bInterfaceSubClass=0xFF,
            bInterfaceProtocol=0xFF, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: Any, ep: int, intf: int, alt: int, config: int) -> Any:
        """As the device says."""
        endpoint = self.device.interfaces[intf][ep]
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=endpoint.address, bmAttributes=endpoint.attributes,
            wMaxPacketSize=endpoint.packet, bInterval=1, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    # -- opening

    def open_device(self, dev: Any) -> Any:
        """A handle is the device as it was plugged in."""
        self._alive(dev)
        return dev

    def close_device(self, dev_handle: Any) -> None:
        """Nothing to give back."""

    def set_configuration(self, dev_handle: Any, config_value: int) -> None:
        """There is one."""
        self._alive(dev_handle)

    def get_configuration(self, dev_handle: Any) -> int:
        """The only one."""
        self._alive(dev_handle)
        return 1

    def set_interface_altsetting(self, dev_handle: Any, intf: int, altsetting: int) -> None:
        """There are none."""
        self._alive(dev_handle)

    def claim_interface(self, dev_handle: Any, intf: int) -> None:
        """Busy while a kernel driver holds it."""
        self._alive(dev_handle)
        if self.is_kernel_driver_active(dev_handle, intf):
            raise usb.core.USBError("Resource busy", 16, 16)

    def release_interface(self, dev_handle: Any, intf: int) -> None:
        """Given back."""
        self._alive(dev_handle)

    def is_kernel_driver_active(self, dev_handle: Any, intf: int) -> bool:
        """As on a machine whose kernel knows the bridge."""
        return intf in self.device.kernel_driver and intf not in dev_handle.detached

    def detach_kernel_driver(self, dev_handle: Any, intf: int) -> None:
        """Out of the way."""
        dev_handle.detached.add(intf)

    def attach_kernel_driver(self, dev_handle: Any, intf: int) -> None:
        """Back again."""
        dev_handle.detached.discard(intf)

    def clear_halt(self, dev_handle: Any, ep: int) -> None:
        """Nothing stays halted."""
        self._alive(dev_handle)

    def reset_device(self, dev_handle: Any) -> None:
        """The device begins anew; its sensors keep their power."""
        self._alive(dev_handle)
        self._late.clear()
        self.device.reset()

    # -- transfers

    def ctrl_transfer(
        self, dev_handle: Any, request_type: int, request: int, value: int, index: int, data: Any, timeout: int
    ) -> int:
        """Out or in, by the highest bit of the request type."""
        self._begin(dev_handle)
        if request_type & 0x80:
            answer = self.device.control_in(request_type, request, value, index, len(data))
            return self._deliver(self._spoilt(answer, timeout), data)
        self.device.control_out(request_type, request, value, index, bytes(data))
        self._spoilt(b"", timeout)
        self.traffic.bytes_out += len(data)
        return len(data)

    def bulk_write(self, dev_handle: Any, ep: int, intf: int, data: Any, timeout: int) -> int:
        """To an OUT endpoint."""
        self._begin(dev_handle)
        self.device.write(ep, bytes(data))
        self.traffic.bytes_out += len(data)
        return len(data)

    def bulk_read(self, dev_handle: Any, ep: int, intf: int, buff: Any, timeout: int) -> int:
        """From an IN endpoint; a late reply comes before everything else."""
        self._begin(dev_handle)
        late = self._late.get(ep)
        if late and not self._lasts("late"):
            return self._deliver(late.pop(0), buff)
        answer = self.device.read(ep, len(buff))
        if self._lasts("late") and answer:
            self._late.setdefault(ep, []).append(answer)
            answer = b""
        if not answer:
            self._clock.spend(1_000_000 * timeout)
            raise timed_out()
        return self._deliver(self._spoilt(answer, timeout), buff)

    intr_write, intr_read = bulk_write, bulk_read

    # -- faults

    def _deliver(self, answer: bytes, buff: Any) -> int:
        buff[: len(answer)] = type(buff)(buff.typecode, answer)
        self.traffic.bytes_in += len(answer)
        return len(answer)

    def _begin(self, handle: Any) -> None:
        self._alive(handle)
        self.traffic.transfers += 1
        if self._lasts("stall"):
            raise stall()

    def _spoilt(self, answer: bytes, timeout: int) -> bytes:
        if self._lasts("late"):
            self._clock.spend(1_000_000 * timeout)
            raise timed_out()
        return answer[: len(answer) // 2] if self._lasts("short") else answer

    def _alive(self, handle: Any) -> None:
        if self._unplugged() or handle.generation != self._generation:
            raise no_device()

    def _unplugged(self) -> bool:
        gone = self._lasts("unplug")
        if gone and not self._gone:
            self._generation += 1
            self._late.clear()
            self.device.reset()
            self._power_off()
        self._gone = gone
        return gone

    def _lasts(self, kind: str) -> bool:
        return self._faults.lasts(kind, 1e-9 * (self._clock.now_ns() - self._born_ns))


def endpoints(*told: tuple[int, int, int]) -> tuple[Endpoint, ...]:
    """Short for a tuple of them."""
    return tuple(Endpoint(*one) for one in told)

