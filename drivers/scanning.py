"""What is on a bus: muxes, sensors, their variants, and what is wrong with them.

Found by reading. Nothing is written to an address before a chip of ours has identified itself there
(drivers/mux.py, drivers/bring_up.py), and nothing goes to the general call, which resets some
foreign chips. A register read sends the register's number; a chip without registers would take that
for data. So a chip whose plain read is the same byte again and again is asked for its identity only
at the sensor's own addresses and at those that a layout names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.bring_up import identify
from drivers.bus import Bus, Transfer, freeing
from drivers.layout import CHANNELS, LAYOUTS, MUX_ADDRESS, MUX_ADDRESSES
from drivers.mux import answering, is_mux, joined, plain_read
from drivers.tmag5273 import FACTORY_ADDRESSES, RANGES_MT, REGISTERS
from edge_runtime.errors import DeviceNotFound, WrongDevice

FIRST_ADDRESS, LAST_ADDRESS = 0x08, 0x7F
"""0x78 is a factory address of the sensor, which tools that stop at 0x77 never see."""
LETTERS = dict(zip(FACTORY_ADDRESSES, "ABCD", strict=True))
SENSOR_ADDRESSES = frozenset(FACTORY_ADDRESSES) | {
    one.read_at for layout in LAYOUTS.values() for one in layout
}
NOT_ASKED = (
    "answers one byte again and again, so it may have no registers, and was not asked who it is"
)


@dataclass(frozen=True)
class Found:
    """Something that acknowledged: where, what, and what is wrong with it ("" where nothing is)."""

    address: int
    channel: int | None
    what: str
    trouble: str = ""
    mux: int = MUX_ADDRESS

    @property
    def place(self) -> str:
        """As a layout has it: 35, 0:35 or 71/0:35."""
        channel = "" if self.channel is None else f"{self.channel}:"
        return f"{'' if self.mux == MUX_ADDRESS or not channel else f'{self.mux:02x}/'}{channel}{self.address:02x}"


def look_at(
    bus: Bus, pause: Callable[[float], None], named: frozenset[int] = frozenset()
) -> list[Found]:
    """Everything on the bus, and behind every channel of each mux on it; a bus that is held low is
    freed.

    named: addresses where the user says that a sensor is. Raises what the bridge raises.
    """
    return freeing(bus, lambda: _look_at(bus, pause, SENSOR_ADDRESSES | named))


def _look_at(bus: Bus, pause: Callable[[float], None], asked: frozenset[int]) -> list[Found]:
    muxes = [address for address in answering(bus, MUX_ADDRESSES) if is_mux(bus, address)]
    found = [Found(address, None, "mux (TCA9548A)") for address in muxes]
    found += _chips(bus, set(muxes), asked, pause)
    taken = {one.address for one in found}
    for mux in muxes:
        for channel in CHANNELS:
            bus.scan([joined(mux, 1 << channel)])
            behind = _chips(bus, taken, asked, pause)
            found += [Found(one.address, channel, one.what, one.trouble, mux) for one in behind]
        bus.scan([joined(mux, 0)])
    return found


def _chips(
    bus: Bus, taken: set[int], asked: frozenset[int], pause: Callable[[float], None]
) -> list[Found]:
    """What answers now, but for what is taken."""
    there = answering(bus, [a for a in range(FIRST_ADDRESS, LAST_ADDRESS + 1) if a not in taken])
    return [
        _identified(bus, address, pause)
        if address in asked or len(set(plain_read(bus, address))) > 1
        else Found(address, None, "unknown", NOT_ASKED)
        for address in there
    ]


def _identified(bus: Bus, address: int, pause: Callable[[float], None]) -> Found:
    try:
        version = identify(bus, address, pause)
    except (DeviceNotFound, WrongDevice) as error:
        return Found(address, None, "unknown", error.what)
    narrow, wide = RANGES_MT[version]
    kind = f"TMAG5273 {LETTERS.get(address, '?')}{version} ({narrow:g}/{wide:g} mT)"
    return Found(address, None, kind, _health(bus, address))


def _health(bus: Bus, address: int) -> str:
    """What the status registers complain of."""
    status, device = REGISTERS["CONV_STATUS"], REGISTERS["DEVICE_STATUS"]
    told = bus.scan(
        [
            Transfer(address, bytes([device.address]), 1),
            Transfer(address, bytes([status.address]), 1),
        ]
    )
    if not all(reply.acked for reply in told):
        return "stopped answering"
    troubles = ["its own diagnosis failed"] if status.read(told[1].data[0], "DIAG_STATUS") else []
    troubles += [
        name for name in ("OSC_ER", "OTP_CRC_ER", "VCC_UV_ER") if device.read(told[0].data[0], name)
    ]
    if address not in FACTORY_ADDRESSES:
        troubles.append("not a factory address: re-addressed, which is lost with its power")
    return ", ".join(troubles)


def as_layout(found: list[Found]) -> str:
    """The sensors as a layout for a URL, such as 0:35,0:22,71/1:35: by mux and channel, then A, B,
    C, D."""
    order = {address: k for k, address in enumerate(FACTORY_ADDRESSES)}
    sensors = [one for one in found if one.what.startswith("TMAG5273")]

    def rank(one: Found) -> tuple[int, ...]:
        channel = (-1, -1) if one.channel is None else (one.mux, one.channel)
        return (*channel, order.get(one.address, 4), one.address)

    return ",".join(one.place for one in sorted(sensors, key=rank))
