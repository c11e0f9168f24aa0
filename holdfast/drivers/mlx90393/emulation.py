"""An MLX90393 by its commands, in a field that changes with time, as registers.py assumes it.

Covers what a driver of three axes in burst mode sends. Single measurements, wake on change, the
temperature, triggers, thresholds, offsets and the store of its memory are missing: their commands
are refused. Where nothing is known, the emulation does what is harder for a driver: results that
are not new are sent again beside the ERROR bit, and the first result after a start carries none
although it is of no conversion (seen on a chip: github.com/Wojtas5/MLX90393-driver).
"""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.drivers.mlx90393 import registers as chip
from holdfast.drivers.virtual.virtual_hand import EmulatedChip

RELEASED = 0xFF
POWER_ON = (0x0070 | chip.HALL_DEFAULT, 0x0000, 0x0000)
"""Registers after power-up: the largest sensitivity."""
REGISTER_COUNT = 64
LENGTHS = {chip.READ_REGISTER: 2, chip.WRITE_REGISTER: 4}
"""Bytes of the commands that have arguments."""
FINEST_UT = (0.1502, 0.1502, 0.242)
"""uT a step of the whole result of 19 bits, in x, y and z at the largest gain."""
GAINS = (5.0, 4.0, 3.0, 2.5, 2.0, 5 / 3, 4 / 3, 1.0)
"""By GAIN_SEL: how much larger a step is."""
LARGEST_FIELD_UT = 98e3
"""Beyond it the analogue part of the chip is at its end."""


class Chip(EmulatedChip):
    """One chip, as virtual_hand.py describes it."""

    addresses = chip.ADDRESSES
    noise_ut = (15.0, 15.0, 20.0)
    """Of one average, so that 8 have about that of the pads in simulation/effects/magnet.py."""

    def power_on(self) -> None:
        """Registers as in its memory, no mode; the first status byte will say RESET."""
        self.registers = [*POWER_ON, *[0] * (REGISTER_COUNT - len(POWER_ON))]
        self._mode = 0
        self._reset = chip.RESET
        self._command = b""
        self._answer: list[int] = []
        self._results = (chip.ZERO,) * 3
        self._started_ns = 0
        self._read_to = 0

    def fall_asleep(self) -> None:
        """It leaves its mode, and nothing converts."""
        self._mode = 0

    # -- the wire

    def addressed(self, address: int, *, read: bool) -> bool:
        """Whether it acknowledges; a read carries out the command that was written."""
        if not self._hears(address):
            return False
        if read:
            self._answer = self._carry_out(self._command)
        self._command = b""
        return True

    def write(self, byte: int) -> bool:
        """A byte of a command; it acknowledges each, also of commands that it does not know."""
        self._command += bytes([byte])
        return True

    def read(self) -> int:
        """The next byte of the answer."""
        return self._answer.pop(0) if self._answer else RELEASED

    def stop(self) -> None:
        """A command whose status is not read is carried out all the same."""
        if self._command:
            self._carry_out(self._command)
        self._command = b""

    # -- commands

    def _carry_out(self, command: bytes) -> list[int]:
        """The answer, which begins with a status byte."""
        if self._has("wrong"):
            return []
        code = command[0] if command else chip.NOP
        data: list[int] = []
        error = size = 0
        # a read without a command is answered like NOP
        if self._has("diag") or len(command or b"-") != LENGTHS.get(code, 1):
            error = chip.ERROR
        elif code == chip.EXIT:
            self._mode = 0
        elif code == chip.START_BURST:
            self._begin()
        elif code == chip.READ_MEASUREMENT:
            error = 0 if self._convert() else chip.ERROR
            size = chip.SIX_BYTES
            for result in self._results:
                data += result.to_bytes(2, "big")
        elif code == chip.READ_REGISTER:
            data += self.registers[command[1] >> 2].to_bytes(2, "big")
        elif code == chip.WRITE_REGISTER:
            word = int.from_bytes(command[1:3], "big")
            self.registers[command[3] >> 2] = word
        elif code != chip.NOP:
            error = chip.ERROR

        status = self._mode | error | self._reset | size
        self._reset = 0
        return [status, *data]

    def _value(self, field: chip.Field) -> int:
        return field.read(self.registers[field.register])

    def _begin(self) -> None:
        self._mode = chip.BURST
        self._started_ns = self._clock.now_ns()
        # the first read after a start finds data, although nothing was converted
        self._read_to = -1

    def _convert(self) -> bool:
        """Bring the results up to the last complete conversion; whether they are new."""
        if self._mode != chip.BURST or self._has("frozen"):
            return False
        osr, dig_filt = self._value(chip.OSR), self._value(chip.DIG_FILT)
        duration_s = chip.conversion_s(osr, dig_filt)
        done = self._completed(self._started_ns, duration_s)
        if done <= self._read_to:
            return False
        self._read_to = done
        if done:
            averages = 2 ** (osr + dig_filt)
            self._store(
                self._measured_ut(self._started_ns, done, duration_s, averages, done)
            )
        return True

    def _store(self, field_ut: Sequence[float]) -> None:
        """Results of 16 bits out of 19, at this gain and these resolutions."""
        gain = GAINS[self._value(chip.GAIN_SEL)]
        results = []
        for axis, field in enumerate((chip.RES_X, chip.RES_Y, chip.RES_Z)):
            held = max(-LARGEST_FIELD_UT, min(LARGEST_FIELD_UT, field_ut[axis]))
            whole = (1 << 17) + round(held / (gain * FINEST_UT[axis]))
            within = max(0, min((1 << 19) - 1, whole))
            results.append(within >> self._value(field) & 0xFFFF)

        self._results = (results[0], results[1], results[2])
