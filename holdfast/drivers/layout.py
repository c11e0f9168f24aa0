"""Where the six fingertips answer, the muxes in front of them, and the transfers of one scan.

A chip has a few addresses only (often four), so mux channels share them.

A layout in a URL is a name (`mux`, or `mux@71` for a mux at 0x71), or a place for each finger:

    35              0x35, directly on the bus
    1:35            0x35 on channel 1 of the mux at 0x70
    71/1:35         0x35 on channel 1 of the mux at 0x71

A TCA9548A mux has one register and no register numbers: the byte after its address is the mask of
its enabled channels. A chip with registers takes the same byte as a register number. So a mux
shows itself in a register read: it returns the very byte that was sent as the number, again and
again. No chip with registers holds its own register numbers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from holdfast.core.errors import UsageError
from holdfast.drivers.bus import Bus, Reply, Transfer

MUX_ADDRESSES = range(0x70, 0x78)
MUX_ADDRESS = MUX_ADDRESSES[0]
"""A TCA9548A with its address pins at ground."""
CHANNELS = range(8)
ADDRESSES = range(0x08, 0x80)

Channel = tuple[int, int]
"""Address of a mux, and number of its channel."""


@dataclass(frozen=True)
class Finger:
    """Where a fingertip answers: its address, behind a mux channel or directly on the bus.

    mux: the address of its mux.
    """

    address: int
    channel: int | None = None
    mux: int = MUX_ADDRESS

    @property
    def behind(self) -> frozenset[Channel]:
        """Its own channel; empty where it is directly on the bus."""
        if self.channel is None:
            return frozenset()
        return frozenset({(self.mux, self.channel)})


LAYOUTS: dict[str, tuple[tuple[int, int], ...]] = {
    "mux": ((0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1)),
    "mux6": tuple((channel, 0) for channel in range(6)),
}
"""Channel, and which of the chip's addresses, for each finger.

"mux": four fingers on one channel, two on another. "mux6": one a channel.
"""
MUX = "(?P<mux>7[0-7])"
NAMED = re.compile(f"(?P<name>{'|'.join(LAYOUTS)})(@{MUX})?")
PLACE = re.compile(
    f"(({MUX}/)?(?P<channel>[0-7]):)?(?P<address>0?[89a-f]|[1-7][0-9a-f])",
    re.IGNORECASE,
)
"""One place of a layout: mux and address are hexadecimal."""


def read_layout(text: str, addresses: Sequence[int]) -> tuple[Finger, ...]:
    """A layout by name, or a place for each finger (see above). Raises UsageError.

    addresses: of the chip, for a layout by name.

    >>> read_layout("1:35,22,72/0:35", ())[2]
    Finger(address=53, channel=0, mux=114)
    >>> read_layout("mux@71", (0x35, 0x22, 0x78, 0x44))[5]
    Finger(address=34, channel=1, mux=113)
    """
    if named := NAMED.fullmatch(text):
        mux = _address(named["mux"])
        places = LAYOUTS[named["name"]]
        most = 1 + max(k for _, k in places)
        if most > len(addresses):
            raise UsageError(
                f"layout={text} needs {most} addresses on one channel",
                cause=f"the chip has {len(addresses)}",
                next_step="layout=mux6, or a place for each finger, such as 0:35,1:35",
            )
        return tuple(Finger(addresses[k], channel, mux) for channel, k in places)
    written = list(map(PLACE.fullmatch, text.split(",")))
    fingers = []
    for place in filter(None, written):
        channel = int(place["channel"]) if place["channel"] else None
        address = int(place["address"], 16)
        fingers.append(Finger(address, channel, _address(place["mux"])))
    if len(fingers) < len(written):
        raise UsageError(
            f"{text!r} is not a layout",
            next_step=f"choose {', '.join(LAYOUTS)}, a name@71 for a mux at 0x71, "
            "or one place for each finger, such as 0:35,1:35 or 71/0:35,71/1:35",
        )

    _require_distinct(text, fingers)
    return tuple(fingers)


def _address(mux: str | None) -> int:
    return int(mux, 16) if mux else MUX_ADDRESS


def _require_distinct(text: str, fingers: Sequence[Finger]) -> None:
    places = {(one.behind, one.address) for one in fingers}
    # a mux answers at its address whatever its mask is
    met = muxes_of(fingers).intersection(one.address for one in fingers)
    if met or len(places) < len(fingers):
        raise UsageError(
            f"{text!r}: two fingers, or a finger and a mux, at one place",
            next_step="give each its own address or channel",
        )


def muxes_of(fingers: Sequence[Finger]) -> frozenset[int]:
    """Addresses of the muxes in front of these fingers."""
    return frozenset(one.mux for one in fingers if one.channel is not None)


# -- muxes on a bus

ALIKE_BYTES = 8
"""A chip with one register answers a plain read of this many bytes with equal bytes."""
ECHOES = (0x02, 0x01, 0x00)
"""Sent as register numbers; the last one disables all channels.

LED drivers and pressure sensors also use 0x70 to 0x77. To them these numbers are registers or
nothing, and none of them starts a reset.
"""


def answering(bus: Bus, addresses: Sequence[int]) -> list[int]:
    """Which addresses acknowledge a read; a sleeping sensor does so from the second read on."""
    transfers = [Transfer(address, b"", 1) for address in addresses]
    first = bus.scan(transfers)
    second = bus.scan(transfers)
    return [a for k, a in enumerate(addresses) if first[k].acked or second[k].acked]


def plain_read(bus: Bus, address: int) -> bytes:
    """What a chip answers to a read without a register number; empty if no chip acknowledges."""
    return bus.scan([Transfer(address, b"", ALIKE_BYTES)])[0].data


def is_mux(bus: Bus, address: int) -> bool:
    """Whether a mux answers there, found by reads alone. Its channels are all disabled afterwards.

    A chip that answers a plain read with different bytes is sent nothing at all. Raises what a
    bridge raises.
    """
    # a mux returns its one register for every byte that is read
    if len(set(plain_read(bus, address))) != 1:
        return False
    for number in ECHOES:
        register_read = Transfer(address, bytes([number]), 1)
        # the plain read afterwards shows whether the number was kept as a mask
        after = bus.scan([register_read, Transfer(address, b"", 2)])[1]
        if after.data != bytes([number, number]):
            return False

    return True


def enable_channels(mux: int, mask: int) -> Transfer:
    """The transfer that enables these channels of a mux and disables the rest."""
    return Transfer(mux, bytes([mask]))


# -- the transfers of one scan


@dataclass
class Group:
    """Fingers read behind the same channels. A place is an index into a scan's transfers.

    masks: the mask of every mux during this group. selects: places of the mux writes. fingers:
    finger index -> place of its read. read_backs: place of a mux read -> mask that it must return.
    """

    masks: dict[int, int]
    selects: list[int]
    fingers: dict[int, int] = field(default_factory=dict)
    read_backs: dict[int, int] = field(default_factory=dict)

    def switched(self, replies: Sequence[Reply]) -> bool:
        """Whether every mux write was acknowledged and every mux that was read held its mask."""
        for place, mask in self.read_backs.items():
            if replies[place].data != bytes([mask]):
                return False
        return all(replies[place].acked for place in self.selects)


@dataclass(frozen=True)
class ScanPlan:
    """The transfers of one scan, their groups, and the masks that the muxes hold afterwards."""

    transfers: list[Transfer]
    groups: list[Group]
    masks: dict[int, int]


class ScanPlanner:
    """Plans the scans of a hand, and remembers the mask that each mux holds.

    Fingers behind the same channels form a group: the channels are enabled once, then the fingers
    are read. masks: by mux; a mux without an entry is unknown and will be written.
    """

    def __init__(self, fingers: Sequence[Finger]) -> None:
        self.muxes = muxes_of(fingers)
        self.masks: dict[int, int] = {}
        self._channels = [finger.behind for finger in fingers]
        self._plans: dict[object, ScanPlan] = {}

    def forget_masks(self) -> None:
        """Treat every mux as unknown: the next scan writes all masks again."""
        self.masks = {}

    def plan(self, reads: Sequence[Transfer | None], *, doubtful: bool) -> ScanPlan:
        """The plan for these reads of the fingers, None for one that is not read; plans are cached.

        doubtful: the bus flipped bits lately, so each group ends with a read of its muxes.
        """
        # a plan depends on what the muxes hold when it begins
        key = (doubtful, tuple(self.masks.items()), tuple(reads))
        if key not in self._plans:
            self._plans[key] = self._new_plan(reads, doubtful)
        plan = self._plans[key]
        self.masks = plan.masks.copy()
        return plan

    def select(self, channels: frozenset[Channel]) -> list[Transfer]:
        """Mux writes that enable these channels and disable the others; none where that holds."""
        masks = dict.fromkeys(sorted(self.muxes) if channels else (), 0)
        for mux, channel in channels:
            masks[mux] |= 1 << channel
        # a channel is disabled before another one with the same addresses is enabled
        wanted = dict(sorted(masks.items(), key=lambda item: bool(item[1])))
        writes = [
            enable_channels(mux, mask)
            for mux, mask in wanted.items()
            if self.masks.get(mux) != mask
        ]
        self.masks = self.masks | wanted
        return writes

    def _new_plan(self, reads: Sequence[Transfer | None], doubtful: bool) -> ScanPlan:
        transfers: list[Transfer] = []
        groups: list[Group] = []
        for k, read in enumerate(reads):
            if read is None:
                continue
            selects = self.select(self._channels[k])
            # a new group begins wherever a mux has to be written
            if selects or not groups:
                if doubtful and groups:
                    _read_back(transfers, groups[-1])
                places = range(len(transfers), len(transfers) + len(selects))
                groups.append(Group(self.masks.copy(), list(places)))
                transfers += selects
            groups[-1].fingers[k] = len(transfers)
            transfers.append(read)

        if doubtful and groups:
            _read_back(transfers, groups[-1])
        return ScanPlan(transfers, groups, self.masks.copy())


def _read_back(transfers: list[Transfer], group: Group) -> None:
    """End a group with a read of every mux."""
    for mux, mask in group.masks.items():
        group.read_backs[len(transfers)] = mask
        transfers.append(Transfer(mux, b"", 1))
