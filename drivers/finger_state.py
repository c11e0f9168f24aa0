"""What is known of a finger, and whether a reply of it is a valid reading."""

from __future__ import annotations

from drivers.bus import Reply, Transfer
from drivers.layout import Finger
from drivers.packet_check import PacketCheck
from drivers.tmag5273 import (
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
"""A finger that cannot be brought up is tried so often."""
NACKS_TO_BRING_UP = 2
EDGE = 32767
GARBAGE = (bytes(PACKET_BYTES), b"\xff" * PACKET_BYTES)
REINIT_REASONS = ("reset", "missing", "stale", "garbage", "diagnosis")
"""Why a finger is brought up anew, beside missing acknowledges and packets that do not fit their
CRC."""


class FingerState:
    """A finger of a hand. setup: of its chip; with crc, its packets are checked by their CRC."""

    def __init__(self, finger: Finger, setup: Setup) -> None:
        self.finger = finger
        self.ready, self.version = False, 1
        self.known = False
        """A chip of ours has identified itself at this finger's place."""
        self.check = PacketCheck()
        self.nacks = 0
        self.tried_ns = -TRY_AGAIN_NS
        self._last = b""
        self._changed_ns = 0
        self._converts = self._missed = False
        self._failures = 0
        self.configure(setup)

    def configure(self, setup: Setup) -> None:
        """Its chip is brought up like that from now on."""
        self.setup, at = setup, self.finger.read_at
        self.transfer = Transfer(at, bytes([RESULTS]), PACKET_BYTES)
        """What reads it."""
        if setup.packets:
            self.transfer = Transfer(at, b"", CHECKED_BYTES if setup.crc else PACKET_BYTES)

    @property
    def settled(self) -> bool:
        """Whether its readings count from now on, or it is not read at all."""
        return not self.ready or (self._converts and (not self.setup.crc or self.check.trusted))

    def begin(self, now_ns: int) -> None:
        """Its bring-up begins."""
        self.tried_ns, self.ready, self.nacks = now_ns, False, 0

    def brought_up(self, version: int, now_ns: int) -> None:
        """Its chip is ready; what it converted before does not count."""
        self.ready, self.known, self.version = True, True, version
        self._last, self._changed_ns, self._converts = b"", now_ns, False
        self._failures = self.check.failures

    def needs_bring_up(self, why: str) -> bool:
        """Whether what is wrong with its reading calls for a bring-up."""
        distrusted = why == "crc" and self.check.failures > self._failures
        return distrusted or self.nacks >= NACKS_TO_BRING_UP or why in REINIT_REASONS

    def judge(self, reply: Reply | None, came_ns: int) -> tuple[Packet | None, str]:
        """A reply's packet, and one word for why it is not a valid reading, "" where it is. None:
        it was not read."""
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
        return self._stale(data, came_ns) or (
            "saturated" if max(found.raw) >= EDGE or min(found.raw) <= -EDGE else ""
        )

    def _stale(self, data: bytes, came_ns: int) -> str:
        """Whether the chip has converted anew within 20 ms; until a second packet differs, that is
        not known.

        Nor is it after a missing acknowledge and a longer pause: the chip may have been asleep
        since it converted.
        """
        if data != self._last:
            slept = self._missed and came_ns - self._changed_ns > STALE_NS
            self._converts, self._missed = bool(self._last) and not slept, False
            self._last, self._changed_ns = data, came_ns
        if came_ns - self._changed_ns > STALE_NS:
            self._converts = False
            return "stale"
        return "" if self._converts else "settling"
