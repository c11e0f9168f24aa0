"""`holdfast board udev|service`: prints what the board needs installed; pipe it into place."""

from __future__ import annotations

import argparse
import sys
from importlib.resources import files

PARTS = {"udev": "70-holdfast.rules", "service": "holdfast.service"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "part", choices=PARTS, help="udev rules for the bridges, or a systemd unit"
    )


def run(args: argparse.Namespace) -> int:
    """Print one file."""
    sys.stdout.write(
        files("holdfast.drivers.board")
        .joinpath(PARTS[args.part])
        .read_text(encoding="utf-8")
    )
    return 0
