"""A USB device through pyusb, with typed errors: the only importer of usb and libusb_package."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import libusb_package
import usb.backend.libusb1
import usb.core
import usb.util

from holdfast.core.errors import (
    AccessDenied,
    DeviceError,
    DeviceLost,
    DeviceNotFound,
    LibraryMissing,
    TransferFailed,
)

TIMEOUT_MS = 10
"""A live stream cannot wait longer: at 150 Hz this is one and a half samples."""
DRAIN_MS = 5
DRAINED_AT_MOST = 64
NO_DEVICE, NO_ACCESS, BUSY, STALL, TIMED_OUT = 19, 13, 16, 32, 110

UsbId = tuple[int, int]
"""Vendor, product."""


def real_backend() -> Any:
    """The system's libusb, else the packaged one. Raises LibraryMissing."""
    backend = usb.backend.libusb1.get_backend() or libusb_package.get_libusb1_backend()
    if backend is None:
        raise LibraryMissing(
            "no libusb",
            cause="neither the system's nor the packaged library loads",
            next_step="holdfast doctor shows what is missing",
        )
    return backend


def find_usb(ids: Iterable[UsbId], backend: Any) -> list[Any]:
    """Unopened pyusb devices with one of these ids. Raises AccessDenied or TransferFailed."""
    wanted = set(ids)
    with named_errors("USB"):
        found = usb.core.find(find_all=True, backend=backend)
        return [
            device for device in found if (device.idVendor, device.idProduct) in wanted
        ]


class Stalled(TransferFailed):
    """The device refused a transfer with STALL."""


class UsbPort:
    """An opened device with one claimed interface; its kernel driver is detached.

    name: for messages. number: which device with these ids, 0 is the first found. Raises
    DeviceNotFound, AccessDenied or DeviceLost.
    """

    def __init__(
        self,
        name: str,
        ids: Iterable[UsbId],
        backend: Any,
        *,
        interface: int = 0,
        number: int = 0,
    ) -> None:
        self.name, self.interface = name, interface
        ids = list(ids)
        found = find_usb(ids, backend)
        if number >= len(found):
            wanted = " or ".join(
                f"{vendor:04x}:{product:04x}" for vendor, product in ids
            )
            raise DeviceNotFound(
                f"only {len(found)} on USB" if found else "none on USB",
                where=name,
                cause=f"not plugged in, or another bridge than {wanted}",
                next_step="holdfast scan lists the bridges on USB",
            )
        self.device = found[number]
        self._attached = False
        self._closed = False
        with named_errors(name):
            self._detach()
            usb.util.claim_interface(self.device, interface)

    def write(self, endpoint: int, data: bytes, timeout_ms: int = TIMEOUT_MS) -> None:
        """Send all of the data. Raises TransferFailed, DeviceLost."""
        with self._unhalting(endpoint):
            sent = self.device.write(endpoint, data, timeout_ms)
        if sent != len(data):
            raise TransferFailed(
                f"{sent} of {len(data)} bytes went out", where=self.name
            )

    def read(self, endpoint: int, length: int, timeout_ms: int = TIMEOUT_MS) -> bytes:
        """What one transfer brings, at most length bytes. Raises TransferFailed, DeviceLost."""
        with self._unhalting(endpoint):
            return bytes(self.device.read(endpoint, length, timeout_ms))

    def control_out(
        self,
        request_type: int,
        request: int,
        value: int,
        index: int,
        data: bytes = b"",
        timeout_ms: int = TIMEOUT_MS,
    ) -> None:
        """A control transfer out; all of the data must be sent."""
        with named_errors(self.name):
            sent = self.device.ctrl_transfer(
                request_type, request, value, index, data, timeout_ms
            )
        if sent != len(data):
            raise TransferFailed(
                f"{sent} of {len(data)} bytes went out", where=self.name
            )

    def control_in(
        self,
        request_type: int,
        request: int,
        value: int,
        index: int,
        length: int,
        timeout_ms: int = TIMEOUT_MS,
    ) -> bytes:
        """A control transfer in: its data, which may be shorter than length."""
        with named_errors(self.name):
            return bytes(
                self.device.ctrl_transfer(
                    request_type, request, value, index, length, timeout_ms
                )
            )

    def drain(self, endpoint: int, length: int, *, empty: int = 0) -> None:
        """Read away what is left of a transfer that timed out, so that no later request gets it.

        empty: length of the answer of a device that has nothing to send.
        """
        for _ in range(DRAINED_AT_MOST):
            try:
                if len(self.read(endpoint, length, DRAIN_MS)) <= empty:
                    return
            except TransferFailed:
                return

    def clear_halt(self, endpoint: int) -> None:
        """End the stall of an endpoint."""
        with named_errors(self.name):
            self.device.clear_halt(endpoint)

    @contextmanager
    def _unhalting(self, endpoint: int) -> Iterator[None]:
        """Typed errors.

        A stalled endpoint stays halted until the host clears it, so clear it at once.
        """
        try:
            with named_errors(self.name):
                yield
        except Stalled:
            self.clear_halt(endpoint)
            raise

    def reset(self) -> None:
        """Reset the device on its USB port and claim it again."""
        with named_errors(self.name):
            self.device.reset()
            self._detach()
            usb.util.claim_interface(self.device, self.interface)

    def close(self) -> None:
        """Give the interface back to its kernel driver.

        Never raises, a second call does no harm.
        """
        if self._closed:
            return
        self._closed = True
        try:
            usb.util.release_interface(self.device, self.interface)
            if self._attached:
                self.device.attach_kernel_driver(self.interface)
        except (usb.core.USBError, NotImplementedError):
            pass  # it is gone, and there is nothing to give back
        usb.util.dispose_resources(self.device)

    def _detach(self) -> None:
        try:
            if self.device.is_kernel_driver_active(self.interface):
                self.device.detach_kernel_driver(self.interface)
                self._attached = True
        except NotImplementedError:
            pass  # a backend without kernel drivers


@contextmanager
def named_errors(name: str) -> Iterator[None]:
    """pyusb's errors as ours."""
    try:
        yield
    except usb.core.USBTimeoutError:
        raise TransferFailed(
            "no answer in time", where=name, cause="a bridge or a bus that hangs"
        ) from None
    except usb.core.NoBackendError:
        raise LibraryMissing(
            "no libusb", where=name, next_step="holdfast doctor"
        ) from None
    except usb.core.USBError as error:
        raise _named(error, name) from None


def _named(error: Any, name: str) -> DeviceError:
    if error.errno == NO_DEVICE:
        return DeviceLost(
            "no longer on USB",
            where=name,
            cause="it was unplugged, or its power dipped",
        )
    if error.errno == NO_ACCESS:
        return AccessDenied(
            "not allowed to open it",
            where=name,
            cause="no udev rule",
            next_step="holdfast doctor",
        )
    if error.errno == BUSY:
        return AccessDenied(
            "busy",
            where=name,
            cause="another program has it open",
            next_step="holdfast doctor",
        )
    if error.errno == TIMED_OUT:
        return TransferFailed(
            "no answer in time", where=name, cause="a bridge or a bus that hangs"
        )
    if error.errno == STALL:
        return Stalled("the bridge refused the transfer (stall)", where=name)
    return TransferFailed(f"USB error {error.errno}: {error.strerror}", where=name)
