"""`holdfast study PROTOCOL --source URL --out DIR --person p01`: runs a study with one person.

    holdfast study thesis --list
    holdfast study thesis --source usb://ft232h --calibration hand.json --out study --person p01
    holdfast study thesis --source sim://p1 --out try --person p01

The same command goes on after a pause, a quit or a crash.
docs/recording-and-study.md has the keys and the files.
"""

from __future__ import annotations

import argparse
import sys

from holdfast.cli.command import path_argument, show
from holdfast.cli.options import add_calibration_option, add_recording_options
from holdfast.core.errors import UsageError
from holdfast.sessions.study.protocol import shipped_protocols


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    shipped = ", ".join(shipped_protocols())
    option(
        "protocol",
        metavar="PROTOCOL",
        help=f"study protocol: a TOML file, or one of {shipped}",
    )
    option(
        "--list",
        action="store_true",
        help="print the steps with their minutes, and stop",
    )
    option(
        "--source",
        metavar="URL",
        help="a hand as in holdfast record, or a virtual participant such as sim://p1",
    )
    add_calibration_option(parser)
    option(
        "--out",
        type=path_argument,
        metavar="DIR",
        help="folder of all people of the study",
    )
    option(
        "--person",
        metavar="PSEUDONYM",
        help="letters, digits, dashes; never a real name",
    )
    add_recording_options(parser)
    option(
        "--report",
        action="store_true",
        help="write the report of this person, and stop",
    )
    option(
        "--withdraw",
        action="store_true",
        help="delete everything of this person, after a confirmation, and stop",
    )


def run(args: argparse.Namespace) -> int:
    """List the protocol, run the study, write its report, or delete a person."""
    from holdfast.sessions.recorder.plan import RecordOptions
    from holdfast.sessions.study.protocol import read_study
    from holdfast.sessions.study.run import (
        Ending,
        run_study,
        withdraw_person,
        write_participant_report,
    )

    protocol = read_study(args.protocol)
    # The listing needs no hand, no person and no folder.
    if args.list:
        show("\n".join(protocol.listing()))
        return 0

    require_options(args)
    if args.withdraw:
        done = withdraw_person(args.out, args.person, sys.stdin)
        return 0 if done else 1

    if not args.report:
        ending, exit_code = run_study(RecordOptions.of(args), protocol, sys.stdin)
        # A study that goes on later has no report yet.
        if ending != Ending.FINISHED:
            return exit_code

    lines = write_participant_report(args.out, args.person, protocol)
    show("\n".join(lines))
    return 0


def require_options(args: argparse.Namespace) -> None:
    """Raise UsageError for an option that is missing, or that goes with no other."""
    needed = {"--out": args.out, "--person": args.person}
    # Reports and withdrawals work on files alone, without a hand.
    if not args.report and not args.withdraw:
        needed["--source"] = args.source
    for option, value in needed.items():
        if value is None:
            step = "holdfast study --help shows all"
            raise UsageError(f"{option} is missing", next_step=step)
