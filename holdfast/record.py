"""`holdfast record --source URL --out DIR --person P01`: trials on disk that survive whatever
happens.

    holdfast record --source usb://ft232h --calibration c.json --out trials --person p01 --protocol
    card.toml holdfast record --source usb://ft232h --out trials --person p01 --object cup --action
    pull --camera oak --tag-mm 10 holdfast record --source "virtual://ft232h?scene=pull-soft-ball"
    --out trials --person p00 --object soft-ball \
        --action pull --trials 1 --at-once --seconds 8

Run again it goes on with the next trial. docs/recording.md has the keys and what is written where.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack

from edge_runtime.command import path_argument, positive, seed
from holdfast.camera_options import add_camera_options
from holdfast.live_options import add_live_options
from holdfast.recorder.card import ACTIONS

RATE_HZ = 150.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    add_live_options(parser)
    parser.add_argument(
        "--out",
        type=path_argument,
        required=True,
        metavar="DIR",
        help="new, or recorded into before",
    )
    parser.add_argument(
        "--person", required=True, metavar="PSEUDONYM", help="letters, digits, dashes; never a name"
    )
    parser.add_argument(
        "--protocol", type=path_argument, metavar="CARD", help="what comes next: a card (TOML)"
    )
    parser.add_argument(
        "--object", metavar="NAME", help="without a card: the object, such as soft-ball"
    )
    parser.add_argument("--action", choices=ACTIONS, help="without a card: what is done with it")
    parser.add_argument(
        "--seed", type=seed, default=0, metavar="S", help="of the card's order (default 0)"
    )
    parser.add_argument(
        "--rate",
        type=positive,
        default=RATE_HZ,
        metavar="HZ",
        help=f"of a hand (default {RATE_HZ:g})",
    )
    parser.add_argument(
        "--anyway", action="store_true", help="record although the bias is not good"
    )
    parser.add_argument("--seconds", type=positive, metavar="S", help="keep a trial after so long")
    parser.add_argument("--trials", type=int, metavar="N", help="so many and no more")
    parser.add_argument(
        "--at-once", action="store_true", help="begin every trial without waiting for a key"
    )
    parser.add_argument(
        "--camera", metavar="oak|scene|FILE", help="film every trial (docs/camera.md)"
    )
    add_camera_options(parser)


def run(args: argparse.Namespace) -> int:
    """Record until the plan is done, somebody stops it, or something breaks; then say what there
    is."""
    from edge_runtime.sinks import stream_sink
    from holdfast.real_time import RunClock
    from holdfast.recorder.keys import listening
    from holdfast.recorder.recording import record
    from holdfast.recorder.session import show_nothing
    from holdfast.recorder.status import StatusLine, columns_of
    from holdfast.stopping import stop_signals

    status = StatusLine(stream_sink(sys.stderr), lambda: columns_of(sys.stderr), args.seconds)
    show = status.show if columns_of(sys.stderr) else show_nothing
    with ExitStack() as stack:
        stopped = stack.enter_context(stop_signals())
        keys = stack.enter_context(listening(sys.stdin.fileno()))
        return record(args, RunClock(), keys, status.say, stopped, show)
