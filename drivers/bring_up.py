"""One TMAG5273 made ready: woken, identified, moved to an address of its own, configured, read back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from drivers.bus import Bus, Transfer
from drivers.layout import Finger
from drivers.tmag5273 import GENERAL_CALL, MANUFACTURER_ID, RANGES_MT, REGISTERS, Setup
from edge_runtime.errors import DeviceNotFound, WrongDevice

WAKE_S = 100e-6
READ_BACK = 9
"""Registers from 0 on that hold a configuration."""
CONFIG, IDENTITY = REGISTERS["DEVICE_CONFIG_1"].address, REGISTERS["I2C_ADDRESS"].address
STATUS, DEVICE = REGISTERS["CONV_STATUS"], REGISTERS["DEVICE_STATUS"]


def bring_up(bus: Bus, finger: Finger, setup: Setup, pause: Callable[[float], None]) -> int:
    """Make a finger's chip ready; its channel is joined already. Returns its version, 1 or 2.

    Raises DeviceNotFound where nothing answers, WrongDevice for another chip or one that does not keep its
    configuration, and what the bridge raises.
    """
    plain = dict(replace(setup, burst=False).registers())
    if finger.moved is not None:
        _move(bus, finger.address, finger.moved, pause)
    version = identify(bus, finger.read_at, pause, plain[CONFIG])
    _configure(bus, finger.read_at, plain)
    if setup.burst:
        bus.scan([Transfer(finger.read_at, bytes([CONFIG, dict(setup.registers())[CONFIG]]))])
    return version


def configure_all(bus: Bus, setup: Setup) -> None:
    """The same configuration to every chip that is joined, by general call; whether it was kept, bring_up sees."""
    bus.scan([Transfer(GENERAL_CALL, bytes(one)) for one in replace(setup, burst=False).registers()])


def identify(bus: Bus, address: int, pause: Callable[[float], None], config: int = 0) -> int:
    """Wake the chip and see that it is one: its version. Raises DeviceNotFound, WrongDevice.

    The first write wakes a sleeping chip, which does not acknowledge it, and takes one that was left in 1-byte
    mode (its last driver died) back to registers; config: what it writes to DEVICE_CONFIG_1.
    """
    wake = Transfer(address, bytes([CONFIG, config]))
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


def _move(bus: Bus, factory: int, moved: int, pause: Callable[[float], None]) -> None:
    """Give a chip an address of its own, unless it still has it from before. Raises as identify does."""
    try:
        identify(bus, moved, pause)
    except DeviceNotFound:
        identify(bus, factory, pause)
        bus.scan([Transfer(factory, bytes([IDENTITY, moved << 1 | 1]))])


def _configure(bus: Bus, address: int, plain: Mapping[int, int]) -> None:
    """Write what is not there yet, read back, and only then clear POR: until then a loss of power would go unseen."""
    wanted = bytes(plain.get(register, 0) for register in range(READ_BACK))
    read_back = Transfer(address, b"\0", READ_BACK)
    held = bus.scan([Transfer(address, bytes([DEVICE.address, DEVICE.write_one_clears])), read_back])[1]
    if held.data != wanted:
        held = bus.scan([*(Transfer(address, bytes(one)) for one in plain.items()), read_back])[-1]
    if held.data != wanted:
        raise WrongDevice(
            f"does not keep its configuration ({held.data.hex()}, not {wanted.hex()})", where=f"{address:#04x}",
            cause="two chips at one address, or noise on the bus",
        )  # fmt: skip
    bus.scan([Transfer(address, bytes([STATUS.address, STATUS.write_one_clears]))])
