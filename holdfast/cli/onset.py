"""`holdfast onset TRIAL`: finds the onset of slip that a camera saw; writes an interval label.

    holdfast onset trials/7 --action pull                a folder of holdfast watch: events.jsonl
    holdfast onset trials/p01/my-cup/pull/trial_1        of holdfast record: its phases too

The action decides what a slip means: pull, fall and hold make it risky, pass and put-down safe.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

from holdfast.cli.command import add_json_option, path_argument, positive, show_found
from holdfast.cli.options import add_apart_option, printed_mm
from holdfast.core.errors import UsageError
from holdfast.sessions.onset import ACTIONS, WatchedTrial, read_motion, write_label


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    ever = float("inf")
    trial = "a watched folder"
    option("trial", type=path_argument, metavar="TRIAL", help=trial)
    option(
        "--action",
        choices=ACTIONS,
        help="action of the trial (default: the name of its folder)",
    )
    held = (
        "trials that were loaded and held: gross slip begins above their elastic shear"
    )
    option(
        "--no-slip",
        type=path_argument,
        nargs="+",
        default=[],
        metavar="TRIAL",
        help=held,
    )
    option(
        "--gross-mm",
        type=positive,
        metavar="MM",
        help="distance of gross slip (default 2)",
    )
    side = "side of the printed tags (default: as recorded)"
    option("--tag-mm", type=printed_mm, metavar="MM", help=side)
    add_apart_option(parser)
    option(
        "--from",
        type=float,
        default=-ever,
        dest="from_s",
        metavar="S",
        help="search from S seconds on",
    )
    option(
        "--until",
        type=float,
        default=ever,
        dest="until_s",
        metavar="S",
        help="search until S seconds",
    )
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Find the onset, write it next to the trial, print it."""
    from holdfast.drivers.camera.onset import GROSS_MM, gross_distance_mm

    # Pads shear elastically under load, which a camera cannot tell from a slip by itself.
    held = [read_motion(path, args.tag_mm) for path in args.no_slip]
    gross_mm = args.gross_mm or (
        gross_distance_mm([trial.moved for trial in held]) if held else GROSS_MM
    )
    trial = read_motion(args.trial, args.tag_mm, args.apart_mm)
    trial = replace(
        trial,
        moved=trial.moved.between(
            args.from_s + trial.starts_s, args.until_s + trial.starts_s
        ),
    )
    # Within the elastic shear every held object would seem to slip.
    require_above_shear(held, gross_mm)
    label = write_label(trial, args.action, gross_mm, shear_known=bool(held))
    show_found(args, label.words, label.to_json())
    return 0


def require_above_shear(held: list[WatchedTrial], gross_mm: float) -> None:
    """Raise UsageError where the distance is within the elastic shear of the pads."""
    from holdfast.drivers.camera.onset import largest_move_mm

    shear_mm = max((largest_move_mm(trial.moved) for trial in held), default=0.0)
    if gross_mm <= shear_mm:
        raise UsageError(
            f"--gross-mm {gross_mm:g} is within the elastic shear",
            cause=f"the held trials move by {shear_mm:.2f} mm",
            next_step="omit --gross-mm, or give more",
        )
