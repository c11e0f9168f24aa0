"""The options of a run that moves a hand or gives cues, and where they lead.

--grip udp://HOST:PORT | serial:///dev/ttyX?baud=115200 | virtual?lag_ms=50&ceiling_n=70
"""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import TYPE_CHECKING
from urllib.parse import parse_qs

from holdfast.edge_runtime.command import path_argument, positive
from holdfast.edge_runtime.errors import UsageError

if TYPE_CHECKING:
    from holdfast.simulation.closed_loop.actuator import Drive

VIRTUAL = "virtual"
DEFAULT_CONTROLLER = "holdfast"
LARGEST = 1e4
"""Of a figure of the virtual drive."""


def add_grip_options(parser: argparse.ArgumentParser) -> None:
    """--grip, --controller, --ceiling, --feedback, --cues."""
    option = parser.add_argument
    grip = "send a grip command at every sample: udp://HOST:PORT, serial:///dev/ttyX?baud=115200, "
    option(
        "--grip", metavar="URL", help=f"{grip}or virtual: to the hand in the scene of the source"
    )
    names = "none, pd-shear, sliding-mode, smsp, ismsp or holdfast (the default)"
    option("--controller", metavar="NAME", help=f"grip controller: {names}")
    ceiling = "largest grip of the hand, N of either side (default: 70)"
    option("--ceiling", type=positive, metavar="N", help=ceiling)
    cue = "send vibration cues for the wearer: udp://HOST:PORT or serial:///dev/ttyX?baud=115200"
    option("--feedback", metavar="URL", help=cue)
    cues = "patterns of the cues (TOML; default: the shipped card, docs/feedback.md)"
    option("--cues", type=path_argument, metavar="FILE", help=cues)


def require_grip(args: argparse.Namespace) -> None:
    """Raise UsageError where an option stands without the one that it belongs to."""
    if args.cues and not args.feedback:
        raise UsageError(
            "--cues needs --feedback, which sends the cues",
            next_step="--feedback udp://127.0.0.1:9002",
        )
    for option in ("controller", "ceiling"):
        if getattr(args, option) and not args.grip:
            raise UsageError(
                f"--{option} needs --grip, which runs the controller",
                next_step="--grip udp://127.0.0.1:9000",
            )


def is_virtual(url: str | None) -> bool:
    """Whether commands go to the hand in the scene of the source."""
    return url is not None and url.partition("?")[0] == VIRTUAL


def drive_of(url: str) -> Drive:
    """The drive of virtual?lag_ms=..&ceiling_n=... Raises UsageError."""
    from holdfast.simulation.closed_loop.actuator import Drive

    known = [one.name for one in fields(Drive)]
    figures = {}
    for key, values in parse_qs(url.partition("?")[2], keep_blank_values=True).items():
        if key not in known:
            raise UsageError(
                f"--grip virtual: {key[:40]!r} is not known",
                next_step=f"allowed: {', '.join(known)}",
            )
        figures[key] = _figure(key, values[-1], may_be_zero=key in ("lag_ms", "backlash_mm"))
    return Drive(**figures)


def _figure(key: str, text: str, *, may_be_zero: bool) -> float:
    try:
        figure = float(text)
    except ValueError:
        figure = -1.0
    if not 0.0 <= figure <= LARGEST or (not figure and not may_be_zero):
        bound = "from 0" if may_be_zero else "above 0"
        what = f"--grip virtual: {key}={text[:40]!r} is not a number {bound} to {LARGEST:g}"
        raise UsageError(what, next_step=f"{key}=50")
    return figure
