"""One finger: its chip is brought up, and each reading is judged.

Bring-up: wake, identify, configure, read back. Nothing is written to
an address before a TMAG5273 has identified itself there. A register read is a read, although it
sends the register's number: that number only sets a pointer in every chip that has registers.
"""

from __future__ import annotations

from collections.abc import Callable

from holdfast.core.errors import DeviceNotFound, WrongDevice
from holdfast.drivers.bus import Bus, Reply, Transfer
from holdfast.drivers.layout import Finger
from holdfast.drivers.tmag5273 import (
    MANUFACTURER_ID,
    PACKET_BYTES,
    RANGES_MT,
    REGISTERS,
    RESERVED_STATUS,
    RESULTS,
    Packet,
    Setup,
    packet,
)

WAKE_S = 100e-6
IDENTITY = REGISTERS["I2C_ADDRESS"].address
STATUS = REGISTERS["CONV_STATUS"]
DEVICE = REGISTERS["DEVICE_STATUS"]
READ_BACK = 9
"""The configuration is in this many registers, from 0 on."""

Pause = Callable[[float], None]


def bring_up(bus: Bus, finger: Finger, setup: Setup, pause: Pause) -> int:
    """Make a finger's chip ready, its channel being enabled. Returns the chip's version, 1 or 2.

    Raises DeviceNotFound where nothing answers, WrongDevice for another chip or one that does not
    keep its configuration, and what the bridge raises.
    """
    version = identify(bus, finger.address, pause)
    _configure(bus, finger.address, dict(setup.registers()))
    return version


def identify(bus: Bus, address: int, pause: Pause) -> int:
    """Wake the chip, check that it is a TMAG5273, return its version. Nothing is written to it.

    A sleeping chip does not acknowledge the read that wakes it. Raises DeviceNotFound, WrongDevice.
    """
    # four registers from I2C_ADDRESS on
    ask = [Transfer(address, bytes([IDENTITY]), 4)]
    (reply,) = bus.scan(ask)
    if not reply.acked:
        # the first read may have woken it
        pause(WAKE_S)
        (reply,) = bus.scan(ask)
    if not reply.acked:
        raise DeviceNotFound(
            "does not answer",
            where=f"{address:#04x}",
            cause="no power, or a broken wire",
        )
    maker = int.from_bytes(reply.data[2:4], "little")
    version = reply.data[1] & 3
    if maker != MANUFACTURER_ID or version not in RANGES_MT:
        raise WrongDevice(
            f"maker {maker:#06x}, version {version}: no TMAG5273",
            where=f"{address:#04x}",
            cause="another chip, two chips at one address, or a chip that another program left "
            "in 1-byte mode",
            next_step="holdfast scan lists the chips; or switch the sensor's power off and on",
        )
    return version


def _configure(bus: Bus, address: int, registers: dict[int, int]) -> None:
    """Write the registers that differ, read them back, and only then clear POR.

    Until POR is cleared, the chip reports a loss of power; clearing it earlier would hide one.
    """
    wanted = bytes(registers.get(register, 0) for register in range(READ_BACK))
    read_back = Transfer(address, b"\0", READ_BACK)
    clear = Transfer(address, bytes([DEVICE.address, DEVICE.write_one_clears]))
    held = bus.scan([clear, read_back])[-1]
    # a chip that kept its configuration goes on converting
    if held.data != wanted:
        writes = [Transfer(address, bytes(pair)) for pair in registers.items()]
        held = bus.scan([*writes, read_back])[-1]
    if held.data != wanted:
        raise WrongDevice(
            f"does not keep its configuration ({held.data.hex()}, not {wanted.hex()})",
            where=f"{address:#04x}",
            cause="two chips at one address, or noise on the bus",
        )
    # only now: a loss of power before this line must show
    bus.scan([Transfer(address, bytes([STATUS.address, STATUS.write_one_clears]))])


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
"""Reasons for a new bring-up, besides missing acknowledges."""


class FingerState:
    """One finger of a hand."""

    def __init__(self, finger: Finger) -> None:
        self.finger = finger
        self.transfer = Transfer(finger.address, bytes([RESULTS]), PACKET_BYTES)
        """The transfer that reads the finger."""
        self.ready = False
        self.version = 1
        self.nacks = 0
        self.tried_ns = -TRY_AGAIN_NS
        self._last = b""
        self._changed_ns = 0
        self._converts = self._missed = False

    @property
    def settled(self) -> bool:
        """Whether its readings count from now on, or it is not read at all."""
        return not self.ready or self._converts

    def begin(self, now_ns: int) -> None:
        """A bring-up begins."""
        self.tried_ns = now_ns
        self.ready = False
        self.nacks = 0

    def brought_up(self, version: int, now_ns: int) -> None:
        """The chip is ready; its earlier conversions do not count."""
        self.ready = True
        self.version = version
        self._last = b""
        self._changed_ns = now_ns
        self._converts = False

    def needs_bring_up(self, why: str) -> bool:
        """Whether the reason of an invalid reading calls for a bring-up."""
        return self.nacks >= NACKS_TO_BRING_UP or why in REINIT_REASONS

    def judge(self, reply: Reply, came_ns: int) -> tuple[Packet | None, str]:
        """The reply's packet, and one word for why it is not valid ("" where it is).

        came_ns: when it came.
        """
        if not reply.acked or len(reply.data) != self.transfer.read:
            self.nacks += 1
            self._missed = True
            return None, "nack"
        self.nacks = 0
        found = packet(reply.data)
        return found, self._trouble(found, reply.data, came_ns)

    def _trouble(self, found: Packet, data: bytes, came_ns: int) -> str:
        if data in GARBAGE:
            return "garbage"
        # the chip never sets these bits, so the byte is not its status
        if found.status & RESERVED_STATUS:
            return "garbage"
        if found.reset:
            return "reset"
        if found.failing:
            return "diagnosis"
        stale = self._stale(data, came_ns)
        if stale:
            return stale
        if found.raw == ERASED:
            return "settling"
        saturated = max(found.raw) >= EDGE or min(found.raw) <= -EDGE
        return "saturated" if saturated else ""

    def _stale(self, data: bytes, came_ns: int) -> str:
        """ "stale" if the chip has not converted within 20 ms, "settling" until that is known.

        It is known once a second packet differs. After a missing acknowledge and a longer pause it
        is unknown again, because the chip may have been asleep since its last conversion.
        """
        if data != self._last:
            # a chip that slept may show a result from before it fell asleep
            slept = self._missed and came_ns - self._changed_ns > STALE_NS
            self._converts = bool(self._last) and not slept
            self._missed = False
            self._last = data
            self._changed_ns = came_ns

        if came_ns - self._changed_ns > STALE_NS:
            self._converts = False
            return "stale"
        return "" if self._converts else "settling"
