"""One TMAG5273 made ready: woken, identified, configured, read back."""

from __future__ import annotations

from collections.abc import Callable

from drivers.bus import Bus, Transfer
from drivers.tmag5273 import MANUFACTURER_ID, RANGES_MT, REGISTERS, Setup
from edge_runtime.errors import DeviceNotFound, WrongDevice

WAKE_S = 100e-6
READ_BACK = 9
"""Registers from 0 on that hold a configuration."""
CONFIG, IDENTITY = REGISTERS["DEVICE_CONFIG_1"].address, REGISTERS["I2C_ADDRESS"].address
STATUS, DEVICE = REGISTERS["CONV_STATUS"], REGISTERS["DEVICE_STATUS"]


def bring_up(bus: Bus, address: int, setup: Setup, pause: Callable[[float], None]) -> int:
    """Make the chip at an address ready; its channel is joined already. Returns its version, 1 or 2.

    Raises DeviceNotFound where nothing answers, WrongDevice for another chip or one that does not keep its
    configuration, and what the bridge raises.
    """
    version = identify(bus, address, pause)
    _configure(bus, address, setup)
    return version


def identify(bus: Bus, address: int, pause: Callable[[float], None]) -> int:
    """Wake the chip and see that it is one: its version. Raises DeviceNotFound, WrongDevice.

    The first write wakes a sleeping chip, which does not acknowledge it, and takes one that was left in 1-byte
    mode (its last driver died) back to registers.
    """
    wake = Transfer(address, bytes([CONFIG, 0]))
    bus.scan([wake])
    pause(WAKE_S)
    woken, identity = bus.scan([wake, Transfer(address, bytes([IDENTITY]), 4)])
    if not woken.acked or not identity.acked:
        raise DeviceNotFound("does not answer", where=f"{address:#04x}", cause="no power, or a broken wire")
    maker, version = int.from_bytes(identity.data[2:4], "little"), identity.data[1] & 3
    if maker != MANUFACTURER_ID or version not in RANGES_MT:
        raise WrongDevice(
            f"maker {maker:#06x}, version {version}: no TMAG5273", where=f"{address:#04x}",
            cause="another chip at this address, or two at once", next_step="holdfast scan",
        )  # fmt: skip
    return version


def _configure(bus: Bus, address: int, setup: Setup) -> None:
    """Write, read back, and only then clear POR: until then a loss of power would go unseen."""
    plain = Setup(setup.averages, setup.wide_xy, setup.wide_z)
    wanted = bytearray(READ_BACK)
    for register, byte in plain.registers():
        wanted[register] = byte
    told = bus.scan(
        [
            Transfer(address, bytes([DEVICE.address, DEVICE.write_one_clears])),
            *(Transfer(address, bytes(one)) for one in plain.registers()),
            Transfer(address, b"\0", READ_BACK),
            Transfer(address, bytes([STATUS.address, STATUS.write_one_clears])),
        ]
    )
    if told[-2].data != bytes(wanted):
        raise WrongDevice(
            f"does not keep its configuration ({told[-2].data.hex()}, not {wanted.hex()})", where=f"{address:#04x}",
            cause="two chips at one address, or noise on the bus",
        )  # fmt: skip
    if setup.burst:
        bus.scan([Transfer(address, bytes([CONFIG, dict(setup.registers())[CONFIG]]))])
