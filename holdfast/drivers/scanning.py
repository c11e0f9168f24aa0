"""What is on a bus: muxes, sensors, their variants, and what is wrong with them.

The scan reads only. It writes nothing to an address before a TMAG5273 or a mux has identified
itself there (layout.py, finger.py), and nothing to the general call, which resets
some other chips. A register read sends the register's number, which a chip without registers would
take for data. So a chip that answers a plain read with equal bytes is identified only at the
sensor's own addresses and at those that a layout names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from holdfast.core.errors import DeviceNotFound, WrongDevice
from holdfast.drivers.bus import Bus, Transfer, freeing
from holdfast.drivers.finger import identify
from holdfast.drivers.layout import (
    ADDRESSES,
    CHANNELS,
    LAYOUTS,
    MUX_ADDRESS,
    MUX_ADDRESSES,
    answering,
    enable_channels,
    is_mux,
    plain_read,
)
from holdfast.drivers.tmag5273 import FACTORY_ADDRESSES, RANGES_MT, REGISTERS

LETTERS = dict(zip(FACTORY_ADDRESSES, "ABCD", strict=True))
SENSOR_ADDRESSES = frozenset(FACTORY_ADDRESSES).union(
    *({one.read_at for one in layout} for layout in LAYOUTS.values())
)
NOT_IDENTIFIED = (
    "answers every read with one byte, so it may have no registers; "
    "not identified for its safety"
)


@dataclass(frozen=True)
class BusDevice:
    """A chip that acknowledged. what: its name for people. trouble: "" where nothing is wrong.

    channel: of its mux, None without one.
    """

    address: int
    channel: int | None
    kind: Literal["sensor", "mux", "unknown"]
    what: str
    trouble: str = ""
    mux: int = MUX_ADDRESS

    @property
    def place(self) -> str:
        """As a layout has it: 35, 0:35 or 71/0:35."""
        if self.channel is None:
            return f"{self.address:02x}"
        mux = "" if self.mux == MUX_ADDRESS else f"{self.mux:02x}/"
        return f"{mux}{self.channel}:{self.address:02x}"


def look_at(
    bus: Bus, pause: Callable[[float], None], named: frozenset[int] = frozenset()
) -> list[BusDevice]:
    """Everything on the bus and behind each mux channel; a bus that is held low is freed first.

    named: addresses at which the user says that a sensor is. Raises what the bridge raises.
    """
    return freeing(bus, lambda: _look_at(bus, pause, SENSOR_ADDRESSES | named))


def _look_at(
    bus: Bus, pause: Callable[[float], None], expected: frozenset[int]
) -> list[BusDevice]:
    muxes = [one for one in answering(bus, MUX_ADDRESSES) if is_mux(bus, one)]
    found = [BusDevice(address, None, "mux", "mux (TCA9548A)") for address in muxes]
    found += _chips(bus, set(muxes), expected, pause)
    # a chip in front of the muxes answers behind every channel as well
    taken = {one.address for one in found}
    for mux in muxes:
        for channel in CHANNELS:
            bus.scan([enable_channels(mux, 1 << channel)])
            behind = _chips(bus, taken, expected, pause)
            found += [replace(one, channel=channel, mux=mux) for one in behind]
        # leave no channel enabled: the next mux may have the same addresses behind it
        bus.scan([enable_channels(mux, 0)])

    return found


def _chips(
    bus: Bus, taken: set[int], expected: frozenset[int], pause: Callable[[float], None]
) -> list[BusDevice]:
    """The chips that answer now, except at the addresses in `taken`."""
    # 0x78 is a factory address of the sensor; tools that stop at 0x77 never see it
    free = [address for address in ADDRESSES if address not in taken]
    found = []
    for address in answering(bus, free):
        if address in expected or len(set(plain_read(bus, address))) > 1:
            found.append(_identified(bus, address, pause))
        else:
            found.append(_unknown(address, NOT_IDENTIFIED))

    return found


def _unknown(address: int, trouble: str) -> BusDevice:
    return BusDevice(address, None, "unknown", "unknown", trouble)


def _identified(bus: Bus, address: int, pause: Callable[[float], None]) -> BusDevice:
    try:
        version = identify(bus, address, pause)
    except (DeviceNotFound, WrongDevice) as error:
        return _unknown(address, error.what)
    narrow, wide = RANGES_MT[version]
    # the letter stands for the factory address, which a moved chip does not show
    letter = LETTERS.get(address, "?")
    what = f"TMAG5273 {letter}{version} ({narrow:g}/{wide:g} mT)"
    trouble = _health(bus, address)
    return BusDevice(address, None, "sensor", what, trouble)


def _health(bus: Bus, address: int) -> str:
    """What the status registers report as wrong."""
    status = REGISTERS["CONV_STATUS"]
    device = REGISTERS["DEVICE_STATUS"]
    reads = [Transfer(address, bytes([one.address]), 1) for one in (device, status)]
    device_reply, status_reply = bus.scan(reads)
    if not (device_reply.acked and status_reply.acked):
        return "stopped answering"
    troubles = []
    if status.read(status_reply.data[0], "DIAG_STATUS"):
        troubles.append("its own diagnosis failed")
    for name in ("OSC_ER", "OTP_CRC_ER", "VCC_UV_ER"):
        if device.read(device_reply.data[0], name):
            troubles.append(name)

    if address not in FACTORY_ADDRESSES:
        troubles.append(
            "not a factory address: it was given at run time and is lost with its power"
        )
    return ", ".join(troubles)


def as_layout(found: list[BusDevice]) -> str:
    """The sensors as a layout for a URL, such as 0:35,0:22,71/1:35, ordered by mux and channel."""
    sensors = [one for one in found if one.kind == "sensor"]

    # the order of the factory addresses is that of the fingers in `mux`
    def rank(one: BusDevice) -> tuple[tuple[int, ...], int, int]:
        # what is directly on the bus comes first
        behind = () if one.channel is None else (one.mux, one.channel)
        order = len(FACTORY_ADDRESSES)
        if one.address in FACTORY_ADDRESSES:
            order = FACTORY_ADDRESSES.index(one.address)
        return behind, order, one.address

    return ",".join(one.place for one in sorted(sensors, key=rank))
