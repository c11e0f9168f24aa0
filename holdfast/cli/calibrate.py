"""`holdfast calibrate PATH --out FILE`: a map from field to force, from known loads.

PATH is a CSV file with the columns Time, X1..Zn (uT) and Fx, Fy, Fz (N), in which every fingertip
is pressed at least twice. The errors that it prints are on probings left out.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import date

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    positive,
    require_json_writable,
    show_found,
)
from holdfast.core.writing import require_writable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "path",
        type=path_argument,
        metavar="PATH",
        help="a CSV file Time,X1..Zn,Fx,Fy,Fz",
    )
    option(
        "--out",
        type=path_argument,
        required=True,
        metavar="FILE",
        help="calibration to write",
    )
    option(
        "--load-unit",
        choices=("N", "mN", "gf"),
        default="N",
        help="unit of the loads (default N)",
    )
    option(
        "--shear-gain",
        type=positive,
        metavar="X",
        help="shear over normal force, as read over true, where it is known (default: measured)",
    )
    add_json_option(parser)
    today = date.today().isoformat()
    option(
        "--date", default=today, metavar="DAY", help="day of the loads (default today)"
    )


def run(args: argparse.Namespace) -> int:
    """Fit, judge on probings left out, print, write."""
    from holdfast.drivers.calibration import write_calibration
    from holdfast.sessions.calibrate import as_json, calibrate, in_words, read_loads

    # Before the fit, whose result would otherwise be lost.
    require_writable(args.out.parent)
    require_json_writable(args)
    loads = read_loads(args.path, args.load_unit)
    fit = calibrate(loads, args.path.name, args.date)
    if args.shear_gain is not None:
        known = replace(fit.calibration, shear_gain=args.shear_gain)
        fit = replace(fit, calibration=known)
    write_calibration(args.out, fit.calibration)
    found = as_json(loads, fit)
    words = "\n".join([*in_words(found), f"  written: {args.out}"])
    show_found(args, words, found | {"written": args.out})
    return 0
