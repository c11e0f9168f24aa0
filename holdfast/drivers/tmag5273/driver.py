"""Drives a TMAG5273: identify, configure, read back, and judge each reading.

Nothing is written to an address before a TMAG5273 has identified itself there. A register read is a
read, although it sends the register's number: that number only sets a pointer in every chip that
has registers.
"""

from __future__ import annotations

from holdfast.core.contract import FloatArray
from holdfast.core.errors import DeviceNotFound, WrongDevice
from holdfast.drivers.bus import Bus, Transfer
from holdfast.drivers.chips import STALE_NS, Pause, Raw, require_averages
from holdfast.drivers.tmag5273.registers import (
    CONTINUOUS,
    FACTORY_ADDRESSES,
    MANUFACTURER_ID,
    PACKET_BYTES,
    RANGES_MT,
    REGISTERS,
    RESERVED_STATUS,
    RESULTS,
    XYZ,
    Packet,
    conversion_s,
    packet,
    range_mt,
)

AVERAGES = (1, 2, 4, 8, 16, 32)
"""2^0 to 2^5, the values of CONV_AVG."""
LETTERS = dict(zip(FACTORY_ADDRESSES, "ABCD", strict=True))
WAKE_S = 100e-6
IDENTITY = REGISTERS["I2C_ADDRESS"].address
STATUS = REGISTERS["CONV_STATUS"]
DEVICE = REGISTERS["DEVICE_STATUS"]
READ_BACK = 9
"""The configuration is in this many registers, from 0 on."""
STATUS_BITS = (
    ("CONV_STATUS", "DIAG_STATUS"),
    ("DEVICE_STATUS", "OSC_ER"),
    ("DEVICE_STATUS", "OTP_CRC_ER"),
    ("DEVICE_STATUS", "VCC_UV_ER"),
)
"""Register and bit of what a chip reports as wrong."""
EDGE = 32767
GARBAGE = (bytes(PACKET_BYTES), b"\xff" * PACKET_BYTES)
ERASED = (0, 0, 0)
"""Results of a chip that has slept and not converted since; a field of exactly nothing on all three
axes is no reading of a magnet."""


class Driver:
    """It lets a chip convert all the time, z in its wide range. averages: 1 to 32, default 32."""

    name = "TMAG5273"
    addresses = FACTORY_ADDRESSES
    # a sensor may have been given another address
    found_anywhere = True

    def __init__(self, averages: int | None = None) -> None:
        self.averages = AVERAGES[-1] if averages is None else averages
        require_averages(self.averages, AVERAGES)
        self.conversion_s = conversion_s(self.averages)

    def registers(self) -> list[tuple[int, int]]:
        """(address, byte) in the order to write: the operating mode last."""
        one = REGISTERS
        averaging = self.averages.bit_length() - 1
        return [
            one["INT_CONFIG_1"].setting(MASK_INTB=1),
            one["SENSOR_CONFIG_1"].setting(MAG_CH_EN=XYZ),
            one["SENSOR_CONFIG_2"].setting(Z_RANGE=1),
            one["T_CONFIG"].setting(),
            one["DEVICE_CONFIG_1"].setting(MAG_TEMPCO=1, CONV_AVG=averaging),
            one["DEVICE_CONFIG_2"].setting(LP_LN=1, OPERATING_MODE=CONTINUOUS),
        ]

    def identify(self, bus: Bus, address: int, pause: Pause) -> int:
        """Wake the chip, check that it is a TMAG5273; its version, 1 or 2. Nothing is written.

        A sleeping chip does not acknowledge the read that wakes it. Raises DeviceNotFound,
        WrongDevice.
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
                cause="another chip, two chips at one address, or a chip that another program "
                "left in 1-byte mode",
                next_step="holdfast scan lists the chips; or switch the sensor's power off and on",
            )
        return version

    def configure(self, bus: Bus, address: int) -> None:
        """Write the registers that differ, read them back, and only then clear POR.

        Until POR is cleared, the chip reports a loss of power; clearing it earlier would hide one.
        """
        registers = dict(self.registers())
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

    def read(self, address: int) -> Transfer:
        """x, y, z and CONV_STATUS."""
        return Transfer(address, bytes([RESULTS]), PACKET_BYTES)

    def readings(self) -> PacketJudge:
        """What judges the packets of one finger."""
        return PacketJudge()

    def scale_ut(self, version: int) -> FloatArray:
        """[3] uT a count: a 32768th of the full scale (equation 10).

        >>> (16384 * Driver().scale_ut(1)).tolist()
        [20000.0, 20000.0, 40000.0]
        """
        scale: FloatArray = 1e3 * self.range_mt(version) / 32768.0
        return scale

    def range_mt(self, version: int) -> FloatArray:
        """[3] full scale of x, y, z, as the registers set it."""
        return range_mt(version)

    def describe(self, address: int, version: int) -> str:
        """Its letter, where the address tells it, its version and its ranges."""
        narrow, wide = RANGES_MT[version]
        letter = LETTERS.get(address, "?")
        return f"TMAG5273 {letter}{version} ({narrow:g}/{wide:g} mT)"

    def health(self, bus: Bus, address: int) -> str:
        """What the status registers report as wrong."""
        troubles = []
        for register, name in STATUS_BITS:
            one = REGISTERS[register]
            (reply,) = bus.scan([Transfer(address, bytes([one.address]), 1)])
            if not reply.acked:
                return "stopped answering"
            if one.read(reply.data[0], name):
                troubles.append(name)

        return ", ".join(troubles)


class PacketJudge:
    """Judges the packets of one finger.

    The chip converted anew if its packet differs from the last one: results and SET_COUNT change
    with a conversion and with nothing else. SET_COUNT alone is not enough: it rolls over every 8
    conversions (19.4 ms), so it seems to stand still when the hand is read at 50 Hz.
    """

    def __init__(self) -> None:
        self.converts = False
        self._missed = False
        self._last = b""
        self._changed_ns = 0

    def begin(self, now_ns: int) -> None:
        """The chip was brought up; its earlier conversions do not count."""
        self._last = b""
        self._changed_ns = now_ns
        self.converts = False

    def missed(self) -> None:
        """No reply came, so the chip may be asleep."""
        self._missed = True

    def judge(self, data: bytes, came_ns: int) -> tuple[Raw, str]:
        """Raw x, y, z, and one word for why they do not count ("" where they do)."""
        found = packet(data)
        return found.raw, self._trouble(found, data, came_ns)

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
            self.converts = bool(self._last) and not slept
            self._missed = False
            self._last = data
            self._changed_ns = came_ns

        if came_ns - self._changed_ns > STALE_NS:
            self.converts = False
            return "stale"
        return "" if self.converts else "settling"
