"""`holdfast record --source URL --out DIR --person P01`: records trials, safe against crashes.

    holdfast record --source usb://ft232h --calibration c.json --out trials --person p01 \\
        --protocol card.toml
    holdfast record --source usb://ft232h --out trials --person p01 \\
        --object cup --action pull --camera oak --tag-mm 10
    holdfast record --source "virtual://ft232h?scene=pull-soft-ball" --out trials --person p00 \\
        --object soft-ball --action pull --trials 1 --at-once --seconds 8

A second run continues with the next trial. docs/recording.md has the keys and the files.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack

from holdfast.cli.command import add_json_option, path_argument, seed
from holdfast.cli.options import (
    add_calibration_option,
    add_recording_options,
    add_source_option,
    add_web_option,
)
from holdfast.sessions.recorder.protocol import ACTIONS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    add_source_option(parser)
    add_calibration_option(parser)
    out = "folder of recordings, new or of an earlier run"
    option("--out", type=path_argument, required=True, metavar="DIR", help=out)
    person = "letters, digits, dashes; never a real name"
    option("--person", required=True, metavar="PSEUDONYM", help=person)
    card = "protocol card (TOML): which trials, in which number"
    option("--protocol", type=path_argument, metavar="CARD", help=card)
    thing = "without a card: the object, such as soft-ball"
    option("--object", metavar="NAME", help=thing)
    option("--action", choices=ACTIONS, help="without a card: the action")
    order = "seed of the order of the card's trials (default 0)"
    option("--seed", type=seed, default=0, metavar="S", help=order)
    option("--trials", type=int, metavar="N", help="stop after N trials")
    at_once = "begin every trial without waiting for a key"
    option("--at-once", action="store_true", help=at_once)
    add_recording_options(parser, "oak|scene|FILE")
    add_web_option(parser)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Record until the plan is done, the operator stops it, or an error ends it."""
    from holdfast.live.log_sink import stream_sink
    from holdfast.live.real_time import RunClock
    from holdfast.live.stopping import stop_signals
    from holdfast.sessions.record_page import record_page
    from holdfast.sessions.recorder.keys import listening
    from holdfast.sessions.recorder.recording import record
    from holdfast.sessions.recorder.session import show_nothing
    from holdfast.sessions.recorder.status import StatusLine, columns_of

    status = StatusLine(
        stream_sink(sys.stderr), lambda: columns_of(sys.stderr), args.seconds
    )
    show = status.show if columns_of(sys.stderr) else show_nothing
    with ExitStack() as stack:
        stopped = stack.enter_context(stop_signals())
        keys = stack.enter_context(listening(sys.stdin.fileno()))
        if not args.web:
            return record(args, RunClock(), keys, status.say, stopped, show)
        page = stack.enter_context(record_page(args, keys, status.say, show))
        return record(
            args, RunClock(), keys, page.say, stopped, page.show, announce=page.announce
        )
