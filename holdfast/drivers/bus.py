"""What every bridge does.

It takes a list of I2C transfers and returns a reply for each, in one call.

A bridge that can carry a whole list in one round trip does so; that is why there is a list. A
transfer that no chip acknowledges is no error: its reply says so, and the other replies are not
affected. A bridge that does not answer is an error, a DeviceError.

What the drivers of all USB bridges share: opening, closing and the check of the bus speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar

from holdfast.core.errors import BusStuck, TransferFailed, UsageError
from holdfast.drivers.usb import UsbId, UsbPort

MOST_CLEARS = 9
"""One chip behind each of a mux's eight channels may hold SDA low, but only while it is enabled."""


@dataclass(frozen=True)
class Transfer:
    """START, address (7 bits), the bytes to write, a repeated START, `read` bytes to read, STOP."""

    address: int
    write: bytes = b""
    read: int = 0


@dataclass(frozen=True)
class Reply:
    """The data read. acked is False where a byte was not acknowledged; then data is empty."""

    data: bytes
    acked: bool


NOT_ACKED = Reply(b"", acked=False)


class Bus(Protocol):
    """An I2C bus behind a bridge."""

    name: str
    """For messages, such as "ft232h"."""

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """Carry out the transfers in order, a reply for each.

        Raises a DeviceError if the bridge fails.
        """
        ...

    def clear(self) -> None:
        """Free a bus on which a chip holds SDA low. Raises BusStuck where that cannot be done."""
        ...

    def close(self) -> None:
        """Give the bridge back; a second call does no harm."""
        ...


Result = TypeVar("Result")


def freeing(bus: Bus, action: Callable[[], Result]) -> Result:
    """Do the action; where a chip holds the bus low, free the bus and repeat the whole action.

    Raises BusStuck where the bus cannot be freed, and what the action raises.
    """
    for _ in range(MOST_CLEARS):
        try:
            return action()
        except BusStuck:
            bus.clear()
    return action()


def require_short(name: str, transfer: Transfer, most_bytes: int) -> None:
    """Raise TransferFailed where a transfer is longer than the bridge can carry."""
    longest = max(len(transfer.write), transfer.read)
    if longest > most_bytes:
        raise TransferFailed(
            f"{longest} bytes in one transfer",
            where=name,
            cause=f"it carries at most {most_bytes} bytes",
        )


class UsbBridge:
    """A bridge on USB. A driver sets name, ids and interface, and overrides _begin.

    number: which of the bridges with these ids, 0 is the first. Raises DeviceNotFound,
    AccessDenied, DeviceLost, TransferFailed, or what _begin raises.
    """

    name: str
    ids: ClassVar[tuple[UsbId, ...]]
    interface: ClassVar[int] = 0

    def __init__(self, backend: Any, number: int) -> None:
        self._port = UsbPort(
            self.name, self.ids, backend, interface=self.interface, number=number
        )
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
