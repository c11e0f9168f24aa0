"""Where the six fingertips answer: four addresses are not enough, so channels of a mux share them.

Or each is given an address of its own at bring-up, behind its channel, and then all channels are joined at once: a
scan that never switches. Such an address is lost with the chip's power, and given again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from drivers.bus import Transfer
from edge_runtime.errors import UsageError

MUX_ADDRESS = 0x70
"""Of a TCA9548A with its address pins at ground."""


@dataclass(frozen=True)
class Finger:
    """Where a fingertip answers: its factory address, behind a channel of the mux or straight on the bus.

    moved: the address it is given at bring-up, and read at from then on.
    """

    address: int
    channel: int | None = None
    moved: int | None = None

    @property
    def read_at(self) -> int:
        """The address it is read at."""
        return self.address if self.moved is None else self.moved


LAYOUTS: dict[str, tuple[Finger, ...]] = {
    "mux": tuple(Finger(a, c) for c, a in ((0, 0x35), (0, 0x22), (0, 0x78), (0, 0x44), (1, 0x35), (1, 0x22))),
    "mux6": tuple(Finger(0x35, channel) for channel in range(6)),
    "moved": tuple(
        Finger(a, c, moved)
        for c, a, moved in ((0, 0x35, 0x50), (0, 0x22, 0x51), (0, 0x78, 0x52), (0, 0x44, 0x53), (1, 0x35, 0x54),
                            (1, 0x22, 0x55))
    ),
}  # fmt: skip
"""Four addresses on one channel and two on another; one finger a channel; or wired as the first, each moved."""


def read_layout(text: str) -> tuple[Finger, ...]:
    """A layout by name, or as channel:address>moved of every finger. Raises UsageError.

    >>> read_layout("1:35,22,0:35>50")[1:]
    (Finger(address=34, channel=None, moved=None), Finger(address=53, channel=0, moved=80))
    """
    if text in LAYOUTS:
        return LAYOUTS[text]
    try:
        fingers = tuple(_finger(one) for one in text.split(","))
    except ValueError:
        raise UsageError(
            f"{text!r} is no layout", next_step=f"one of {', '.join(LAYOUTS)}, or channel:address,.. such as 0:35,1:35"
        ) from None
    places, own = [(one.channel, one.address) for one in fingers], [one.moved for one in fingers if one.moved]
    if len(set(places)) < len(places) or len(set(own)) < len(own) or {one.address for one in fingers} & {*own}:
        raise UsageError(f"{text!r}: two fingers at one place", next_step="give each its own address or channel")
    return fingers


def _finger(text: str) -> Finger:
    channel, _, place = text.rpartition(":")
    address, _, moved = place.partition(">")
    if channel and not 0 <= int(channel) < 8:
        raise ValueError(channel)
    return Finger(_address(address), int(channel) if channel else None, _address(moved) if moved else None)


def _address(text: str) -> int:
    if not 0x08 <= int(text, 16) <= 0x7F:
        raise ValueError(text)
    return int(text, 16)


def read_behind(fingers: Sequence[Finger], finger: Finger) -> frozenset[int]:
    """Channels joined while a finger is read: its own, or those of all that were moved.

    A chip that lost its power answers at its factory address again: it then meets no finger that is read there.
    """
    behind = {finger.channel} if finger.moved is None else {one.channel for one in fingers if one.moved is not None}
    return frozenset(channel for channel in behind if channel is not None)


def joined(channels: Iterable[int]) -> Transfer:
    """The transfer that joins these channels of the mux and parts all others."""
    return Transfer(MUX_ADDRESS, bytes([sum(1 << channel for channel in channels)]))
