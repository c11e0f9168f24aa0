"""The TMAG5273, a 3-axis Hall sensor: its registers as data, its numbers as formulas (TI SLYS045A).

The same table is used by the driver and by the emulation. Four factory addresses (A1 0x35, B1 0x22,
C1 0x78, D1 0x44), so six on one bus need a mux or new addresses.
Versions 1 and 2 differ in range: 40 / 80 mT and 133 / 266 mT.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from holdfast.core.contract import FloatArray

FACTORY_ADDRESSES = (0x35, 0x22, 0x78, 0x44)
MANUFACTURER_ID = 0x5449
RANGES_MT = {1: (40.0, 80.0), 2: (133.0, 266.0)}
"""DEVICE_ID.VER -> full scale with the range bit clear and set, mT."""
SHORTEST_WAKE_S = 50e-6
"""From the read that wakes a sleeping chip (which it does not acknowledge) until it answers."""


@dataclass(frozen=True)
class Register:
    """Its address, its value after power-on, and its bit fields: name -> (lowest bit, bits).

    write_one_clears: bits that a written 1 clears; writable: bits that a write changes.
    """

    address: int
    reset: int = 0
    writable: int = 0xFF
    write_one_clears: int = 0
    fields: Mapping[str, tuple[int, int]] = field(default_factory=dict)

    def value(self, **fields: int) -> int:
        """A byte with these fields set, all others 0.

        >>> hex(REGISTERS["DEVICE_CONFIG_1"].value(MAG_TEMPCO=1, CONV_AVG=5))
        '0x34'
        """
        byte = 0
        for name, number in fields.items():
            low, bits = self.fields[name]
            if not 0 <= number < 1 << bits:
                raise ValueError(f"{name} = {number} does not fit {bits} bits")
            byte |= number << low

        return byte

    def setting(self, **fields: int) -> tuple[int, int]:
        """(address, byte) with these fields set, to be written."""
        return self.address, self.value(**fields)

    def read(self, byte: int, name: str) -> int:
        """One field out of a byte."""
        low, bits = self.fields[name]
        return byte >> low & (1 << bits) - 1


# Of the fields only those that the driver or the emulation uses.
REGISTERS: dict[str, Register] = {
    "DEVICE_CONFIG_1": Register(
        0x00,
        fields={
            "MAG_TEMPCO": (5, 2),
            "CONV_AVG": (2, 3),
        },
    ),
    "DEVICE_CONFIG_2": Register(
        0x01,
        fields={
            "LP_LN": (4, 1),
            "OPERATING_MODE": (0, 2),
        },
    ),
    "SENSOR_CONFIG_1": Register(0x02, fields={"MAG_CH_EN": (4, 4)}),
    "SENSOR_CONFIG_2": Register(
        0x03,
        writable=0x7F,
        fields={
            "X_Y_RANGE": (1, 1),
            "Z_RANGE": (0, 1),
        },
    ),
    "X_THR_CONFIG": Register(0x04),
    "Y_THR_CONFIG": Register(0x05),
    "Z_THR_CONFIG": Register(0x06),
    "T_CONFIG": Register(0x07),
    "INT_CONFIG_1": Register(
        0x08,
        fields={
            "MASK_INTB": (0, 1),
        },
    ),
    "MAG_GAIN_CONFIG": Register(0x09),
    "MAG_OFFSET_CONFIG_1": Register(0x0A),
    "MAG_OFFSET_CONFIG_2": Register(0x0B),
    "I2C_ADDRESS": Register(0x0C),
    "DEVICE_ID": Register(0x0D, reset=0x01, writable=0),
    "MANUFACTURER_ID_LSB": Register(0x0E, reset=MANUFACTURER_ID & 0xFF, writable=0),
    "MANUFACTURER_ID_MSB": Register(0x0F, reset=MANUFACTURER_ID >> 8, writable=0),
    "T_MSB_RESULT": Register(0x10, writable=0),
    "T_LSB_RESULT": Register(0x11, writable=0),
    "X_MSB_RESULT": Register(0x12, writable=0),
    "X_LSB_RESULT": Register(0x13, writable=0),
    "Y_MSB_RESULT": Register(0x14, writable=0),
    "Y_LSB_RESULT": Register(0x15, writable=0),
    "Z_MSB_RESULT": Register(0x16, writable=0),
    "Z_LSB_RESULT": Register(0x17, writable=0),
    "CONV_STATUS": Register(
        0x18,
        reset=0x10,
        writable=0,
        write_one_clears=0x10,
        fields={
            "SET_COUNT": (5, 3),
            "POR": (4, 1),
            "DIAG_STATUS": (1, 1),
            "RESULT_STATUS": (0, 1),
        },
    ),
    "ANGLE_RESULT_MSB": Register(0x19, writable=0),
    "ANGLE_RESULT_LSB": Register(0x1A, writable=0),
    "MAGNITUDE_RESULT": Register(0x1B, writable=0),
    "DEVICE_STATUS": Register(
        0x1C,
        reset=0x10,
        writable=0,
        write_one_clears=0x0F,
        fields={
            "OSC_ER": (3, 1),
            "OTP_CRC_ER": (1, 1),
            "VCC_UV_ER": (0, 1),
        },
    ),
}
STANDBY = 0
SLEEP = 1
CONTINUOUS = 2
"""DEVICE_CONFIG_2.OPERATING_MODE."""
XYZ = 7
"""SENSOR_CONFIG_1.MAG_CH_EN."""
RESULTS = REGISTERS["X_MSB_RESULT"].address
"""Seven bytes from here: x, y, z (big-endian) and CONV_STATUS."""
LAYOUT = struct.Struct(">3hB")
PACKET_BYTES = LAYOUT.size
RESERVED_STATUS = 0x0C
"""Bits of CONV_STATUS that are always 0."""


def conversion_s(averages: int, axes: int = 3) -> float:
    """Time of one conversion: 25 us (N axes + 1) (reproduces table 7-4).

    >>> conversion_s(32)
    0.002425
    """
    return round(25e-6 * (averages * axes + 1), 9)


def range_mt(version: int) -> FloatArray:
    """[3] full scale of x, y, z, as the driver sets it."""
    narrow, wide = RANGES_MT[version]
    return np.array([narrow, narrow, wide])


@dataclass(frozen=True)
class Packet:
    """One reading: raw x, y, z of 16 bits, signed, and CONV_STATUS."""

    raw: tuple[int, int, int]
    status: int

    @property
    def reset(self) -> bool:
        """Power was lost since POR was cleared, and with it the configuration and the address."""
        return bool(REGISTERS["CONV_STATUS"].read(self.status, "POR"))

    @property
    def failing(self) -> bool:
        """The chip's own diagnosis failed."""
        return bool(REGISTERS["CONV_STATUS"].read(self.status, "DIAG_STATUS"))


def packet(data: bytes) -> Packet:
    """x, y, z and CONV_STATUS out of seven bytes.

    >>> packet(bytes([0x40, 0, 0xFF, 0xFF, 0, 1, 0xB1])).raw
    (16384, -1, 1)
    """
    x, y, z, status = LAYOUT.unpack(data)
    return Packet((x, y, z), status)
