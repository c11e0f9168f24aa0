"""`holdfast record --source URL --out DIR --person P01`: records trials, safe against crashes.

    holdfast record --source usb://ft232h --calibration c.json --out trials --person p01 \\
        --protocol protocol.toml
    holdfast record --source usb://ft232h --out trials --person p01 \\
        --object cup --action pull --camera oak --tag-mm 10
    holdfast record --source "virtual://ft232h?scene=pull-soft-ball" --out trials --person p00 \\
        --object soft-ball --action pull --trials 1 --at-once --seconds 8

A second run continues with the next trial. docs/recording-and-study.md has the keys and the files.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING

from holdfast.cli.command import add_json_option, path_argument, seed, show_found
from holdfast.cli.options import (
    add_calibration_option,
    add_recording_options,
    add_source_option,
)
from holdfast.core.errors import command, count_of
from holdfast.core.trial_layout import SITUATION_OF_ACTION

if TYPE_CHECKING:
    from holdfast.sessions.recorder.plan import RecordOptions


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    add_source_option(parser)
    add_calibration_option(parser)
    option(
        "--out",
        type=path_argument,
        required=True,
        metavar="DIR",
        help="folder of recordings, new or of an earlier run",
    )
    option(
        "--person",
        required=True,
        metavar="PSEUDONYM",
        help="letters, digits, dashes; never a real name",
    )
    option(
        "--protocol",
        type=path_argument,
        metavar="PROTOCOL",
        help="recording protocol (TOML): which trials, in which number",
    )
    option(
        "--object",
        metavar="NAME",
        help="without a protocol: the object, such as soft-ball",
    )
    option(
        "--action",
        choices=tuple(SITUATION_OF_ACTION),
        help="without a protocol: the action",
    )
    option(
        "--seed",
        type=seed,
        default=0,
        metavar="S",
        help="seed of the order of the protocol's trials (default 0)",
    )
    option("--trials", type=int, metavar="N", help="stop after N trials")
    option(
        "--at-once",
        action="store_true",
        help="begin every trial without waiting for a key",
    )
    add_recording_options(parser)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Record until the plan is done, the operator stops it, or an error ends it."""
    from holdfast.live.running import stop_signals
    from holdfast.live.sources import is_standard_input
    from holdfast.sessions.recorder.recording import record
    from holdfast.sessions.recorder.terminal import Keys, context_of, listening

    with ExitStack() as stack:
        stopped = stack.enter_context(stop_signals())
        keys = Keys(None)
        # Samples are no keys.
        if not any(map(is_standard_input, (args.source, args.wearer or ""))):
            keys = stack.enter_context(listening(sys.stdin.fileno()))
        kept = record(options_of(args), context_of(keys, stopped, args.seconds))

    next_step = f"next: {command('evaluate', 'MODEL', '--data', args.out)}"
    words = f"{count_of(kept, 'trial')} kept in {args.out / args.person}; {next_step}"
    show_found(args, words, {"out": args.out, "person": args.person, "kept": kept})
    return stopped.exit_code


def options_of(args: argparse.Namespace) -> RecordOptions:
    """What the recorder gets of the words on the command line."""
    from holdfast.sessions.recorder.plan import RecordOptions

    return RecordOptions.of(args)
