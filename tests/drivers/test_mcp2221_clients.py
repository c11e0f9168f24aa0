"""The virtual MCP2221A opened by programs that are not ours and that were not changed: EasyMCP2221
and Blinka.

Below them only the module `hid` and time are replaced.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Iterator
from typing import Any

import pytest
from hid_stand_in import HidModule

from holdfast.core.errors import AccessDenied
from holdfast.drivers.mcp2221 import Mcp2221
from holdfast.drivers.tmag5273 import (
    FACTORY_ADDRESSES,
    PACKET_BYTES,
    RESULTS,
    Setup,
    packet,
)
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.mcp2221 import VirtualMcp2221
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.virtual_hand import REST_UT, VirtualHand

A = FACTORY_ADDRESSES[0]
MUX = 0x70
IDENTITY = bytes([0x01, 0x49, 0x54])
BLINKA = ("adafruit_", "board", "busio", "digitalio", "microcontroller", "micropython")


class Plugged:
    """A virtual hand behind a virtual MCP2221A on a USB port; hid: what clients import."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.hand = VirtualHand(self.clock)
        self.device = VirtualMcp2221(self.hand)
        self.backend = VirtualBackend(
            self.device, self.clock, self.hand.faults, self.hand.power_off
        )
        self.hid = HidModule(self.backend)

    def looked_at_s(self) -> float:
        """The clock; a look at it takes a microsecond, so that a loop until a time-out ends."""
        self.clock.spend(1_000)
        return 1e-9 * self.clock.now_ns()


@pytest.fixture
def plugged(monkeypatch) -> Plugged:
    """Time passes only where a client or a transfer spends it."""
    made = Plugged()
    monkeypatch.setitem(sys.modules, "hid", made.hid)
    monkeypatch.setattr(
        time, "sleep", lambda seconds: made.clock.spend(round(1e9 * seconds))
    )
    monkeypatch.setattr(time, "perf_counter", made.looked_at_s)
    return made


@pytest.fixture
def easy(plugged, monkeypatch) -> Iterator[Any]:
    """EasyMCP2221's device, opened."""
    module = importlib.import_module("EasyMCP2221.MCP2221")
    monkeypatch.setattr(module, "hid", plugged.hid)
    monkeypatch.setattr(module.Device, "_catalog", {})
    device = module.Device()
    yield device
    device.hidhandler.close()


@pytest.fixture
def blinka(plugged, monkeypatch) -> Iterator[Any]:
    """Imports a module of Blinka's as on a machine whose only board is an MCP2221."""
    monkeypatch.setenv("BLINKA_MCP2221", "1")
    monkeypatch.setenv("BLINKA_MCP2221_RESET_DELAY", "0.5")
    monkeypatch.setenv("BLINKA_SKIP_DEPENDENCY_CHECK", "1")
    before = set(sys.modules)
    yield importlib.import_module
    for name in set(sys.modules) - before:
        if name.startswith(BLINKA):
            del sys.modules[name]


# -- EasyMCP2221


def test_easymcp2221_opens_the_bridge_and_reads_its_strings(easy):
    result = easy.read_flash_info()
    assert (result["USB_VENDOR"], result["USB_PRODUCT"]) == (
        "Microchip Technology Inc.",
        "MCP2221 USB-I2C/UART Combo",
    )
    assert (result["USB_SERIAL"], result["USB_FACT_SERIAL"]) == (
        "0000000001",
        "01234567",
    )
    assert easy.revision() == {
        "firmware": {"mayor": "A", "minor": "6"},
        "hardware": {"mayor": "1", "minor": "2"},
    }


def test_easymcp2221_finds_the_bridge_by_its_serial_number(easy, plugged):
    module = sys.modules["EasyMCP2221.MCP2221"]
    assert module.Device(usbserial="0000000001") is easy
    with pytest.raises(RuntimeError, match="No device found with serial"):
        module.Device(usbserial="0000000002")


def test_easymcp2221_reads_a_sensor_through_the_mux(easy, plugged):
    mux = easy.I2C_Slave(MUX)
    chip = easy.I2C_Slave(A, force=True)
    mux.write(b"\x01")
    assert chip.read_register(0x0D, 3) == IDENTITY
    for register, value in Setup().registers():
        chip.write_register(register, [value])
    plugged.clock.spend(10_000_000)
    assert packet(chip.read_register(RESULTS, PACKET_BYTES)).raw[2] == round(
        REST_UT[2] / 80e3 * 32768
    )


def test_easymcp2221_says_that_no_chip_answers_and_goes_on(easy):
    module = importlib.import_module("EasyMCP2221")
    with pytest.raises(module.NotAckError):
        easy.I2C_write(0x11, b"\x00")
    easy.I2C_write(MUX, b"\x01")
    assert easy.I2C_read(MUX, 1) == b"\x01"


def test_a_bridge_that_easymcp2221_has_open_is_busy_for_our_driver(easy, plugged):
    with pytest.raises(AccessDenied, match="busy"):
        Mcp2221(plugged.backend)


def test_a_bridge_that_our_driver_has_open_cannot_be_opened_by_hidapi(plugged):
    ours = Mcp2221(plugged.backend)
    with pytest.raises(OSError, match="open failed"):
        plugged.hid.device().open(0x04D8, 0x00DD)
    ours.close()
    plugged.hid.device().open(0x04D8, 0x00DD)


# -- Blinka


def test_blinka_reads_a_sensor_through_the_mux(blinka, plugged):
    board = blinka("board")
    busio = blinka("busio")
    i2c = busio.I2C(board.SCL, board.SDA, frequency=400_000)
    assert plugged.device.bus_hz == pytest.approx(400_000)
    i2c.writeto(MUX, b"\x01")
    read = bytearray(3)
    i2c.writeto_then_readfrom(A, b"\x0d", read)
    assert bytes(read) == IDENTITY
    for setting in Setup().registers():
        i2c.writeto(A, bytes(setting))
    plugged.clock.spend(10_000_000)
    read = bytearray(PACKET_BYTES)
    i2c.writeto_then_readfrom(A, bytes([RESULTS]), read)
    assert packet(bytes(read)).raw[2] == round(REST_UT[2] / 80e3 * 32768)


def test_blinka_scans_the_bus(blinka, plugged):
    board = blinka("board")
    busio = blinka("busio")
    i2c = busio.I2C(board.SCL, board.SDA)
    i2c.writeto(MUX, b"\x02")
    assert {A, MUX} <= set(i2c.scan())
    assert 0x36 not in i2c.scan()


def ask(device: VirtualMcp2221, *command: int) -> bytes:
    """The reply to one report."""
    device.write(0x03, bytes(command))
    return device.read(0x83, 64)


@pytest.mark.parametrize(
    ("command", "status"), [((0xB0, 6), 1), ((0xB1, 0), 1), ((0x99,), 1)]
)
def test_a_command_that_the_bridge_does_not_know_is_refused(command, status):
    device = VirtualMcp2221(VirtualHand(VirtualClock()))
    assert ask(device, *command)[:2] == bytes([command[0], status])
