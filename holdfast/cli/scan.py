"""`holdfast scan [URL]`: the sensors on a bus, their faults, and the rate they can be read at."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import TYPE_CHECKING

from holdfast.cli.command import add_json_option, show_found

if TYPE_CHECKING:
    from holdfast.drivers.scan import ScannedBus


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    urls = "usb://ft232h, i2c://1, virtual://ft232h (default: every bridge on USB)"
    reads = "it only reads until a sensor or a mux has identified itself"
    parser.add_argument("url", nargs="?", metavar="URL", help=f"{urls}; {reads}")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Look at one bus, or at every bridge that is plugged in."""
    from holdfast.core.errors import DeviceNotFound
    from holdfast.drivers.bridges import bridges_on_usb

    urls = [args.url] if args.url else bridges_on_usb()
    if not urls:
        raise DeviceNotFound(
            "no bridge on USB",
            cause="no ft232h is plugged in, or udev denies access",
            next_step="holdfast doctor; holdfast scan i2c://1 for the board's own bus",
        )

    buses = list(map(_surveyed, urls))
    lines: list[str] = []
    for bus in buses:
        lines += bus.lines()
    show_found(args, "\n".join(lines), {"buses": list(map(asdict, buses))})
    return 0


def _surveyed(url: str) -> ScannedBus:
    from holdfast.drivers.layout import read_layout
    from holdfast.drivers.scan import survey
    from holdfast.live.running import RunClock
    from holdfast.live.sources import open_bus, source_url

    clock = RunClock()
    # The sensors are not started: a scan shall leave everything as it is.
    bus = open_bus(url, clock)
    try:
        # The addresses of the fingers in the URL's layout.
        layout = read_layout(source_url(url).options.layout)
        named = frozenset(finger.address for finger in layout)
        return survey(url, bus, named, lambda s: clock.spend(round(1e9 * s)))
    finally:
        bus.close()
