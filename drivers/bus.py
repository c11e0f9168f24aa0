"""What every bridge does: a list of I2C transfers in, a reply for each out, in one call.

A bridge that can carry a whole list in one round trip does (that is what the list is for). A
transfer that nobody acknowledges is no error: its reply says so, and the others are as good as
ever. What is an error is a bridge that does not answer, which is a DeviceError.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from edge_runtime.errors import BusStuck

MOST_CLEARS = 9
"""A chip may hold SDA low behind each of a mux's eight channels, and only while that is joined."""


@dataclass(frozen=True)
class Transfer:
    """START address, what is written, then (after a repeated start) `read` bytes, STOP. address: 7
    bits."""

    address: int
    write: bytes = b""
    read: int = 0


@dataclass(frozen=True)
class Reply:
    """What came back: acked is False where the address, or a byte written, was not acknowledged;
    then data is empty."""

    data: bytes
    acked: bool


NOT_ACKED = Reply(b"", acked=False)


class Bus(Protocol):
    """An I2C bus behind a bridge."""

    name: str
    """For messages, such as "ft232h"."""

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """Carry out the transfers in order, a reply for each. Raises a DeviceError where the bridge
        fails."""
        ...

    def clear(self) -> None:
        """Free a bus on which a chip holds SDA low. Raises BusStuck where that cannot be done."""
        ...

    def close(self) -> None:
        """Give the bridge back; twice does no harm."""
        ...


Result = TypeVar("Result")


def freeing(bus: Bus, action: Callable[[], Result]) -> Result:
    """Do the action; where a chip holds the bus low, free the bus and do it again from its start.

    Raises BusStuck where the bus cannot be freed, and what the action raises.
    """
    for _ in range(MOST_CLEARS):
        try:
            return action()
        except BusStuck:
            bus.clear()
    return action()
