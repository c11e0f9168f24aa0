"""Which I2C transfers one scan of a hand needs, and what their replies say about the muxes.

Fingers behind the same mux channels form a group: the channels are enabled once, then the fingers
are read. The planner remembers the mask that each mux holds, so that it switches only where needed.

A TCA9548A mux on the bus: recognised by reads alone, and switched by one byte.

It has one register and no register numbers: the byte after its address is the mask of its enabled
channels. A chip with registers takes the same byte as a register number. A mux therefore shows
itself in a register read: it returns the very byte that was sent as the number, again and again. No
chip with registers holds its own register numbers.

The state of one finger, and whether a reply of its chip is a valid reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from holdfast.drivers.bring_up import PacketCheck
from holdfast.drivers.bus import Bus, Reply, Transfer
from holdfast.drivers.layout import Channel, Finger, masks_of, muxes_of, read_behind
from holdfast.drivers.tmag5273 import (
    CHECKED_BYTES,
    PACKET_BYTES,
    RESERVED_STATUS,
    RESULTS,
    Packet,
    Setup,
    packet,
)

STALE_NS = 20_000_000
TRY_AGAIN_NS = 50_000_000
"""The pause between two attempts to bring up a finger."""
NACKS_TO_BRING_UP = 2
EDGE = 32767
GARBAGE = (bytes(PACKET_BYTES), b"\xff" * PACKET_BYTES)
ERASED = (0, 0, 0)
"""Results of a chip that has slept and not converted since; a field of exactly nothing on all three
axes is no reading of a magnet."""
REINIT_REASONS = ("reset", "missing", "stale", "garbage", "diagnosis")
"""Reasons for a new bring-up, besides missing acknowledges and CRC failures."""


class FingerState:
    """One finger of a hand. setup: of its chip; with crc, the CRC of each packet is checked."""

    def __init__(self, finger: Finger, setup: Setup) -> None:
        self.finger = finger
        self.ready, self.version = False, 1
        self.known = False
        """A TMAG5273 has identified itself at this finger's place."""
        self.check = PacketCheck()
        self.nacks = 0
        self.tried_ns = -TRY_AGAIN_NS
        self._last = b""
        self._changed_ns = 0
        self._converts = self._missed = False
        self._failures = 0
        self.configure(setup)

    def configure(self, setup: Setup) -> None:
        """Use this setup from the next bring-up on."""
        self.setup, at = setup, self.finger.read_at
        self.transfer = Transfer(at, bytes([RESULTS]), PACKET_BYTES)
        """The transfer that reads the finger."""
        if setup.packets:
            self.transfer = Transfer(
                at, b"", CHECKED_BYTES if setup.crc else PACKET_BYTES
            )

    @property
    def settled(self) -> bool:
        """Whether its readings count from now on, or it is not read at all."""
        return not self.ready or (
            self._converts and (not self.setup.crc or self.check.trusted)
        )

    def begin(self, now_ns: int) -> None:
        """A bring-up begins."""
        self.tried_ns, self.ready, self.nacks = now_ns, False, 0

    def brought_up(self, version: int, now_ns: int) -> None:
        """The chip is ready; its earlier conversions do not count."""
        self.ready, self.known, self.version = True, True, version
        self._last, self._changed_ns, self._converts = b"", now_ns, False
        self._failures = self.check.failures

    def needs_bring_up(self, why: str) -> bool:
        """Whether the reason of an invalid reading calls for a bring-up."""
        distrusted = why == "crc" and self.check.failures > self._failures
        return distrusted or self.nacks >= NACKS_TO_BRING_UP or why in REINIT_REASONS

    def judge(self, reply: Reply | None, came_ns: int) -> tuple[Packet | None, str]:
        """The reply's packet, and one word for why it is not valid ("" where it is); None.

        Not read.
        """
        if reply is None:
            return None, "missing"
        if not reply.acked or len(reply.data) != self.transfer.read:
            self.nacks += 1
            self._missed = True
            return None, "nack"
        self.nacks = 0
        found = packet(reply.data[:PACKET_BYTES])
        return found, self._trouble(found, reply.data, came_ns)

    def _trouble(self, found: Packet, data: bytes, came_ns: int) -> str:
        if data[:PACKET_BYTES] in GARBAGE:
            return "garbage"
        under_test = not self.check.trusted
        if self.setup.crc and not self.check.believes(self.finger.read_at, data):
            distrusted = not under_test or self.check.failures
            return "crc" if distrusted else self._stale(data, came_ns) or "settling"
        if found.status & RESERVED_STATUS:
            return "garbage"
        if found.reset:
            return "reset"
        if found.failing:
            return "diagnosis"
        saturated = max(found.raw) >= EDGE or min(found.raw) <= -EDGE
        now = "settling" if found.raw == ERASED else "saturated" if saturated else ""
        return self._stale(data, came_ns) or now

    def _stale(self, data: bytes, came_ns: int) -> str:
        """ "stale" if the chip has not converted within 20 ms, "settling" until that is known.

        It is known once a second packet differs. After a missing acknowledge and a longer pause it
        is unknown again, because the chip may have been asleep since its last conversion.
        """
        if data != self._last:
            slept = self._missed and came_ns - self._changed_ns > STALE_NS
            self._converts, self._missed = bool(self._last) and not slept, False
            self._last, self._changed_ns = data, came_ns
        if came_ns - self._changed_ns > STALE_NS:
            self._converts = False
            return "stale"
        return "" if self._converts else "settling"


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
    replies = [bus.scan(transfers), bus.scan(transfers)]
    return [
        address
        for address, *both in zip(addresses, *replies, strict=True)
        if any(one.acked for one in both)
    ]


def plain_read(bus: Bus, address: int) -> bytes:
    """What a chip answers to a read without a register number; empty if no chip acknowledges."""
    return bus.scan([Transfer(address, b"", ALIKE_BYTES)])[0].data


def is_mux(bus: Bus, address: int) -> bool:
    """Whether a mux answers there, found by reads alone. Its channels are all disabled afterwards.

    A chip that answers a plain read with different bytes is sent nothing at all. Raises what a
    bridge raises.
    """
    return len(set(plain_read(bus, address))) == 1 and all(
        _echoes(bus, address, number) for number in ECHOES
    )


def _echoes(bus: Bus, address: int, number: int) -> bool:
    """Whether a plain read returns the register number that was sent before it."""
    after = bus.scan(
        [Transfer(address, bytes([number]), 1), Transfer(address, b"", 2)]
    )[1]
    return after.data == bytes([number, number])


def enable_channels(mux: int, mask: int) -> Transfer:
    """The transfer that enables these channels of a mux and disables the rest."""
    return Transfer(mux, bytes([mask]))


@dataclass
class Group:
    """Fingers read behind the same channels. A place is an index into a scan's transfers.

    fingers: finger index -> place of its read. selects: places of the mux writes. masks: the mask
    of every mux during this group. read_backs: place of a mux read -> mask that it must return.
    """

    fingers: dict[int, int]
    selects: list[int]
    masks: dict[int, int]
    read_backs: dict[int, int]

    def switched(self, replies: Sequence[Reply]) -> bool:
        """Whether every mux write was acknowledged and every mux that was read held its mask."""
        held = all(
            replies[place].data == bytes([mask])
            for place, mask in self.read_backs.items()
        )
        return held and all(replies[place].acked for place in self.selects)


@dataclass(frozen=True)
class ScanPlan:
    """The transfers of one scan, their groups, and the masks that the muxes hold afterwards."""

    transfers: list[Transfer]
    groups: list[Group]
    masks: dict[int, int]


class ScanPlanner:
    """Plans the scans of a hand.

    masks: what each mux holds; a mux without an entry is unknown and will be written. muxes: the
    addresses of all muxes.
    """

    def __init__(self, fingers: Sequence[Finger]) -> None:
        self.muxes = muxes_of(fingers)
        self.masks: dict[int, int] = {}
        self._behind = [read_behind(fingers, finger) for finger in fingers]
        self._all_channels = frozenset[Channel]().union(
            *(finger.behind for finger in fingers)
        )
        self._plans: dict[object, ScanPlan] = {}

    def forget_masks(self) -> None:
        """Treat every mux as unknown: the next scan writes all masks again."""
        self.masks = {}

    def forget_plans(self) -> None:
        """Drop all plans, because a finger is read by another transfer from now on."""
        self._plans.clear()

    def plan(self, states: Sequence[FingerState], *, doubtful: bool) -> ScanPlan:
        """The plan for the fingers that are ready; plans are cached.

        doubtful: the bus flipped bits lately, so each group ends with a read of its muxes.
        """
        key = (
            doubtful,
            tuple(self.masks.items()),
            tuple([state.ready for state in states]),
        )
        if key not in self._plans:
            self._plans[key] = self._new_plan(states, doubtful)
        plan = self._plans[key]
        self.masks = {**plan.masks}
        return plan

    def select(self, channels: frozenset[Channel]) -> list[Transfer]:
        """Mux writes that enable these channels and disable the others; none where that holds."""
        wanted = masks_of(channels, self.muxes) if channels else {}
        writes = [
            enable_channels(mux, mask)
            for mux, mask in wanted.items()
            if self.masks.get(mux) != mask
        ]
        self.masks = self.masks | wanted
        return writes

    def select_all(self) -> list[Transfer]:
        """Mux writes that enable the channels of all fingers at once."""
        return self.select(self._all_channels)

    def _new_plan(self, states: Sequence[FingerState], doubtful: bool) -> ScanPlan:
        transfers: list[Transfer] = []
        groups: list[Group] = []
        for k, state in enumerate(states):
            if not state.ready:
                continue
            selects = self.select(self._behind[k])
            if selects or not groups:
                _read_back(transfers, groups, doubtful)
                places = range(len(transfers), len(transfers) + len(selects))
                groups.append(Group({}, [*places], {**self.masks}, {}))
                transfers += selects
            groups[-1].fingers[k] = len(transfers)
            transfers.append(state.transfer)
        _read_back(transfers, groups, doubtful)
        return ScanPlan(transfers, groups, {**self.masks})


def _read_back(transfers: list[Transfer], groups: list[Group], doubtful: bool) -> None:
    """Where the bus is in doubt, end the last group with a read of every mux."""
    for mux, mask in groups[-1].masks.items() if doubtful and groups else ():
        groups[-1].read_backs[len(transfers)] = mask
        transfers.append(Transfer(mux, b"", 1))
