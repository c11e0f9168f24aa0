"""Where the six fingertips answer: four addresses are not enough, so channels of a mux share them."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.bus import Transfer
from edge_runtime.errors import UsageError

MUX_ADDRESS = 0x70
"""Of a TCA9548A with its address pins at ground."""


@dataclass(frozen=True)
class Finger:
    """Where a fingertip answers: its address, behind a channel of the mux or straight on the bus."""

    address: int
    channel: int | None = None


LAYOUTS: dict[str, tuple[Finger, ...]] = {
    "mux": tuple(Finger(a, c) for c, a in ((0, 0x35), (0, 0x22), (0, 0x78), (0, 0x44), (1, 0x35), (1, 0x22))),
    "mux6": tuple(Finger(0x35, channel) for channel in range(6)),
}
"""Four addresses on one channel and two on another; or one finger a channel."""


def read_layout(text: str) -> tuple[Finger, ...]:
    """A layout by name, or as channel:address of every finger. Raises UsageError.

    >>> read_layout("0:35,1:35,22")[1:]
    (Finger(address=53, channel=1), Finger(address=34, channel=None))
    """
    if text in LAYOUTS:
        return LAYOUTS[text]
    try:
        fingers = tuple(_finger(one) for one in text.split(","))
    except ValueError:
        raise UsageError(
            f"{text!r} is no layout", next_step=f"one of {', '.join(LAYOUTS)}, or channel:address,.. such as 0:35,1:35"
        ) from None
    if len(set(fingers)) < len(fingers):
        raise UsageError(f"{text!r}: two fingers at one place", next_step="give each its own address or channel")
    return fingers


def _finger(text: str) -> Finger:
    channel, _, address = text.rpartition(":")
    if channel and not 0 <= int(channel) < 8:
        raise ValueError(channel)
    if not 0x08 <= int(address, 16) <= 0x7F:
        raise ValueError(address)
    return Finger(int(address, 16), int(channel) if channel else None)


def joined(channel: int) -> Transfer:
    """The transfer that joins one channel of the mux and parts all others."""
    return Transfer(MUX_ADDRESS, bytes([1 << channel]))
