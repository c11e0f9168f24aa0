"""The state of one finger, and whether a reply of its chip is a valid reading."""

from __future__ import annotations

from holdfast.drivers.bus import Reply, Transfer
from holdfast.drivers.layout import Finger
from holdfast.drivers.packet_check import PacketCheck
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
            self.transfer = Transfer(at, b"", CHECKED_BYTES if setup.crc else PACKET_BYTES)

    @property
    def settled(self) -> bool:
        """Whether its readings count from now on, or it is not read at all."""
        return not self.ready or (self._converts and (not self.setup.crc or self.check.trusted))

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
