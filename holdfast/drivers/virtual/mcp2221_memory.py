"""The memory of an MCP2221A: flash, the SRAM that starts as its copy, and four pins (DS20005565).

Offsets are those of a reply to READ FLASH DATA or GET SRAM SETTINGS without its first four bytes.
"""

from __future__ import annotations

CHIP_SETTINGS, PIN_SETTINGS, MANUFACTURER, PRODUCT, SERIAL, FACTORY_SERIAL = range(6)
"""What READ and WRITE FLASH DATA read and write."""
SECURITY, CLOCK, DAC, EDGES_ADC, VENDOR_ID, PRODUCT_ID, POWER, CURRENT = (
    0,
    1,
    2,
    3,
    4,
    6,
    8,
    9,
)
"""Of the chip settings; the ids have two bytes each, the low one first."""
SERIAL_ON, PROTECTION = 0x80, 0x03
"""Of SECURITY: whether USB shows the serial number, and the protection of the flash.

Protection 0 is open, 1 needs a password, 2 and 3 are locked.
"""
OPEN, BY_PASSWORD = 0, 1
FACTORY_CHIP = bytes(
    [SERIAL_ON | 0x7C, 0x12, 0x00, 0x60, 0xD8, 0x04, 0xDD, 0x00, 0x80, 50]
)
"""Clock 12 MHz at half duty, DAC and ADC on VDD, both edges, bus-powered, 100 mA.

0x7C: outputs that idle high.
"""
FACTORY_PINS = bytes([0x02, 0x03, 0x01, 0x01])
"""LED_URX, LED_UTX, USBCFG, LED_I2C."""
PASSWORD_BYTES = 8
LONGEST_STRING = 60
OK, READ_UNKNOWN, WRITE_UNKNOWN, NOT_ALLOWED = 0x00, 0x01, 0x02, 0x03
"""Second byte of a reply."""
TRIES = 3
"""Wrong passwords until none is accepted any more; the data sheet does not say how many."""
NEW = 0x80
"""In a byte of SET SRAM SETTINGS: use it."""
PINS = 4
FUNCTION, INPUT, OUTPUT_HIGH = 0x07, 0x08, 0x10
"""Of a pin's settings; function 0 is GPIO."""
NO_VALUE, NO_DIRECTION = 0xEE, 0xEF
"""Reported for a pin that is not GPIO."""


class Flash:
    """Survives every reset. serial: shown on USB while SERIAL_ON is set."""

    def __init__(self, serial: str) -> None:
        self._data = {
            CHIP_SETTINGS: FACTORY_CHIP,
            PIN_SETTINGS: FACTORY_PINS,
            MANUFACTURER: "Microchip Technology Inc.".encode("utf-16-le"),
            PRODUCT: "MCP2221 USB-I2C/UART Combo".encode("utf-16-le"),
            SERIAL: serial.encode("utf-16-le"),
            FACTORY_SERIAL: b"01234567",
        }
        self._password = bytes(PASSWORD_BYTES)
        self._unlocked, self._wrong = False, 0

    @property
    def chip(self) -> bytes:
        """The chip settings, [10]."""
        return self._data[CHIP_SETTINGS]

    @property
    def pins(self) -> bytes:
        """The pins' settings, [4]."""
        return self._data[PIN_SETTINGS]

    @property
    def strings(self) -> tuple[str, str, str]:
        """Manufacturer, product and serial number as USB shows them."""
        manufacturer, product, serial = (
            self._text(k) for k in (MANUFACTURER, PRODUCT, SERIAL)
        )
        return manufacturer, product, serial if self.chip[SECURITY] & SERIAL_ON else ""

    @property
    def ids(self) -> tuple[int, int]:
        """Vendor and product."""
        return tuple(
            int.from_bytes(self.chip[at : at + 2], "little")
            for at in (VENDOR_ID, PRODUCT_ID)
        )  # type: ignore[return-value]

    def read(self, command: bytes, reply: bytearray) -> None:
        """READ FLASH DATA: length, then a string's own type or nothing, then the data."""
        data = self._data.get(command[1])
        if data is None:
            reply[1] = READ_UNKNOWN
            return
        is_string = command[1] in (MANUFACTURER, PRODUCT, SERIAL)
        reply[2], reply[3] = (len(data) + 2, 0x03) if is_string else (len(data), 0)
        reply[4 : 4 + len(data)] = data

    def write(self, command: bytes, reply: bytearray) -> None:
        """WRITE FLASH DATA, which USB shows after the next reset."""
        kind = command[1]
        if kind not in (CHIP_SETTINGS, PIN_SETTINGS, MANUFACTURER, PRODUCT, SERIAL):
            reply[1] = WRITE_UNKNOWN
        elif not self._writable:
            reply[1] = NOT_ALLOWED
        elif kind == CHIP_SETTINGS:
            end = 2 + len(FACTORY_CHIP)
            self._data[kind], self._password = (
                command[2:end],
                command[end : end + PASSWORD_BYTES],
            )
        elif kind == PIN_SETTINGS:
            self._data[kind] = command[2 : 2 + PINS]
        else:
            self._data[kind] = command[
                4 : 4 + min(max(command[2] - 2, 0), LONGEST_STRING) // 2 * 2
            ]

    def unlock(self, command: bytes, reply: bytearray) -> None:
        """SEND FLASH ACCESS PASSWORD; only the next write shows whether it was right."""
        if self._wrong >= TRIES:
            reply[1] = NOT_ALLOWED
            return
        self._unlocked = command[2 : 2 + PASSWORD_BYTES] == self._password
        self._wrong = 0 if self._unlocked else self._wrong + 1

    def lock(self) -> None:
        """After a reset, the password is needed again."""
        self._unlocked = False

    @property
    def _writable(self) -> bool:
        protection = self.chip[SECURITY] & PROTECTION
        return protection == OPEN or (protection == BY_PASSWORD and self._unlocked)

    def _text(self, kind: int) -> str:
        return self._data[kind].decode("utf-16-le", "replace")


class Sram:
    """The settings in force: from flash at every start, then as SET SRAM SETTINGS changes them."""

    def __init__(self, flash: Flash) -> None:
        self._chip, self._pins = bytearray(flash.chip), bytearray(flash.pins)
        self.pins = GpioPins(flash.pins)

    def read(self, reply: bytearray) -> None:
        """GET SRAM SETTINGS.

        Both lengths, chip settings, the password as eight zeros, pin settings.
        """
        data = bytes(self._chip) + bytes(PASSWORD_BYTES) + bytes(self._pins)
        reply[2], reply[3] = len(self._chip) + PASSWORD_BYTES, PINS
        reply[4 : 4 + len(data)] = data

    def write(self, command: bytes) -> None:
        """SET SRAM SETTINGS: every byte whose highest bit is set."""
        clock, dac_reference, dac, adc_reference, edges, pins = command[2:8]
        if clock & NEW:
            self._chip[CLOCK] = clock & 0x1F
        if dac_reference & NEW:
            self._chip[DAC] = self._chip[DAC] & 0x1F | (dac_reference & 0x07) << 5
        if dac & NEW:
            self._chip[DAC] = self._chip[DAC] & 0xE0 | dac & 0x1F
        if adc_reference & NEW:
            self._chip[EDGES_ADC] = (
                self._chip[EDGES_ADC] & 0x60 | (adc_reference & 0x07) << 2
            )
        if edges & NEW:
            self._edges(edges)
        if pins & NEW:
            self._pins[:] = command[8 : 8 + PINS]
            self.pins.set(self._pins)

    def _edges(self, new: int) -> None:
        """Edges of GP1 that interrupt.

        Bit 4 changes rising to bit 3, bit 2 changes falling to bit 1.
        """
        for altered, wanted, kept in ((0x10, 0x08, 0x20), (0x04, 0x02, 0x40)):
            if new & altered:
                self._chip[EDGES_ADC] = self._chip[EDGES_ADC] & ~kept & 0xFF | (
                    kept if new & wanted else 0
                )


class GpioPins:
    """GP0 .. GP3 as they are now. levels.

    Applied from outside, read by the pins that are inputs.
    """

    def __init__(self, settings: bytes) -> None:
        self.levels = [0] * PINS
        self.set(settings)

    def set(self, settings: bytes | bytearray) -> None:
        """Function, direction and output of all four."""
        self._settings = list(settings)

    def read(self, reply: bytearray) -> None:
        """GET GPIO VALUES: value and direction of each."""
        for pin, setting in enumerate(self._settings):
            at, is_input = 2 + 2 * pin, bool(setting & INPUT)
            if setting & FUNCTION:
                reply[at : at + 2] = bytes([NO_VALUE, NO_DIRECTION])
            else:
                reply[at : at + 2] = bytes([self._level(pin), is_input])

    def write(self, command: bytes, reply: bytearray) -> None:
        """SET GPIO OUTPUT VALUES.

        For each pin, whether to change its output, the output, then its direction.
        """
        for pin in range(PINS):
            at = 2 + 4 * pin
            new = command[at : at + 4]
            if self._settings[pin] & FUNCTION:
                new = bytes([NO_VALUE] * 4)
            else:
                self._alter(pin, OUTPUT_HIGH, new[0], new[1])
                self._alter(pin, INPUT, new[2], new[3])
            reply[at : at + 4] = new

    def _level(self, pin: int) -> int:
        setting = self._settings[pin]
        return self.levels[pin] if setting & INPUT else int(bool(setting & OUTPUT_HIGH))

    def _alter(self, pin: int, bit: int, wanted: int, value: int) -> None:
        if wanted:
            self._settings[pin] = self._settings[pin] & ~bit | (bit if value else 0)
