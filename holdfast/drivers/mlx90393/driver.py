"""Drives an MLX90393 in burst mode: it converts all the time, and one read gives the newest result.

The chip has no register of its own name. It is known by what it does: the same one-byte command
(NOP) is answered with another mode after a start, and again after a stop.
A chip with registers takes each of these commands for a register's number and answers what that
register holds. Registers are written only after that. To identify a chip stops its burst, so a scan
disturbs a hand that is being read; that hand sees it, and starts the chip again.
"""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import DeviceNotFound, WrongDevice
from holdfast.drivers.bus import Bus, Reply, Transfer
from holdfast.drivers.chips import STALE_NS, Pause, Raw, require_averages
from holdfast.drivers.mlx90393 import registers as chip

AVERAGES = (4, 8, 16)
"""2^DIG_FILT. Fewer are not allowed with OSR 0, and more take longer than a sample at 150 Hz."""
STOP_S = 1e-3
STOP_TRIES = 8
"""A chip may complete a conversion before it stops."""
RESULT_LIMITS = tuple(int(1e3 * chip.RANGE_MT / one) for one in chip.SCALE_UT)
GARBAGE = (bytes(chip.LAYOUT.size), b"\xff" * chip.LAYOUT.size)


class Driver:
    """It lets a chip convert x, y and z all the time. averages: 4, 8 or 16, default 8."""

    name = chip.NAME
    addresses: tuple[int, ...] = chip.ADDRESSES
    # a chip of other makers could take a command for a value
    found_anywhere = False

    def __init__(self, averages: int | None = None) -> None:
        self.averages = 8 if averages is None else averages
        require_averages(self.averages, AVERAGES)
        self._filter = self.averages.bit_length() - 1
        self.conversion_s = chip.conversion_s(0, self._filter)

    def settings(self) -> dict[chip.Field, int]:
        """The fields of its registers that this driver sets; it leaves the others alone."""
        return {
            chip.HALLCONF: chip.HALL_DEFAULT,
            chip.GAIN_SEL: chip.GAIN,
            chip.BURST_DATA_RATE: 0,
            chip.TCMP_EN: 0,
            chip.EXT_TRIG: 0,
            chip.OSR: 0,
            chip.DIG_FILT: self._filter,
            chip.RES_X: chip.RESOLUTION,
            chip.RES_Y: chip.RESOLUTION,
            chip.RES_Z: chip.RESOLUTION,
        }

    def identify(self, bus: Bus, address: int, pause: Pause) -> int:
        """See that its mode follows the commands, and stop it; 1, as it has no versions.

        Raises DeviceNotFound, WrongDevice.
        """
        (reply,) = bus.scan([_command(address, chip.NOP)])
        if not reply.acked:
            raise DeviceNotFound(
                "does not answer",
                where=f"{address:#04x}",
                cause="no power, or a broken wire",
            )
        started = False
        stopped = _stopped(bus, address, pause)
        if stopped:
            start = _command(address, chip.START_BURST)
            answers = bus.scan([start, _command(address, chip.NOP)])
            started = all(_mode(one) == chip.BURST for one in answers)
            stopped = _stopped(bus, address, pause)
        if not stopped or not started:
            raise WrongDevice(
                f"its mode does not follow commands: no {chip.NAME}",
                where=f"{address:#04x}",
                cause="another chip, two chips at one address, or a chip whose memory is broken",
                next_step="holdfast scan lists the chips; or switch the sensor's power off and on",
            )
        return 1

    def configure(self, bus: Bus, address: int) -> None:
        """Set the fields of its registers, read them back, and start burst mode."""
        settings = self.settings()
        for register in chip.REGISTERS:
            fields = {one: n for one, n in settings.items() if one.register == register}
            held = _word(bus, address, register)
            wanted = held
            for field, number in fields.items():
                wanted = wanted & ~field.mask | number << field.low
            if held == wanted:
                continue
            data = bytes([chip.WRITE_REGISTER, wanted >> 8, wanted & 0xFF])
            bus.scan([Transfer(address, data + bytes([register << 2]), 1)])
            held = _word(bus, address, register)
            if held != wanted:
                raise WrongDevice(
                    f"does not keep its configuration ({held:04x}, not {wanted:04x})",
                    where=f"{address:#04x}",
                    cause="two chips at one address, or noise on the bus",
                )
        (reply,) = bus.scan([_command(address, chip.START_BURST)])
        if _mode(reply) != chip.BURST:
            raise WrongDevice(
                "does not start to convert",
                where=f"{address:#04x}",
                cause="two chips at one address, or noise on the bus",
            )

    def read(self, address: int) -> Transfer:
        """Status, x, y and z of the newest conversion."""
        return Transfer(address, bytes([chip.READ_MEASUREMENT]), chip.LAYOUT.size)

    def readings(self) -> AnswerJudge:
        """What judges the answers of one finger."""
        return AnswerJudge()

    def scale_ut(self, version: int) -> FloatArray:
        return np.array(chip.SCALE_UT)

    def range_mt(self, version: int) -> FloatArray:
        """[3] the largest field that counts."""
        return np.full(3, chip.RANGE_MT)

    def describe(self, address: int, version: int) -> str:
        """Its name and its range."""
        return f"{chip.NAME} ({chip.RANGE_MT:g} mT)"

    def health(self, bus: Bus, address: int) -> str:
        """Whether it refuses commands, as a chip whose memory is broken does."""
        (reply,) = bus.scan([_command(address, chip.NOP)])
        if not reply.acked:
            return "stopped answering"
        return "ERROR" if reply.data[0] & chip.ERROR else ""


def _command(address: int, command: int) -> Transfer:
    """A command of one byte, and the status byte that answers it."""
    return Transfer(address, bytes([command]), 1)


def _mode(reply: Reply) -> int:
    """The mode bits of a status byte; -1 for an error or no status."""
    if not reply.acked or reply.data[0] & chip.ERROR:
        return -1
    return reply.data[0] & chip.MODES


def _stopped(bus: Bus, address: int, pause: Pause) -> bool:
    """Tell a chip to stop; whether it says that it is in no mode."""
    for _ in range(STOP_TRIES):
        bus.scan([_command(address, chip.EXIT)])
        pause(STOP_S)
        (reply,) = bus.scan([_command(address, chip.NOP)])
        # a chip that refuses commands goes on refusing, and the other fingers wait
        if _mode(reply) <= 0:
            return _mode(reply) == 0
    return False


def _word(bus: Bus, address: int, register: int) -> int:
    """The 16 bits of a register. Raises WrongDevice."""
    read = Transfer(address, bytes([chip.READ_REGISTER, register << 2]), 3)
    (reply,) = bus.scan([read])
    if _mode(reply) != 0:
        raise WrongDevice(
            f"does not read its register {register}",
            where=f"{address:#04x}",
            cause="two chips at one address, or noise on the bus",
        )
    return int.from_bytes(reply.data[1:], "big")


class AnswerJudge:
    """Judges the answers of one finger.

    There is no counter. The status says that a result is new: burst mode, which a chip leaves
    when it loses its power, without ERROR, which it sets where it has not converted since it was
    last read. The first result after a start does not count: it may be of no conversion.
    """

    def __init__(self) -> None:
        self._results = 0
        self._new_ns = 0

    @property
    def converts(self) -> bool:
        """Whether one result came since the start, and none is overdue."""
        return self._results > 0

    def begin(self, now_ns: int) -> None:
        """The chip was brought up."""
        self._results = 0
        self._new_ns = now_ns

    def missed(self) -> None:
        """No reply came; the next one says itself whether the chip went on."""

    def judge(self, data: bytes, came_ns: int) -> tuple[Raw, str]:
        """Raw x, y, z, and one word for why they do not count ("" where they do)."""
        status, x, y, z = chip.LAYOUT.unpack(data)
        raw = (x - chip.ZERO, y - chip.ZERO, z - chip.ZERO)
        if data in GARBAGE:
            return raw, "garbage"
        if status & chip.RESET or status & chip.MODES != chip.BURST:
            return raw, "reset"
        if status & chip.ERROR:
            late = came_ns - self._new_ns > STALE_NS
            self._results = 0 if late else self._results
            return raw, "stale" if late else "settling"
        if status & chip.SIZE != chip.SIX_BYTES:
            return raw, "garbage"
        self._new_ns = came_ns
        self._results += 1
        if self._results < 2:
            return raw, "settling"
        pairs = zip(raw, RESULT_LIMITS, strict=True)
        saturated = any(abs(one) >= limit for one, limit in pairs)
        return raw, "saturated" if saturated else ""
