"""One finger: its chip is brought up, its packets are checked, and each reading is judged.

Bring-up: wake, identify, give the chip its own address, configure, read back. Nothing is written to
an address before a TMAG5273 has identified itself there. A register read is a read, although it
sends the register's number: that number only sets a pointer in every chip that has registers.

Whether a chip's packets can be trusted is judged by the CRC after each; the CRC is tested first. It
finds every error of one to three bits in a packet, and all but one in 256 of the others. Two chips
at one address are another matter: zeros win bit by bit, and about one such packet in a hundred has
a CRC that fits by chance. So no packet is trusted alone:

    at first                        8 different packets in a row must fit
    after one that does not fit     two in a row must fit; the second one counts
    after two that do not fit       8 again, and the driver brings the chip up again

Some chips in the field begin their CRC with another seed than the data sheet's (TI E2E 1200004,
1558871). Such a CRC is off by the same bits in every packet, which never happens with two chips at
one address. The test finds these bits and allows for them. A chip whose last byte is the same for
different packets sends no CRC at all.
"""

from __future__ import annotations

from collections.abc import Callable

from holdfast.core.errors import DeviceNotFound, WrongDevice
from holdfast.drivers.bus import Bus, Reply, Transfer
from holdfast.drivers.layout import Finger
from holdfast.drivers.tmag5273 import (
    CHECKED_BYTES,
    MANUFACTURER_ID,
    PACKET_BYTES,
    RANGES_MT,
    REGISTERS,
    RESERVED_STATUS,
    RESULTS,
    TRIGGER,
    Packet,
    Setup,
    conversion_s,
    packet,
    packet_crc,
)

WAKE_S = 100e-6
CONFIG = REGISTERS["DEVICE_CONFIG_1"].address
IDENTITY = REGISTERS["I2C_ADDRESS"].address
STATUS = REGISTERS["CONV_STATUS"]
DEVICE = REGISTERS["DEVICE_STATUS"]
READ_BACK = 9
"""The configuration is in this many registers, from 0 on."""
PACKETS_LOOKED_AT = 12
CRCS_TO_AGREE = 6
COUNTS_TO_SEE = 4
CONVERTED = 0x01
"""The lower five bits of CONV_STATUS after a conversion: RESULT_STATUS, and nothing wrong."""
LONGEST_CONVERSION_S = conversion_s(32)

Pause = Callable[[float], None]


def bring_up(
    bus: Bus, finger: Finger, setup: Setup, pause: Pause, *, known: bool = False
) -> int:
    """Make a finger's chip ready, its channel being enabled. Returns the chip's version, 1 or 2.

    known: a TMAG5273 has identified itself at this place before, so it may be written to at once.

    Raises DeviceNotFound where nothing answers, WrongDevice for another chip or one that does not
    keep its configuration, and what the bridge raises.
    """
    address = finger.read_at
    # registers cannot be read back once 1-byte reads are on, so those come last
    plain = dict(setup.plain.registers())
    if finger.moved is not None:
        _move(bus, finger.address, finger.moved, pause, known=known)
    version = identify(bus, address, pause, plain[CONFIG], known=known)
    _configure(bus, address, plain)
    if setup.packets:
        config = dict(setup.registers())[CONFIG]
        bus.scan([Transfer(address, bytes([CONFIG, config]))])
    return version


def identify(
    bus: Bus, address: int, pause: Pause, config: int = 0, *, known: bool = False
) -> int:
    """Wake the chip, check that it is a TMAG5273, return its version.

    Only a chip that was left in 1-byte mode is written to, and only after its packets have shown
    that it is a TMAG5273, or at once where it is known. The driver then writes config to its
    DEVICE_CONFIG_1, so that its registers can be read again. Raises DeviceNotFound, WrongDevice.
    """
    use_registers = Transfer(address, bytes([CONFIG, config]))
    # a known chip may be asleep: the first write wakes it and is not acknowledged
    if known and not bus.scan([use_registers])[0].acked:
        pause(WAKE_S)
        bus.scan([use_registers])
    answer = _identity(bus, address, pause)
    if _version(answer) is None and _sends_packets(bus, address, pause):
        bus.scan([use_registers])
        answer = _identity(bus, address, pause)
    version = _version(answer)
    if version is None:
        maker = int.from_bytes(answer[2:4], "little")
        raise WrongDevice(
            f"maker {maker:#06x}, version {answer[1] & 3}: no TMAG5273",
            where=f"{address:#04x}",
            cause="another chip, two chips at one address, or a chip left in 1-byte mode",
            next_step="holdfast scan lists the chips; or switch the sensor's power off and on",
        )

    return version


def _identity(bus: Bus, address: int, pause: Pause) -> bytes:
    """Four registers from I2C_ADDRESS on.

    A sleeping chip does not acknowledge the read that wakes it.
    """
    ask = Transfer(address, bytes([IDENTITY]), 4)
    reply = bus.scan([ask])[0]
    if not reply.acked:
        # the first read may have woken it
        pause(WAKE_S)
        reply = bus.scan([ask])[0]
    if not reply.acked:
        raise DeviceNotFound(
            "does not answer",
            where=f"{address:#04x}",
            cause="no power, or a broken wire",
        )
    return reply.data


def _version(identity: bytes) -> int | None:
    """1 or 2 for a TMAG5273, None for another chip."""
    maker = int.from_bytes(identity[2:4], "little")
    version = identity[1] & 3
    return version if maker == MANUFACTURER_ID and version in RANGES_MT else None


def _sends_packets(bus: Bus, address: int, pause: Pause) -> bool:
    """Whether the chip is a TMAG5273 in 1-byte mode, judged by a dozen register reads.

    In that mode the chip sends its packet, whatever register the request names. Either the CRC fits
    every packet, or every status has the bits of a good conversion and its count goes on. The
    highest bit of the register number starts a conversion in a chip that waits for a trigger.
    """
    numbers = (IDENTITY, TRIGGER | RESULTS)
    packets: list[bytes] = []
    for k in range(PACKETS_LOOKED_AT):
        ask = Transfer(address, bytes([numbers[k % 2]]), CHECKED_BYTES)
        data = bus.scan([ask])[0].data
        if len(data) != CHECKED_BYTES or data[PACKET_BYTES - 1] & RESERVED_STATUS:
            return False
        packets.append(data)
        # the pauses differ, so that no count seems to stand still
        pause(LONGEST_CONVERSION_S * (1.0 + k / 16))

    return _crcs_agree(address, packets) or _counts_go_on(packets)


def _crcs_agree(address: int, packets: list[bytes]) -> bool:
    """Whether all CRCs fit, or are off by the same bits, over several different packets."""
    different = set(packets)
    offsets = {data[-1] ^ packet_crc(address, data[:-1]) for data in different}
    return len(offsets) == 1 and len(different) >= CRCS_TO_AGREE


def _counts_go_on(packets: list[bytes]) -> bool:
    counts = set()
    for data in packets:
        found = packet(data[:PACKET_BYTES])
        if found.status & 0x1F != CONVERTED:
            return False
        counts.add(found.set_count)
    return len(counts) >= COUNTS_TO_SEE


def _move(bus: Bus, factory: int, moved: int, pause: Pause, *, known: bool) -> None:
    """Give a chip its own address, unless it still has it. Raises what identify raises."""
    try:
        identify(bus, moved, pause, known=known)
    except DeviceNotFound:
        # it lost its power and answers at its factory address again
        identify(bus, factory, pause, known=known)
        bus.scan([Transfer(factory, bytes([IDENTITY, moved << 1 | 1]))])


def _configure(bus: Bus, address: int, plain: dict[int, int]) -> None:
    """Write the registers that differ, read them back, and only then clear POR.

    Until POR is cleared, the chip reports a loss of power; clearing it earlier would hide one.
    """
    wanted = bytes(plain.get(register, 0) for register in range(READ_BACK))
    read_back = Transfer(address, b"\0", READ_BACK)
    clear = Transfer(address, bytes([DEVICE.address, DEVICE.write_one_clears]))
    held = bus.scan([clear, read_back])[-1]
    # a chip that kept its configuration goes on converting
    if held.data != wanted:
        writes = [Transfer(address, bytes(pair)) for pair in plain.items()]
        held = bus.scan([*writes, read_back])[-1]
    if held.data != wanted:
        raise WrongDevice(
            f"does not keep its configuration ({held.data.hex()}, not {wanted.hex()})",
            where=f"{address:#04x}",
            cause="two chips at one address, or noise on the bus",
        )
    # only now: a loss of power before this line must show
    bus.scan([Transfer(address, bytes([STATUS.address, STATUS.write_one_clears]))])


TEST_PACKETS = 8
MOST_TEST_PACKETS = 24
"""If no 8 in a row fit among this many, the test has failed and begins again."""
MISFITS_TO_DISTRUST = 2


class PacketCheck:
    """The check of one chip's packets."""

    _misfits: int

    def __init__(self) -> None:
        self.trusted = False
        """The chip passed the test, and no packet has contradicted that since."""
        self.absent = False
        """The chip sends no CRC."""
        self.failures = 0
        """Tests failed, or trust lost, since the chip was last trusted."""
        self.offset = 0
        """Bits by which the chip's CRC differs from the data sheet's."""
        self._begin()

    def believes(self, address: int, data: bytes) -> bool:
        """Whether this packet (with its CRC) counts. address: where the chip was read."""
        offset = data[-1] ^ packet_crc(address, data[:-1])
        if not self.trusted:
            self._test(offset, data)
            return False
        if offset == self.offset:
            # the first packet after a misfit is not believed either
            believed = self._misfits == 0
            self._misfits = 0
            return believed
        self._misfits += 1
        if self._misfits >= MISFITS_TO_DISTRUST:
            self.trusted = False
            self.failures += 1
            self._begin()
        return False

    def _begin(self) -> None:
        """Begin the test again."""
        self._last = b""
        self._misfits = self._tested = self._agreed = self._same = 0

    def _test(self, offset: int, data: bytes) -> None:
        """Count a packet of the test, unless it is the same as the last one."""
        if data == self._last:
            return
        # packets must agree with each other, not with the data sheet's seed
        self._agreed = self._agreed + 1 if self._agreed and offset == self.offset else 1
        # a chip without a CRC pads each packet with the same byte
        self._same = self._same + 1 if data[-1:] == self._last[-1:] else 1
        self.offset = offset
        self._last = data
        self._tested += 1
        self.trusted = self._agreed >= TEST_PACKETS
        self.absent = not self.trusted and self._same >= TEST_PACKETS
        if self.trusted:
            # trust begins anew, without the memory of earlier tests
            self.failures = 0
            self._begin()
        elif self._tested >= MOST_TEST_PACKETS:
            self.failures += 1
            self._begin()


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
        self.setup = setup
        self.ready = False
        self.version = 1
        self.known = False
        """A TMAG5273 has identified itself at this finger's place."""
        self.check = PacketCheck()
        self.nacks = 0
        self.tried_ns = -TRY_AGAIN_NS
        self._last = b""
        self._changed_ns = 0
        self._converts = self._missed = False
        self._failures = 0

    @property
    def transfer(self) -> Transfer:
        """The transfer that reads the finger."""
        if not self.setup.packets:
            return Transfer(self.finger.read_at, bytes([RESULTS]), PACKET_BYTES)
        length = CHECKED_BYTES if self.setup.crc else PACKET_BYTES
        return Transfer(self.finger.read_at, b"", length)

    @property
    def settled(self) -> bool:
        """Whether its readings count from now on, or it is not read at all."""
        checked = self.check.trusted or not self.setup.crc
        return not self.ready or (self._converts and checked)

    def begin(self, now_ns: int) -> None:
        """A bring-up begins."""
        self.tried_ns = now_ns
        self.ready = False
        self.nacks = 0

    def brought_up(self, version: int, now_ns: int) -> None:
        """The chip is ready; its earlier conversions do not count."""
        self.ready = True
        self.known = True
        self.version = version
        self._last = b""
        self._changed_ns = now_ns
        self._converts = False
        self._failures = self.check.failures

    def needs_bring_up(self, why: str) -> bool:
        """Whether the reason of an invalid reading calls for a bring-up."""
        distrusted = why == "crc" and self.check.failures > self._failures
        return distrusted or self.nacks >= NACKS_TO_BRING_UP or why in REINIT_REASONS

    def judge(self, reply: Reply | None, came_ns: int) -> tuple[Packet | None, str]:
        """The reply's packet, and one word for why it is not valid ("" where it is).

        reply: None where the finger was not read. came_ns: when it came.
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
            # a test that has not failed yet is no reason to distrust the bus
            if under_test and not self.check.failures:
                return self._stale(data, came_ns) or "settling"
            return "crc"
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
