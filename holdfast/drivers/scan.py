"""What is on a bus, what is wrong with it, and how fast it can be read: for `holdfast scan`.

The scan reads only. It writes nothing to an address before a TMAG5273 or a mux has identified
itself there (layout.py, finger.py), and nothing to the general call, which resets
some other chips. A register read sends the register's number, which a chip without registers would
take for data. So a chip that answers a plain read with equal bytes is identified only at the
sensor's own addresses and at those that a layout names.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import median
from typing import Literal

from holdfast.core.errors import DeviceNotFound, WrongDevice
from holdfast.drivers.bus import Bus, Transfer, freeing
from holdfast.drivers.finger import identify
from holdfast.drivers.layout import (
    ADDRESSES,
    CHANNELS,
    MUX_ADDRESS,
    MUX_ADDRESSES,
    ScanPlanner,
    answering,
    enable_channels,
    is_mux,
    plain_read,
    read_layout,
)
from holdfast.drivers.tmag5273 import (
    FACTORY_ADDRESSES,
    PACKET_BYTES,
    RANGES_MT,
    REGISTERS,
    RESULTS,
)

LETTERS = dict(zip(FACTORY_ADDRESSES, "ABCD", strict=True))
SENSOR_ADDRESSES = frozenset(FACTORY_ADDRESSES)
NOT_IDENTIFIED = (
    "answers every read with one byte, so it may have no registers; "
    "not identified for its safety"
)
STATUS_BITS = (
    ("CONV_STATUS", "DIAG_STATUS"),
    ("DEVICE_STATUS", "OSC_ER"),
    ("DEVICE_STATUS", "OTP_CRC_ER"),
    ("DEVICE_STATUS", "VCC_UV_ER"),
)
"""Register and bit of what a chip reports as wrong."""
TIMED_SCANS = 20


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
    letter = LETTERS.get(address, "?")
    what = f"TMAG5273 {letter}{version} ({narrow:g}/{wide:g} mT)"
    trouble = _health(bus, address)
    return BusDevice(address, None, "sensor", what, trouble)


def _health(bus: Bus, address: int) -> str:
    """What the status registers report as wrong."""
    troubles = []
    for register, name in STATUS_BITS:
        one = REGISTERS[register]
        (reply,) = bus.scan([Transfer(address, bytes([one.address]), 1)])
        if not reply.acked:
            return "stopped answering"
        if one.read(reply.data[0], name):
            troubles.append(name)

    return ", ".join(troubles)


def as_layout(found: list[BusDevice]) -> str:
    """The sensors as a layout for a URL, such as 0:35,0:22,71/1:35, ordered by mux and channel.

    Behind one channel the order of the factory addresses is that of the fingers in `mux`.
    """
    order = (*FACTORY_ADDRESSES, *ADDRESSES)

    def rank(one: BusDevice) -> tuple[int, int, int]:
        # what is directly on the bus comes first
        at = order.index(one.address)
        return (0, 0, at) if one.channel is None else (one.mux, one.channel, at)

    sensors = [one for one in found if one.kind == "sensor"]
    return ",".join(one.place for one in sorted(sensors, key=rank))


# -- a bus and its rate


@dataclass(frozen=True)
class ScannedBus:
    """What is on one bus. layout: of its sensors, "" without one.

    scan_s: median time of a scan of all sensors.
    """

    url: str
    devices: list[BusDevice]
    layout: str = ""
    scan_s: float | None = None

    def lines(self) -> list[str]:
        """A line for each device (where, what it is, what is wrong), then the rate."""
        lines = [self.url]
        for device in self.devices:
            found = f"  {device.place:<8}{device.what:<28}{device.trouble}"
            lines.append(found.rstrip())
        if self.scan_s is None:
            cause = "power, SDA and SCL swapped, or pull-ups missing?"
            return [*lines, f"  no sensor: {cause}"]
        rate = f"a scan takes {1e3 * self.scan_s:.2f} ms ({1.0 / self.scan_s:.0f} Hz)"
        return [
            *lines,
            f"  layout={self.layout} (put them in the order of the fingers)",
            f"  {rate}",
        ]


def survey(
    url: str, bus: Bus, named: frozenset[int], sleep: Callable[[float], None]
) -> ScannedBus:
    """Look at an open bus, and time its sensors. named: addresses that a layout names.

    Raises a DeviceError.
    """
    devices = look_at(bus, sleep, named)
    layout = as_layout(devices)
    if not layout:
        return ScannedBus(url, devices)
    return ScannedBus(url, devices, layout, median_scan_s(bus, layout))


def median_scan_s(bus: Bus, layout: str) -> float:
    """The time of one scan of these sensors."""
    fingers = read_layout(layout)
    reads = [Transfer(one.address, bytes([RESULTS]), PACKET_BYTES) for one in fingers]
    planner = ScanPlanner(fingers)
    times_s = []
    for _ in range(TIMED_SCANS):
        transfers = planner.plan(reads, doubtful=False).transfers
        started_s = time.perf_counter()
        bus.scan(transfers)
        times_s.append(time.perf_counter() - started_s)
    return median(times_s)
