"""An MCP2221A: its HID reports, and its I2C engine with the states and traps known from the field.

States and undocumented bytes are those of EasyMCP2221. Two things are guesses: the time of a
cancel, and the report descriptor (Microchip's generic one; we found no dump of the real one).
Settings can be read, as other programs do when they open it, and cannot be changed: no driver here
uses its pins, its flash or its serial port.
"""

from __future__ import annotations

from holdfast.drivers.virtual.usb_device import (
    INTERRUPT,
    Device,
    Endpoint,
    Interface,
    stall,
)
from holdfast.drivers.virtual.virtual_hand import VirtualHand

OUT_ENDPOINT = 0x03
IN_ENDPOINT = 0x83
REPORT = 64
REPORT_NS = 1_500_000
"""Of a report, each way."""
CANCEL_NS = 4_000_000
"""From a cancel until the engine is idle."""
REPORT_DESCRIPTOR = bytes.fromhex(
    "0600ff0901a10119012940150026ff00750895408100190129409100c0"
)
"""Usage page 0xFF00, usage 1; 64 bytes in and 64 out, without a report number."""
COMPOSITE = (0xEF, 2, 1)
SERIAL_PORT = (2, 2, 1)
SERIAL_DATA = (0x0A, 0, 0)
HID = (3, 0, 0)
"""Class, subclass and protocol of the device and of its interfaces."""
STATUS_SET = 0x10
GET_DATA = 0x40
RESET = bytes([0x70, 0xAB, 0xCD, 0xEF])
SET_SRAM = 0x60
GET_SRAM = 0x61
READ_FLASH = 0xB0
STRINGS = ("Microchip Technology Inc.", "MCP2221 USB-I2C/UART Combo", "0000000001")
CHIP_SETTINGS = bytes.fromhex("fc 12 00 60 d8 04 dd 00 80 32")
"""Clock 12 MHz at half duty, DAC and ADC on VDD, ids, bus-powered, 100 mA (DS20005565)."""
PIN_SETTINGS = bytes.fromhex("02 03 01 01")
"""LED_URX, LED_UTX, USBCFG, LED_I2C."""
PASSWORD_BYTES = 8
STRING_TYPE = 3
FLASH = {0: CHIP_SETTINGS, 1: PIN_SETTINGS, 5: b"01234567"}
"""READ FLASH DATA, besides the three strings (2, 3 and 4); 5 is the factory's serial number."""
UNKNOWN = 1
"""Second byte of a reply to a command that the bridge does not know."""
REVISIONS = b"A612"
"""Of hardware and firmware, two characters each."""
WRITE, READ, WRITE_AGAIN, READ_AGAIN, WRITE_NO_STOP = 0x90, 0x91, 0x92, 0x93, 0x94
CANCEL = 0x10
SET_SPEED = 0x20
SPEED_SET = 0x20
SPEED_NOT_SET = 0x21
IDLE, START_TIMEOUT, NACK, WRITING, WRITTEN_NO_STOP = 0x00, 0x12, 0x25, 0x42, 0x45
READING, DATA_READY, STOPPING, STOP_WAIT, STOP_TIMEOUT = 0x50, 0x55, 0x60, 0x61, 0x62
NO_DATA = 0x41
NO_COUNT = 127
UNUSED_18 = 0x00
CONFUSED_18 = 0x08
GOOD_18 = 0x10
USED_21 = 0x60
MOST_BYTES = 60
BOGUS = 0xFF


class VirtualMcp2221(Device):
    """The bridge in front of a virtual hand."""

    vendor = 0x04D8
    product = 0x00DD
    usb_class = COMPOSITE
    strings = STRINGS
    interfaces: tuple[Interface, ...] = (
        Interface(usb_class=SERIAL_PORT),
        Interface(usb_class=SERIAL_DATA),
        Interface(
            (
                Endpoint(IN_ENDPOINT, INTERRUPT, REPORT),
                Endpoint(OUT_ENDPOINT, INTERRUPT, REPORT),
            ),
            HID,
            REPORT_DESCRIPTOR,
        ),
    )
    kernel_driver = frozenset({0, 1, 2})  # cdc_acm, cdc_acm, hid-mcp2221

    def __init__(self, hand: VirtualHand) -> None:
        self.hand = hand
        self.reset()

    def reset(self) -> None:
        """As plugged in: 100 kHz, an engine that was never used."""
        self.bus_hz = 100e3
        self.state = IDLE
        self.used = False
        self.confused = False
        self.hangs = False
        self._nacked = False
        self._meanwhile = IDLE
        self._busy_until_ns = 0
        self._length = 0
        self._data = b""
        self._divider = 117
        self._reply = b""

    def tick_sda(self) -> None:
        """SDA moves while the engine is idle, as when a chip is plugged in.

        A used engine is confused.
        """
        self.confused = self.used

    def write(self, endpoint: int, data: bytes) -> None:
        """A command; an earlier reply that was not read is lost."""
        if endpoint != OUT_ENDPOINT:
            raise stall()
        self.hand.clock.spend(REPORT_NS)
        self.hand.suffer()
        command = data.ljust(REPORT, b"\0")
        if command.startswith(RESET):
            self.reset()
            # the bridge leaves USB and comes back as a new device
            self.restarts += 1
            return
        reply = bytearray(REPORT)
        reply[0] = command[0]
        if command[0] == STATUS_SET:
            self._status_set(command, reply)
        elif command[0] == GET_DATA:
            self._get_data(reply)
        elif WRITE <= command[0] <= WRITE_NO_STOP:
            self._transfer(command, reply)
        else:
            self._settings(command, reply)

        self._reply = bytes(reply)

    def read(self, endpoint: int, length: int) -> bytes:
        """The reply, once."""
        if endpoint != IN_ENDPOINT:
            raise stall()
        self.hand.clock.spend(REPORT_NS)
        reply = self._reply
        self._reply = b""
        return reply[:length]

    # -- commands

    def _settings(self, command: bytes, reply: bytearray) -> None:
        """The settings as from the factory; a change of the SRAM has no effect."""
        if command[0] == GET_SRAM:
            # the password reads as zeros
            data = CHIP_SETTINGS + bytes(PASSWORD_BYTES) + PIN_SETTINGS
            reply[2] = len(CHIP_SETTINGS) + PASSWORD_BYTES
            reply[3] = len(PIN_SETTINGS)
            reply[4 : 4 + len(data)] = data
        elif command[0] == READ_FLASH and 2 <= command[1] < 2 + len(STRINGS):
            data = STRINGS[command[1] - 2].encode("utf-16-le")
            reply[2] = len(data) + 2
            reply[3] = STRING_TYPE
            reply[4 : 4 + len(data)] = data
        elif command[0] == READ_FLASH and command[1] in FLASH:
            data = FLASH[command[1]]
            reply[2] = len(data)
            reply[4 : 4 + len(data)] = data
        elif command[0] != SET_SRAM:
            reply[1] = UNKNOWN

    def _shown(self) -> int:
        """The state that the engine reports, which is another one while it works."""
        return (
            self._meanwhile
            if self.hand.clock.now_ns() < self._busy_until_ns
            else self.state
        )

    def _status_set(self, command: bytes, reply: bytearray) -> None:
        if command[3] == SET_SPEED:
            quiet = self._shown() == IDLE
            reply[3] = SPEED_SET if quiet else SPEED_NOT_SET
            if quiet:
                self._divider = command[4]
                self.bus_hz = 12e6 / (command[4] + 3)
        reply[8] = self._shown()
        if command[2] == CANCEL:
            self._cancel()
            reply[2], reply[8] = CANCEL, STOPPING  # in any case
        # requested and transferred length
        reply[9:11] = reply[11:13] = self._length.to_bytes(2, "little")
        reply[14] = self._divider
        reply[18] = self._byte_18()
        reply[20] = 0x40 if self._nacked else 0
        reply[21] = USED_21 if self.used else 0
        reply[22] = 1
        reply[23] = 0 if self.hand.wire.held_low else 1
        reply[46:50] = REVISIONS

    def _byte_18(self) -> int:
        if not self.used:
            return UNUSED_18
        return (
            CONFUSED_18
            if self.confused or self.state in (NACK, WRITTEN_NO_STOP)
            else GOOD_18
        )

    def _cancel(self) -> None:
        """An engine that was never used hangs from then on.

        With a held bus it cannot send a STOP.
        """
        self._work(CANCEL_NS, STOP_WAIT)
        self.hangs = self.hangs or not self.used
        if self.hangs or self.hand.wire.held_low:
            self.state = STOP_TIMEOUT
            return
        if self.state == WRITTEN_NO_STOP:
            self.hand.wire.stop()
        self.state = IDLE
        self.confused = False
        self._nacked = False
        self._data = b""

    def _get_data(self, reply: bytearray) -> None:
        reply[2] = self._shown()
        if reply[2] != DATA_READY:
            reply[1] = NO_DATA
            reply[3] = NO_COUNT
            return
        reply[3] = len(self._data)
        reply[4 : 4 + len(self._data)] = self._data
        self.state = IDLE
        self._data = b""

    def _transfer(self, command: bytes, reply: bytearray) -> None:
        kind = command[0]
        length = int.from_bytes(command[1:3], "little")
        address = command[3]
        allowed = (
            (WRITTEN_NO_STOP, IDLE, NACK)
            if kind in (WRITE_AGAIN, READ_AGAIN)
            else (IDLE, NACK)
        )
        if self._shown() not in allowed or not 0 < length <= MOST_BYTES:
            reply[1] = 1
            reply[2] = self._shown()
            return
        self.used = True
        self._length = length
        bits = self.hand.wire.bits
        if self.hand.wire.held_low:
            self.state = START_TIMEOUT
        elif self.confused or self.state == NACK:
            # the trap that the driver must avoid: it answers as if all were well
            self._bogus(kind, length)
        elif kind in (READ, READ_AGAIN):
            self._read(address, length)
        else:
            self._write(kind, address, command[4 : 4 + length])

        working = READING if kind in (READ, READ_AGAIN) else WRITING
        self._work(round(1e9 * (self.hand.wire.bits - bits) / self.bus_hz), working)
        reply[2] = self._shown()

    # -- the engine

    def _work(self, duration_ns: int, state: int) -> None:
        """Report this state for so long; USB goes on."""
        self._meanwhile = state
        self._busy_until_ns = self.hand.clock.now_ns() + duration_ns

    def _bogus(self, kind: int, length: int) -> None:
        """A transfer that looks good and never was on the wire."""
        self.confused = self._nacked = False
        if kind in (READ, READ_AGAIN):
            self.state = DATA_READY
            self._data = bytes([BOGUS]) * length
        else:
            self.state = WRITTEN_NO_STOP if kind == WRITE_NO_STOP else IDLE

    def _read(self, address: int, length: int) -> None:
        wire = self.hand.wire
        wire.start()
        if wire.write(address | 1):
            self.state = DATA_READY
            self._data = bytes(wire.read() for _ in range(length))
        else:
            self.state = NACK
            self._nacked = True
        wire.stop()

    def _write(self, kind: int, address: int, data: bytes) -> None:
        wire = self.hand.wire
        wire.start()
        if not all(wire.write(byte) for byte in (address & 0xFE, *data)):
            self.state = NACK
            self._nacked = True
            wire.stop()
        elif kind == WRITE_NO_STOP:
            self.state = WRITTEN_NO_STOP
        else:
            self.state = IDLE
            wire.stop()
