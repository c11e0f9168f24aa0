"""Whether a chip's packets can be trusted, by the CRC after each; the CRC is tested first.

The CRC finds every error of one to three bits in a packet, and all but one in 256 of the others.
Two chips at one address are another matter: zeros win bit by bit, and about one such packet in a
hundred has a CRC that fits by chance. So no packet is trusted alone:

    at first                        8 different packets in a row must fit
    after one that does not fit     two in a row must fit; the second one counts
    after two that do not fit       8 again, and the driver brings the chip up again

Some chips in the field begin their CRC with another seed than the data sheet's (TI E2E 1200004,
1558871). Such a CRC is off by the same bits in every packet, which never happens with two chips at
one address. The test finds these bits and allows for them. A chip whose last byte is the same for
different packets sends no CRC at all.
"""

from __future__ import annotations

from holdfast.drivers.tmag5273 import packet_crc

TEST_PACKETS = 8
MOST_TEST_PACKETS = 24
"""If no 8 in a row fit among this many, the test has failed and begins again."""
MISFITS_TO_DISTRUST = 2


class PacketCheck:
    """The check of one chip's packets."""

    def __init__(self) -> None:
        self.trusted = False
        """The chip passed the test, and no packet has contradicted that since."""
        self.absent = False
        """The chip sends no CRC."""
        self.failures = 0
        """Tests failed, or trust lost, since the chip was last trusted."""
        self.offset = 0
        """Bits by which the chip's CRC differs from the data sheet's."""
        self._last = b""
        self._misfits = self._tested = self._agreed = self._same = 0

    def believes(self, address: int, data: bytes) -> bool:
        """Whether this packet (with its CRC) counts. address: where the chip was read."""
        offset = data[-1] ^ packet_crc(address, data[:-1])
        if not self.trusted:
            self._test(offset, data)
            return False
        if offset == self.offset:
            believed, self._misfits = not self._misfits, 0
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
        self._agreed = self._agreed + 1 if self._agreed and offset == self.offset else 1
        self._same = self._same + 1 if data[-1:] == self._last[-1:] else 1
        self.offset, self._last = offset, data
        self._tested += 1
        self.trusted = self._agreed >= TEST_PACKETS
        self.absent = not self.trusted and self._same >= TEST_PACKETS
        if self.trusted:
            self.failures = 0
            self._begin()
        elif self._tested >= MOST_TEST_PACKETS:
            self.failures += 1
            self._begin()
