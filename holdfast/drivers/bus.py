"""What every bridge does: it takes a list of I2C transfers and returns a reply for each.

A bridge that can carry a whole list in one round trip does so; that is why there is a list. A
transfer that no chip acknowledges is no error: its reply says so, and the other replies are not
affected. A bridge that does not answer is an error, a DeviceError.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from holdfast.core.errors import BusStuck

BRIDGE = "ft232h"
"""The bridge on USB, as URLs and messages call it."""
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
            # clocks free one chip; the next one shows only when its channel is enabled
            bus.clear()

    return action()
