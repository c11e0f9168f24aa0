"""`holdfast scan [URL]`: the sensors on a bus, their faults, and the rate they can be read at."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from holdfast.edge_runtime.json_option import add_json_option, show_found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    urls = "usb://ft232h, i2c://1, virtual://ft232h (default: every bridge on USB)"
    reads = "it only reads until a sensor or a mux has identified itself"
    parser.add_argument("url", nargs="?", metavar="URL", help=f"{urls}; {reads}")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Look at one bus, or at every bridge that is plugged in."""
    from holdfast.bus_scan import in_words, scan
    from holdfast.drivers.bridges import BRIDGES, bridges_on_usb
    from holdfast.edge_runtime.errors import DeviceNotFound

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
