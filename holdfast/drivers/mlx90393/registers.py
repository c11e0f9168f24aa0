"""The MLX90393, a 3-axis Hall sensor: commands, registers and numbers (Melexis 3901090393).

No data sheet of this chip is kept beside the code. What stands here is what its public data sheet
and public drivers agree on, and nothing was tried on a chip. The driver assumes:

- A status byte begins each answer. Its ERROR bit is set where data are read again before a new
  conversion, so it takes the place of a counter.
- A loss of power ends burst mode, and so does each reset.
- In burst mode without pauses a new conversion replaces one that was not read.
- At resolution 3, zero field reads 0x4000, and a field of either sign that is beyond the range is
  held at the end or reads as a larger one, and never as a smaller one.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

NAME = "MLX90393"
ADDRESSES = (0x0C, 0x0D, 0x0E, 0x0F, 0x18, 0x19, 0x1A, 0x1B)
"""By pins A1 and A0, four for each of two order codes."""

# -- commands

XYZ = 0x0E
"""Of a command: which of z, y, x and temperature it is about."""
NOP = 0x00
START_BURST = 0x10 | XYZ
READ_MEASUREMENT = 0x40 | XYZ
READ_REGISTER = 0x50
WRITE_REGISTER = 0x60
EXIT = 0x80

# -- the status byte

BURST, WAKE_ON_CHANGE, SINGLE = 0x80, 0x40, 0x20
MODES = BURST | WAKE_ON_CHANGE | SINGLE
ERROR = 0x10
"""A command was refused, data are not new, or the memory is broken."""
RESET = 0x04
"""In the first status byte after a reset."""
SIZE = 0x03
SIX_BYTES = 0x02
"""Of SIZE, after READ_MEASUREMENT: 2 * SIZE + 2 bytes follow."""
LAYOUT = struct.Struct(">B3H")
"""An answer to READ_MEASUREMENT: status, x, y, z."""

# -- registers


@dataclass(frozen=True)
class Field:
    """Some bits of a register: its number, the lowest bit, how many."""

    register: int
    low: int
    bits: int

    @property
    def mask(self) -> int:
        """Its bits in the register."""
        return (1 << self.bits) - 1 << self.low

    def read(self, word: int) -> int:
        """Its value in the register's 16 bits."""
        return (word & self.mask) >> self.low


HALLCONF = Field(0, 0, 4)
GAIN_SEL = Field(0, 4, 3)
BURST_DATA_RATE = Field(1, 0, 6)
TCMP_EN = Field(1, 10, 1)
EXT_TRIG = Field(1, 11, 1)
OSR = Field(2, 0, 2)
DIG_FILT = Field(2, 2, 3)
RES_X = Field(2, 5, 2)
RES_Y = Field(2, 7, 2)
RES_Z = Field(2, 9, 2)
REGISTERS = (0, 1, 2)
"""Those that have these fields."""

# -- numbers

HALL_DEFAULT = 0xC
"""HALLCONF for which the scales hold."""
GAIN = 3
RESOLUTION = 3
"""GAIN_SEL and RES: the whole result in steps of 8, so that no field wraps around."""
SCALE_UT = (3.004, 3.004, 4.840)
"""uT a count in x, y and z at this gain and resolution."""
ZERO = 0x4000
"""A result without a field."""
RANGE_MT = 49.0
"""The data sheet promises up to 50 mT, and x and y end at -49.2 mT."""
CONVERSION_0_S = 680e-6
"""From one conversion of three axes to the next, beside the axes themselves."""


def conversion_s(osr: int, dig_filt: int) -> float:
    """Time of one conversion of three axes: 67 us + 64 us * 2^OSR * (2 + 2^DIG_FILT) for an axis.

    >>> conversion_s(0, 3)
    0.002801
    """
    axis_us = 67 + 64 * (1 << osr) * (2 + (1 << dig_filt))
    return round(CONVERSION_0_S + 3e-6 * axis_us, 9)
