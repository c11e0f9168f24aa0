"""What is on a bus: muxes, sensors, their variants, and what is wrong with them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.bring_up import identify
from drivers.bus import Bus, Transfer
from drivers.layout import joined
from drivers.tmag5273 import FACTORY_ADDRESSES, RANGES_MT, REGISTERS
from edge_runtime.errors import DeviceNotFound, WrongDevice

FIRST_ADDRESS, LAST_ADDRESS = 0x08, 0x7F
"""0x78 is a factory address of the sensor, which tools that stop at 0x77 never see."""
MUX_ADDRESSES = range(0x70, 0x78)
LETTERS = dict(zip(FACTORY_ADDRESSES, "ABCD", strict=True))


@dataclass(frozen=True)
class Found:
    """Something that acknowledged: where, what, and what is wrong with it ("" where nothing is)."""

    address: int
    channel: int | None
    what: str
    trouble: str = ""


def look_at(bus: Bus, pause: Callable[[float], None]) -> list[Found]:
    """Everything on the bus, and behind every channel of a mux at 0x70. Raises what the bridge raises.

    Writes only what identifies a TMAG5273, and only to addresses that acknowledge; other chips are read from.
    """
    muxes = [address for address in MUX_ADDRESSES if _answers(bus, address)]
    for address in muxes:
        bus.scan([Transfer(address, b"\0")])
    found = [Found(address, None, "mux (TCA9548A)") for address in muxes]
    found += _sensors(bus, None, set(muxes), pause)
    taken = {one.address for one in found}
    for channel in range(8) if 0x70 in muxes else ():
        bus.scan([joined({channel})])
        found += _sensors(bus, channel, taken, pause)
    return found + _clashes(found)


def _answers(bus: Bus, address: int) -> bool:
    """Whether anybody acknowledges; a sleeping sensor does from the second time on."""
    return any(bus.scan([Transfer(address, b"", 1)])[0].acked for _ in range(2))


def _sensors(bus: Bus, channel: int | None, taken: set[int], pause: Callable[[float], None]) -> list[Found]:
    there = [a for a in range(FIRST_ADDRESS, LAST_ADDRESS + 1) if a not in taken and _answers(bus, a)]
    return [_identified(bus, address, channel, pause) for address in there]


def _identified(bus: Bus, address: int, channel: int | None, pause: Callable[[float], None]) -> Found:
    try:
        version = identify(bus, address, pause)
    except (DeviceNotFound, WrongDevice) as error:
        return Found(address, channel, "unknown", error.what)
    narrow, wide = RANGES_MT[version]
    kind = f"TMAG5273 {LETTERS.get(address, '?')}{version} ({narrow:g}/{wide:g} mT)"
    return Found(address, channel, kind, _health(bus, address))


def _health(bus: Bus, address: int) -> str:
    """What the status registers complain of."""
    status, device = REGISTERS["CONV_STATUS"], REGISTERS["DEVICE_STATUS"]
    told = bus.scan([Transfer(address, bytes([status.address]), 1), Transfer(address, bytes([device.address]), 1)])
    if not all(reply.acked for reply in told):
        return "stopped answering"
    troubles = ["its own diagnosis failed"] if status.read(told[0].data[0], "DIAG_STATUS") else []
    troubles += [name for name in ("OSC_ER", "OTP_CRC_ER", "VCC_UV_ER") if device.read(told[1].data[0], name)]
    if address not in FACTORY_ADDRESSES:
        troubles.append("not a factory address: re-addressed, which is lost with its power")
    return ", ".join(troubles)


def _clashes(found: list[Found]) -> list[Found]:
    """The same address straight on the bus and behind a channel cannot be told apart."""
    straight = {one.address for one in found if one.channel is None}
    return [
        Found(one.address, one.channel, "clash", "also answers straight on the bus: two hands, or a mux bridged over")
        for one in found
        if one.channel is not None and one.address in straight
    ]


def as_layout(found: list[Found]) -> str:
    """The sensors as a layout for a URL, such as 0:35,0:22,1:35: by channel, then A, B, C, D."""
    order = {address: k for k, address in enumerate(FACTORY_ADDRESSES)}
    sensors = [one for one in found if one.what.startswith("TMAG5273")]
    sensors.sort(key=lambda one: (-1 if one.channel is None else one.channel, order.get(one.address, 4), one.address))
    return ",".join(f"{'' if one.channel is None else f'{one.channel}:'}{one.address:02x}" for one in sensors)
