"""`holdfast scan [URL]`: the sensors on a bus, their faults, and the rate they can be read at.

One bus: which sensors and muxes are on it, and how fast they can be read.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, dataclass

from holdfast.cli.command import add_json_option, show_found
from holdfast.drivers.bus import Bus, Transfer
from holdfast.drivers.layout import enable_channels, masks_of, muxes_of, read_layout
from holdfast.drivers.scanning import BusDevice, as_layout, look_at
from holdfast.drivers.tmag5273 import PACKET_BYTES, RESULTS
from holdfast.live.hand_sources import named_addresses, open_bus
from holdfast.live.running import RunClock


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    urls = "usb://ft232h, i2c://1, virtual://ft232h (default: every bridge on USB)"
    reads = "it only reads until a sensor or a mux has identified itself"
    parser.add_argument("url", nargs="?", metavar="URL", help=f"{urls}; {reads}")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Look at one bus, or at every bridge that is plugged in."""
    from holdfast.core.errors import DeviceNotFound
    from holdfast.drivers.bridges import BRIDGES, bridges_on_usb

    urls = [args.url] if args.url else bridges_on_usb()
    if not urls:
        raise DeviceNotFound(
            "no bridge on USB",
            cause=f"none of {', '.join(BRIDGES)} is plugged in, or udev denies access",
            next_step="holdfast doctor; holdfast scan i2c://1 for the board's own bus",
        )
    found = [scan(url) for url in urls]
    words = "\n".join(line for one in found for line in in_words(one))
    show_found(args, words, {"buses": [asdict(one) for one in found]})
    return 0


TIMED_SCANS = 20
MODEL_RATES_HZ = (300.0, 150.0, 100.0, 50.0)
SPARE = 0.8
"""Largest share of a period that a scan may take: the rest is for the model and for delays."""


@dataclass(frozen=True)
class ScannedBus:
    """What is on one bus. layout: of its sensors, None without one.

    scan_s: median time of a scan of all sensors. model_hz: the fastest model that this serves, None
    where it serves none.
    """

    url: str
    devices: list[BusDevice]
    layout: str | None = None
    scan_s: float | None = None
    model_hz: float | None = None


def scan(url: str) -> ScannedBus:
    """Look at one bus, and time its sensors. Raises a DeviceError."""
    clock = RunClock()
    bus = open_bus(url, clock)
    try:
        devices = look_at(
            bus, lambda s: clock.spend(round(1e9 * s)), named_addresses(url)
        )
        layout = as_layout(devices)
        if not layout:
            return ScannedBus(url, devices)
        scan_s = median_scan_s(bus, layout)
    finally:
        bus.close()
    served = next((rate for rate in MODEL_RATES_HZ if scan_s * rate < SPARE), None)
    return ScannedBus(url, devices, layout, scan_s, served)


def in_words(of: ScannedBus) -> list[str]:
    """A line for each device (where, what it is, what is wrong), then the rate."""
    several = sum(one.kind == "mux" for one in of.devices) > 1
    lines = [of.url]
    for one in of.devices:
        behind = "" if one.channel is None else f"channel {one.channel}, "
        mux = f"mux {one.mux:#04x}, " if behind and several else ""
        place = f"{mux}{behind}{one.address:#04x}"
        lines.append(
            f"  {place:<{30 if several else 18}}{one.what:<28}{one.trouble}".rstrip()
        )
    if of.layout is None or of.scan_s is None:
        return [*lines, "  no sensor: power, SDA and SCL swapped, or pull-ups missing?"]
    count = len(of.layout.split(","))
    order = "put them in the order of the fingers"
    return [
        *lines,
        f"  {count} sensors: layout={of.layout} ({order})",
        f"  {_rate(of.scan_s, of)}",
    ]


def _rate(scan_s: float, of: ScannedBus) -> str:
    """The time of one scan, and the fastest model that it is enough for."""
    words = f"a scan takes {1e3 * scan_s:.2f} ms ({1.0 / scan_s:.0f} Hz)"
    if of.model_hz is None:
        return (
            f"{words}: serves no model, {MODEL_RATES_HZ[-1]:g} Hz needs another bridge"
        )
    return f"{words}: serves a model of {of.model_hz:g} Hz"


def median_scan_s(bus: Bus, layout: str) -> float:
    """The time of one scan of these sensors."""
    transfers, behind = [], frozenset[tuple[int, int]]()
    fingers = read_layout(layout)
    for finger in fingers:
        if finger.behind not in (frozenset(), behind):
            behind = finger.behind
            transfers += [
                enable_channels(mux, mask)
                for mux, mask in masks_of(behind, muxes_of(fingers)).items()
            ]
        transfers.append(Transfer(finger.address, bytes([RESULTS]), PACKET_BYTES))
    times = []
    for _ in range(TIMED_SCANS):
        started = time.perf_counter()
        bus.scan(transfers)
        times.append(time.perf_counter() - started)
    return sorted(times)[len(times) // 2]
