"""What is on a bus, what is wrong with it, and how fast it can be read: for `holdfast scan`.

The scan reads only. It writes nothing to an address before a sensor or a mux has identified
itself there (layout.py, the drivers of the chips), and nothing to the general call, which resets
some other chips. A register read sends the register's number, which a chip without registers would
take for data. So a chip that answers a plain read with equal bytes is identified only at the
sensor's own addresses and at those that a layout names.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Literal

from holdfast.core.errors import DeviceNotFound, WrongDevice
from holdfast.drivers.bus import Bus, freeing
from holdfast.drivers.chips import ChipDriver, Pause
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

NOT_IDENTIFIED = (
    "answers every read with one byte, so it may have no registers; "
    "not identified for its safety"
)
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
    bus: Bus, chip: ChipDriver, pause: Pause, named: frozenset[int] = frozenset()
) -> list[BusDevice]:
    """Everything on the bus and behind each mux channel; a bus that is held low is freed first.

    chip: the kind of sensor that is looked for. named: addresses at which the user says that a
    sensor is. Raises what the bridge raises.
    """
    return freeing(bus, lambda: _look_at(bus, chip, pause, named))


def _look_at(
    bus: Bus, chip: ChipDriver, pause: Pause, named: frozenset[int]
) -> list[BusDevice]:
    muxes = [one for one in answering(bus, MUX_ADDRESSES) if is_mux(bus, one)]
    found = [BusDevice(address, None, "mux", "mux (TCA9548A)") for address in muxes]
    found += _chips(bus, set(muxes), chip, pause, named)
    # a chip in front of the muxes answers behind every channel as well
    taken = {one.address for one in found}
    for mux in muxes:
        for channel in CHANNELS:
            bus.scan([enable_channels(mux, 1 << channel)])
            behind = _chips(bus, taken, chip, pause, named)
            found += [replace(one, channel=channel, mux=mux) for one in behind]
        # leave no channel enabled: the next mux may have the same addresses behind it
        bus.scan([enable_channels(mux, 0)])

    return found


def _chips(
    bus: Bus, taken: set[int], chip: ChipDriver, pause: Pause, named: frozenset[int]
) -> list[BusDevice]:
    """The chips that answer now, except at the addresses in `taken`."""
    # up to 0x7F: tools that stop at 0x77 never see a TMAG5273 at 0x78
    free = [address for address in ADDRESSES if address not in taken]
    found = []
    for address in answering(bus, free):
        if address in named or address in chip.addresses:
            found.append(_identified(bus, chip, address, pause))
        elif len(set(plain_read(bus, address))) <= 1:
            found.append(_unknown(address, NOT_IDENTIFIED))
        elif chip.found_anywhere:
            found.append(_identified(bus, chip, address, pause))
        else:
            found.append(_unknown(address, f"not asked: no address of a {chip.name}"))

    return found


def _unknown(address: int, trouble: str) -> BusDevice:
    return BusDevice(address, None, "unknown", "unknown", trouble)


def _identified(bus: Bus, chip: ChipDriver, address: int, pause: Pause) -> BusDevice:
    try:
        version = chip.identify(bus, address, pause)
    except (DeviceNotFound, WrongDevice) as error:
        return _unknown(address, error.what)
    trouble = chip.health(bus, address)
    return BusDevice(address, None, "sensor", chip.describe(address, version), trouble)


def as_layout(found: list[BusDevice], addresses: Sequence[int]) -> str:
    """The sensors as a layout for a URL, such as 0:35,0:22,71/1:35, ordered by mux and channel.

    addresses: of the chip; behind one channel their order is that of the fingers in `mux`.
    """
    order = (*addresses, *ADDRESSES)

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
    url: str, bus: Bus, chip: ChipDriver, pause: Pause, named: frozenset[int]
) -> ScannedBus:
    """Look at an open bus, and time its sensors. named: addresses that a layout names.

    Raises a DeviceError.
    """
    devices = look_at(bus, chip, pause, named)
    layout = as_layout(devices, chip.addresses)
    if not layout:
        return ScannedBus(url, devices)
    return ScannedBus(url, devices, layout, median_scan_s(bus, chip, layout))


def median_scan_s(bus: Bus, chip: ChipDriver, layout: str) -> float:
    """The time of one scan of these sensors."""
    fingers = read_layout(layout, chip.addresses)
    reads = [chip.read(one.address) for one in fingers]
    planner = ScanPlanner(fingers)
    times_s = []
    for _ in range(TIMED_SCANS):
        transfers = planner.plan(reads, doubtful=False).transfers
        started_s = time.perf_counter()
        bus.scan(transfers)
        times_s.append(time.perf_counter() - started_s)
    return median(times_s)
