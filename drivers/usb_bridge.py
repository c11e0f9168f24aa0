"""What the drivers of all USB bridges share: opening, closing and the check of the bus speed."""

from __future__ import annotations

from typing import Any, ClassVar

from holdfast.drivers.usb import UsbId, UsbPort
from holdfast.edge_runtime.errors import UsageError


class UsbBridge:
    """A bridge on USB. A driver sets name, ids and interface, and overrides _begin.

    number: which of the bridges with these ids, 0 is the first. Raises DeviceNotFound,
    AccessDenied, DeviceLost, TransferFailed, or what _begin raises.
    """

    name: str
    ids: ClassVar[tuple[UsbId, ...]]
    interface: ClassVar[int] = 0

    def __init__(self, backend: Any, number: int) -> None:
        self._port = UsbPort(self.name, self.ids, backend, interface=self.interface, number=number)
        try:
            self._begin()
        except BaseException:
            self._port.close()
            raise

    def close(self) -> None:
        """Give the bridge back; a second call does no harm."""
        self._port.close()

    def _begin(self) -> None:
        """Make the bridge ready for transfers."""
        raise NotImplementedError


def require_bus_hz(name: str, bus_hz: int, slowest_hz: int, fastest_hz: int) -> None:
    """Raise UsageError where a bridge cannot run its bus at this speed."""
    if not slowest_hz <= bus_hz <= fastest_hz:
        raise UsageError(
            f"bus_hz={bus_hz} is not a bus speed of the {name}",
            next_step=f"choose {slowest_hz} to {fastest_hz} Hz",
        )
