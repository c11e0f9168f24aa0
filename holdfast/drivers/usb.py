"""The FT232H through pyusb, with typed errors: the only importer of usb and libusb_package."""

from __future__ import annotations

from collections.abc import Iterator
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
from holdfast.drivers.bus import BRIDGE

TIMEOUT_MS = 10
"""A live stream cannot wait longer: at 150 Hz this is one and a half samples."""
DRAIN_MS = 5
DRAINED_AT_MOST = 64
NO_DEVICE, NO_ACCESS, BUSY, STALL, TIMED_OUT = 19, 13, 16, 32, 110

DOCTOR = "holdfast doctor"
INTERFACE = 0
"""Of an FT232H there is one."""

VENDOR, PRODUCT = 0x0403, 0x6014


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


def find_usb(backend: Any) -> list[Any]:
    """Unopened pyusb devices, one for each FT232H. Raises AccessDenied or TransferFailed."""
    with named_errors("USB"):
        found = usb.core.find(
            find_all=True, backend=backend, idVendor=VENDOR, idProduct=PRODUCT
        )
        return list(found)


class Stalled(TransferFailed):
    """The device refused a transfer with STALL."""


class UsbPort:
    """An opened FT232H with its interface claimed; the kernel's driver is detached.

    number: which one, 0 is the first found. Raises DeviceNotFound, AccessDenied or DeviceLost.
    """

    def __init__(self, backend: Any, *, number: int = 0) -> None:
        found = find_usb(backend)
        if number >= len(found):
            raise DeviceNotFound(
                f"only {len(found)} on USB" if found else "none on USB",
                where=BRIDGE,
                cause=f"not plugged in, or another bridge than {VENDOR:04x}:{PRODUCT:04x}",
                next_step="holdfast scan lists the bridges on USB",
            )

        self.device = found[number]
        self._attached = False
        self._closed = False
        # the kernel's driver may have the interface
        self._claim()

    def write(self, endpoint: int, data: bytes) -> None:
        """Send all of the data. Raises TransferFailed, DeviceLost."""
        with self._unhalting(endpoint):
            sent = self.device.write(endpoint, data, TIMEOUT_MS)
        if sent != len(data):
            what = f"{sent} of {len(data)} bytes went out"
            raise TransferFailed(what, where=BRIDGE)

    def read(self, endpoint: int, length: int, timeout_ms: int = TIMEOUT_MS) -> bytes:
        """What one transfer brings, at most length bytes. Raises TransferFailed, DeviceLost."""
        with self._unhalting(endpoint):
            return bytes(self.device.read(endpoint, length, timeout_ms))

    def control_out(
        self, request_type: int, request: int, value: int, index: int
    ) -> None:
        """A control transfer out, without data."""
        with named_errors():
            self.device.ctrl_transfer(
                request_type, request, value, index, b"", TIMEOUT_MS
            )

    def drain(self, endpoint: int, length: int, *, empty: int) -> None:
        """Read away what is left of a transfer that timed out, so that no later request gets it.

        empty: length of the answer of a device that has nothing to send.
        """
        for _ in range(DRAINED_AT_MOST):
            try:
                if len(self.read(endpoint, length, DRAIN_MS)) <= empty:
                    return
            except TransferFailed:
                return

    def close(self) -> None:
        """Give the interface back to its kernel driver.

        Never raises, a second call does no harm.
        """
        if self._closed:
            return
        self._closed = True
        try:
            usb.util.release_interface(self.device, INTERFACE)
            if self._attached:
                self.device.attach_kernel_driver(INTERFACE)
        except (usb.core.USBError, NotImplementedError):
            pass  # it is gone, and there is nothing to give back

        usb.util.dispose_resources(self.device)

    @contextmanager
    def _unhalting(self, endpoint: int) -> Iterator[None]:
        """Raise typed errors, and end a stall.

        A stalled endpoint stays halted until the host clears it, so clear it at once.
        """
        try:
            with named_errors():
                yield
        except Stalled:
            with named_errors():
                self.device.clear_halt(endpoint)
            raise

    def _claim(self) -> None:
        """Detach the kernel's driver, and claim the interface."""
        with named_errors():
            try:
                if self.device.is_kernel_driver_active(INTERFACE):
                    self.device.detach_kernel_driver(INTERFACE)
                    self._attached = True
            except NotImplementedError:
                pass  # a backend without kernel drivers
            usb.util.claim_interface(self.device, INTERFACE)


@contextmanager
def named_errors(name: str = BRIDGE) -> Iterator[None]:
    """Raise pyusb's errors as ours. name: of the bridge."""
    try:
        yield
    except usb.core.NoBackendError:
        raise LibraryMissing("no libusb", where=name, next_step=DOCTOR) from None
    except usb.core.USBError as error:
        raise _named(error, name) from None


ERRORS: dict[int, tuple[type[DeviceError], str, str, str]] = {
    TIMED_OUT: (
        TransferFailed,
        "no answer in time",
        "a bridge or a bus that hangs",
        "",
    ),
    NO_DEVICE: (
        DeviceLost,
        "no longer on USB",
        "it was unplugged, or its power dipped",
        "",
    ),
    # doctor answers both, and their causes differ
    NO_ACCESS: (AccessDenied, "not allowed to open it", "no udev rule", DOCTOR),
    BUSY: (AccessDenied, "busy", "another program has it open", DOCTOR),
    STALL: (Stalled, "the bridge refused the transfer (stall)", "", ""),
}
"""Number of libusb's error -> ours: what, likely cause, next step."""


def _named(error: Any, name: str) -> DeviceError:
    # a time-out has a class of its own, or only its errno
    timed_out = isinstance(error, usb.core.USBTimeoutError)
    number = TIMED_OUT if timed_out else error.errno
    if number not in ERRORS:
        return TransferFailed(f"USB error {number}: {error.strerror}", where=name)
    kind, what, cause, next_step = ERRORS[number]
    return kind(what, where=name, cause=cause, next_step=next_step)
