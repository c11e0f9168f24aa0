"""Where the six fingertips answer. The sensor has four addresses only, so mux channels share them.

Alternatively, the driver gives each finger its own address at bring-up, behind its channel. Then
all channels are enabled at once, and a scan never switches. A chip loses such an address with its
power, and the driver gives it again.

A layout in a URL is a name (`mux`, or `mux@71` for a mux at 0x71), or a place for each finger:

    35              0x35, directly on the bus
    1:35            0x35 on channel 1 of the mux at 0x70
    71/1:35         0x35 on channel 1 of the mux at 0x71
    1:35>50         the same on 0x70, given the address 0x50 at start
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from holdfast.core.errors import UsageError

MUX_ADDRESSES = range(0x70, 0x78)
MUX_ADDRESS = MUX_ADDRESSES[0]
"""A TCA9548A with its address pins at ground."""
CHANNELS = range(8)

Channel = tuple[int, int]
"""Address of a mux, and number of its channel."""


@dataclass(frozen=True)
class Finger:
    """Where a fingertip answers: its factory address, behind a mux channel or directly on the bus.

    moved: the address that it is given at bring-up and read at from then on. mux: the address of
    its mux.
    """

    address: int
    channel: int | None = None
    moved: int | None = None
    mux: int = MUX_ADDRESS

    @property
    def read_at(self) -> int:
        """The address it is read at."""
        return self.address if self.moved is None else self.moved

    @property
    def behind(self) -> frozenset[Channel]:
        """Its own channel; empty where it is directly on the bus."""
        return (
            frozenset()
            if self.channel is None
            else frozenset({(self.mux, self.channel)})
        )


LAYOUTS: dict[str, tuple[Finger, ...]] = {
    "mux": tuple(
        Finger(a, c)
        for c, a in ((0, 0x35), (0, 0x22), (0, 0x78), (0, 0x44), (1, 0x35), (1, 0x22))
    ),
    "mux6": tuple(Finger(0x35, channel) for channel in range(6)),
    "moved": tuple(
        Finger(a, c, moved)
        for c, a, moved in (
            (0, 0x35, 0x50),
            (0, 0x22, 0x51),
            (0, 0x78, 0x52),
            (0, 0x44, 0x53),
            (1, 0x35, 0x54),
            (1, 0x22, 0x55),
        )
    ),
}
""""mux": four fingers on one channel, two on another. "mux6": one a channel. "moved": see above."""


def read_layout(text: str) -> tuple[Finger, ...]:
    """A layout by name, or a place for each finger (see above). Raises UsageError.

    >>> read_layout("1:35,22,72/0:35>50")[2]
    Finger(address=53, channel=0, moved=80, mux=114)
    >>> read_layout("mux@71")[5]
    Finger(address=34, channel=1, moved=None, mux=113)
    """
    name, at, mux = text.partition("@")
    try:
        if name in LAYOUTS:
            return (
                tuple(replace(one, mux=_mux(mux)) for one in LAYOUTS[name])
                if at
                else LAYOUTS[name]
            )
        fingers = tuple(_finger(one) for one in text.split(","))
    except ValueError:
        raise UsageError(
            f"{text!r} is not a layout",
            next_step=f"choose {', '.join(LAYOUTS)}, a name@71 for a mux at 0x71, "
            "or one place for each finger, such as 0:35,1:35 or 71/0:35,71/1:35",
        ) from None
    _check(text, fingers)
    return fingers


def _check(text: str, fingers: Sequence[Finger]) -> None:
    places = [(one.behind, one.address) for one in fingers]
    own = [one.moved for one in fingers if one.moved]
    read_at = {one.read_at for one in fingers}
    if (
        len(set(places)) < len(places)
        or len(set(own)) < len(own)
        or {one.address for one in fingers} & {*own}
    ):
        raise UsageError(
            f"{text!r}: two fingers at one place",
            next_step="give each its own address or channel",
        )
    if taken := (read_at | {one.address for one in fingers}) & muxes_of(fingers):
        raise UsageError(
            f"{text!r}: a finger has a mux's address, {min(taken):#04x}",
            next_step="choose another",
        )


def _finger(text: str) -> Finger:
    where, _, place = text.rpartition(":")
    mux, _, channel = where.rpartition("/")
    address, _, moved = place.partition(">")
    if (channel and int(channel) not in CHANNELS) or (mux and not channel):
        raise ValueError(where)
    return Finger(
        _address(address),
        int(channel) if channel else None,
        _address(moved) if moved else None,
        _mux(mux) if mux else MUX_ADDRESS,
    )


def _address(text: str) -> int:
    if not 0x08 <= int(text, 16) <= 0x7F:
        raise ValueError(text)
    return int(text, 16)


def _mux(text: str) -> int:
    if int(text, 16) not in MUX_ADDRESSES:
        raise ValueError(text)
    return int(text, 16)


def muxes_of(fingers: Sequence[Finger]) -> frozenset[int]:
    """Addresses of the muxes in front of these fingers."""
    return frozenset(one.mux for one in fingers if one.channel is not None)


def read_behind(fingers: Sequence[Finger], finger: Finger) -> frozenset[Channel]:
    """Channels enabled while a finger is read: its own, or those of all fingers with a new address.

    A chip that lost its power answers at its factory address again. No finger is read there in such
    a layout, so the two do not collide.
    """
    if finger.moved is None:
        return finger.behind
    return frozenset().union(*(one.behind for one in fingers if one.moved is not None))


def masks_of(channels: frozenset[Channel], muxes: frozenset[int]) -> dict[int, int]:
    """Each mux's mask that enables these channels only; muxes that enable none come first."""
    masks = {
        mux: sum(1 << number for at, number in channels if at == mux) for mux in muxes
    }
    return dict(sorted(masks.items(), key=lambda item: (item[1] != 0, item[0])))
