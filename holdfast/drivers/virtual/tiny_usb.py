"""An i2c-tiny-usb with one of four firmwares, which report a missing acknowledge in four ways.

Two of them drive the pins in software. They take SDA held low for an acknowledge, and their clocks
free the bus; after a message without STOP, BEGIN makes no START, because they assume that SCL is
high. The other two have a controller: it takes SDA held low for a busy bus, acknowledges nothing,
and always makes a START.
"""

from __future__ import annotations

from dataclasses import dataclass

from holdfast.drivers.virtual.usb_device import Device, Interface, stall
from holdfast.drivers.virtual.virtual_hand import BITS_OF_A_BYTE, VirtualHand

VENDOR_OUT = 0x41
VENDOR_IN = 0xC1
ECHO, GET_FUNC, SET_DELAY, GET_STATUS, I2C_IO = 0, 1, 2, 3, 4
BEGIN = 1
END = 2
FLAG_READ = 1
FUNC = 0x0EFF0009
"""I2C_FUNC_I2C and what the kernel emulates with it."""
IDLE = 0
ACKED = 1
NOT_ACKED = 2
BUFFER = 254


@dataclass(frozen=True)
class Firmware:
    """speed on USB; transfer_ns, bit_ns: time of a control transfer and of a bit.

    absent: the answer to a read of an absent chip. data_nak: how a written byte without acknowledge
    is reported: "status", "stall" or not at all. largest: message, bytes. swings: drives the pins
    in software. empty_reads: replaces an empty write by a read of one byte.
    """

    speed: str
    transfer_ns: int
    bit_ns: int
    absent: str
    data_nak: str
    largest: int
    swings: bool = False
    empty_reads: bool = False


FIRMWARES = {
    "avr": Firmware("low", 3_000_000, 20_000, "zeros", "", 254, swings=True),
    "rp2040": Firmware(
        "full", 350_000, 2_500, "stale", "status", 254, empty_reads=True
    ),
    "stm32": Firmware("full", 350_000, 2_500, "nothing", "status", 64),
    "pico": Firmware("full", 350_000, 10_000, "stall", "stall", 64, swings=True),
}
"""Of Till Harbaum and the Digispark, Nicolai Electronics, i2c-star, and I2C-Pico-USB."""


class VirtualTinyUsb(Device):
    """The bridge in front of a virtual hand. firmware: a name of FIRMWARES."""

    vendor = 0x0403
    product = 0xC631
    interfaces = (Interface(usb_class=(0, 0, 0)),)
    kernel_driver = frozenset({0})  # i2c-tiny-usb

    def __init__(self, hand: VirtualHand, firmware: str = "rp2040") -> None:
        self.hand = hand
        self.firmware = FIRMWARES[firmware]
        self.speed = self.firmware.speed
        self.strings = ("Till Harbaum", "i2c-tiny-usb", f"HOLDFAST-{firmware.upper()}")
        self.reset()

    def reset(self) -> None:
        """As plugged in."""
        self.delay_us = 10
        self._status = IDLE
        self._buffer = bytes(BUFFER)
        self._open = False

    def control_out(
        self, request_type: int, request: int, value: int, index: int, data: bytes
    ) -> None:
        """SET_DELAY, or a message to write."""
        self.hand.clock.spend(self.firmware.transfer_ns)
        if request_type != VENDOR_OUT:
            raise stall()
        if request == SET_DELAY and not data:
            self.delay_us = value
        elif request & ~(BEGIN | END) == I2C_IO and not value & FLAG_READ:
            self._write(request, index, data)
        else:
            raise stall()

    def control_in(
        self, request_type: int, request: int, value: int, index: int, length: int
    ) -> bytes:
        """Echo, functions, status, or a message to read."""
        self.hand.clock.spend(self.firmware.transfer_ns)
        if request_type != VENDOR_IN:
            raise stall()
        if request == ECHO:
            return value.to_bytes(2, "little")[:length]
        if request == GET_FUNC:
            return FUNC.to_bytes(4, "little")[:length]
        if request == GET_STATUS:
            return bytes([self._status])[:length]
        if request & ~(BEGIN | END) == I2C_IO and value & FLAG_READ:
            return self._read(request, index, length)
        raise stall()

    # -- messages

    def _write(self, request: int, address: int, data: bytes) -> None:
        self._fits(len(data))
        bits = self.hand.wire.bits
        reads = self.firmware.empty_reads and not data
        absent = not self._address(request, address << 1 | reads)
        if reads and not absent:
            self.hand.wire.read()
        # every byte goes out, also after one that was not acknowledged
        acked = [self.hand.wire.write(byte) for byte in data] if not absent else []
        refused = not all(acked)
        if absent or request & END or (refused and self.firmware.data_nak):
            self._stop()
        self._spend_bits(bits)
        if refused and self.firmware.data_nak == "status":
            self._status = NOT_ACKED
        if (absent and self.firmware.absent == "stall") or (
            refused and self.firmware.data_nak == "stall"
        ):
            raise stall()

    def _read(self, request: int, address: int, length: int) -> bytes:
        self._fits(length)
        bits = self.hand.wire.bits
        present = self._address(request, address << 1 | 1)
        data = bytes(self.hand.wire.read() for _ in range(length)) if present else b""
        if not present or request & END:
            self._stop()
        self._spend_bits(bits)
        if not present:
            return self._absent(length)
        # the buffer keeps old bytes, which some firmwares send for an absent chip
        self._buffer = (data + self._buffer[len(data) :])[:BUFFER]
        return data

    def _stop(self) -> None:
        self._open = False
        self.hand.wire.stop()

    def _address(self, request: int, byte: int) -> bool:
        """START (or a repeated START), then the address; the status reports its acknowledge."""
        self.hand.suffer()
        if not (self._open and request & BEGIN and self.firmware.swings):
            self.hand.wire.start()
        self._open = True
        acked = (
            self._swing()
            if self.firmware.swings and self.hand.wire.held_low
            else self.hand.wire.write(byte)
        )
        self._status = ACKED if acked else NOT_ACKED
        return acked

    def _swing(self) -> bool:
        """An address while SDA is held low.

        Nine clocks go out, and the last one looks acknowledged.
        """
        for _ in range(BITS_OF_A_BYTE):
            self.hand.wire.clock()
        self.hand.wire.stop()
        return True

    def _fits(self, length: int) -> None:
        if length > self.firmware.largest:
            raise stall()

    def _absent(self, length: int) -> bytes:
        """The data of a read that no chip answers."""
        if self.firmware.absent == "stall":
            raise stall()
        if self.firmware.absent == "nothing":
            return b""
        return (
            bytes(length) if self.firmware.absent == "zeros" else self._buffer[:length]
        )

    def _spend_bits(self, before: int) -> None:
        self.hand.clock.spend((self.hand.wire.bits - before) * self.firmware.bit_ns)
