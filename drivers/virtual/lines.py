"""SCL and SDA of an I2C bus, edge by edge, as the chips on the wire decode them."""

from __future__ import annotations

from holdfast.drivers.virtual.wire import Wire


class BusLines:
    """SCL and SDA as the master drives them and as the chips decode them."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.scl = self.master = True
        self._state = "idle"
        self._count = self._byte = 0
        self._acked = self._addressing = False

    @property
    def sda(self) -> bool:
        """The SDA line: low if the master or a chip pulls it."""
        return self.master and not self.wire.held_low

    def set(self, scl: bool, sda: bool) -> None:
        """Pins written by the master; SDA that moves while SCL is high is a START or a STOP."""
        if self.scl and scl and sda != self.master and not self.wire.held_low:
            self._stop() if sda else self._start()
        rises = scl and not self.scl
        self.scl, self.master = scl, sda
        if rises:
            self._clocked(sda)

    def clock(self, bit: bool) -> bool:
        """One bit from the master (1 releases the line); the level of SDA while SCL was high."""
        self.master = bit
        level = self._clocked(bit)
        self.scl = False
        return level

    def byte_out(self, byte: int) -> None:
        """Eight bits from the master.

        In one step where a byte begins and no chip holds the line.
        """
        if self._state == "listen" and not self._count and not self.wire.held_low:
            self._byte, self._count = byte, 8
            self._acked = self.wire.write(byte)
            self.master, self.scl = bool(byte & 1), False
            return
        for k in range(8):
            self.clock(bool(byte >> 7 - k & 1))

    def byte_in(self) -> int:
        """Eight bits from a chip, the master's side unchanged.

        In one step where a chip's byte begins.
        """
        if self._state == "talk" and not self._count and self.master and not self.wire.held_low:
            self._byte, self._count = self.wire.read(), 8
            self.scl = False
            return self._byte
        byte = 0
        for _ in range(8):
            byte = byte << 1 | self.clock(self.master)
        return byte

    def sent(self, byte: int) -> bool:
        """A byte from the master, the line released, and its level then.

        Low where a chip acknowledges.
        """
        if self._state == "listen" and not self._count and not self.wire.held_low:
            self._acked = self.wire.write(byte)
            self.master, self.scl = True, False
            self._acknowledged(byte)
            return not self._acked
        self.byte_out(byte)
        self.set(scl=False, sda=True)
        return self.clock(bit=True)

    def got(self, acknowledge: bool) -> int:
        """A byte from the chips, the master's acknowledge bit (low to go on), the line released."""
        if self._state == "talk" and not self._count and self.master and not self.wire.held_low:
            self._byte, self.scl = self.wire.read(), False
            self._state = "silent" if acknowledge else "talk"
            return self._byte
        byte = self.byte_in()
        self.clock(acknowledge)
        self.set(scl=False, sda=True)
        return byte

    def _start(self) -> None:
        self.wire.start()
        self._state, self._count, self._byte, self._addressing = "listen", 0, 0, True

    def _stop(self) -> None:
        self.wire.stop()
        self._state = "idle"

    def _clocked(self, bit: bool) -> bool:
        if self.wire.held_low:
            self.wire.clock()
            return False
        if self._state == "listen":
            return self._from_master(bit)
        if self._state == "talk":
            return self._from_chips(bit)
        return bit

    def _from_master(self, bit: bool) -> bool:
        """Eight bits from the master, then the chips' acknowledge."""
        if self._count < 8:
            self._byte, self._count = self._byte << 1 & 0xFF | bit, self._count + 1
            if self._count == 8:
                self._acked = self.wire.write(self._byte)
            return bit
        self._count = 0
        self._acknowledged(self._byte)
        return bit and not self._acked

    def _acknowledged(self, byte: int) -> None:
        """The chip that acknowledged its address for a read sends next."""
        if self._addressing and self._acked and byte & 1:
            self._state = "talk"
        self._addressing = False

    def _from_chips(self, bit: bool) -> bool:
        """Eight bits from the chips, then the master's acknowledge; a NACK silences the chips."""
        if self._count == 0:
            self._byte = self.wire.read()
        if self._count < 8:
            level = bool(self._byte >> 7 - self._count & 1) and bit
            self._count += 1
            return level
        self._count = 0
        if bit:
            self._state = "silent"
        return bit
