"""`holdfast scan [URL]`: bridges, sensors, variants, addresses, what is wrong, and the rate that
can be served."""

from __future__ import annotations

import argparse
import time

from drivers.bridges import BRIDGES, bridges_on_usb
from drivers.bus import Bus, Transfer
from drivers.layout import masks_of, muxes_of, read_layout
from drivers.mux import joined
from drivers.scanning import as_layout, look_at
from drivers.tmag5273 import PACKET_BYTES, RESULTS
from edge_runtime.command import show
from edge_runtime.errors import DeviceNotFound
from holdfast.live_sources import named_addresses, open_bus
from holdfast.real_time import RunClock

TIMED_SCANS = 20
MODEL_RATES_HZ = (300.0, 150.0, 100.0, 50.0)
SPARE = 0.8
"""A scan may take so much of a period: the rest is for the model and for bad moments."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "url",
        nargs="?",
        metavar="URL",
        help="usb://ft232h, i2c://1, virtual://ft232h (default: every bridge on USB); it only reads, until a sensor or "
        "a mux has identified itself",
    )


def run(args: argparse.Namespace) -> int:
    """Look at one bus, or at every bridge that is plugged in."""
    urls = [args.url] if args.url else bridges_on_usb()
    if not urls:
        raise DeviceNotFound(
            "no bridge on USB",
            cause=f"none of {', '.join(BRIDGES)} is plugged in, or udev hides it",
            next_step="holdfast doctor; holdfast scan i2c://1 for the board's own bus",
        )
    for url in urls:
        scan(url)
    return 0


def scan(url: str) -> None:
    """Print what is on one bus. Raises a DeviceError."""
    clock = RunClock()
    bus = open_bus(url, clock)
    try:
        show(url)
        found = look_at(
            bus, lambda seconds: clock.spend(round(1e9 * seconds)), named_addresses(url)
        )
        several = sum(one.what.startswith("mux") for one in found) > 1
        for one in found:
            behind = "" if one.channel is None else f"channel {one.channel}, "
            place = (
                f"{f'mux {one.mux:#04x}, ' if behind and several else ''}{behind}{one.address:#04x}"
            )
            show(f"  {place:<{30 if several else 18}}{one.what:<28}{one.trouble}".rstrip())
        if layout := as_layout(found):
            print(
                f"  {len(layout.split(','))} sensors: layout={layout} (put them in the order of the fingers)"
            )
            print(f"  {rate_line(bus, layout)}")
        else:
            print("  no sensor: power, SDA and SCL swapped, or pull-ups missing?")
    finally:
        bus.close()


def rate_line(bus: Bus, layout: str) -> str:
    """How long a scan of these sensors takes here, and which models that serves."""
    transfers, behind = [], frozenset[tuple[int, int]]()
    fingers = read_layout(layout)
    for finger in fingers:
        if finger.behind not in (frozenset(), behind):
            behind = finger.behind
            transfers += [
                joined(mux, mask) for mux, mask in masks_of(behind, muxes_of(fingers)).items()
            ]
        transfers.append(Transfer(finger.address, bytes([RESULTS]), PACKET_BYTES))
    times = []
    for _ in range(TIMED_SCANS):
        started = time.perf_counter()
        bus.scan(transfers)
        times.append(time.perf_counter() - started)
    scan_s = sorted(times)[len(times) // 2]
    served = next((rate for rate in MODEL_RATES_HZ if scan_s * rate < SPARE), None)
    model = (
        f"a model of {served:g} Hz"
        if served
        else f"no model: {MODEL_RATES_HZ[-1]:g} Hz would need another bridge"
    )
    return f"a scan takes {1e3 * scan_s:.2f} ms ({1.0 / scan_s:.0f} Hz): serves {model}"
