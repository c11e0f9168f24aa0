"""`holdfast calibrate PATH --out FILE`: a map from field to force, from known loads.

PATH is a CSV file with the columns Time, X1..Zn (uT) and Fx, Fy, Fz (N), in which every fingertip
is pressed at least twice; or a folder in the layout of eflesh_calibration (normal_force/ and
shear_force/, with one folder a probing). The errors that it prints are on probings left out.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import date
from pathlib import Path

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    positive,
    require_json_writable,
    seed,
    show_found,
)
from holdfast.core.writing import require_writable

STAGES = 5
"""Reading, then a linear map and trees for the normal and for the shear probings."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    layout = "a CSV file Time,X1..Zn,Fx,Fy,Fz, or a folder like eflesh_calibration"
    option("path", type=path_argument, metavar="PATH", help=layout)
    option(
        "--out",
        type=path_argument,
        required=True,
        metavar="FILE",
        help="calibration to write",
    )
    gain = "shear over normal force, as read over true, where it is known (default: measured)"
    option("--shear-gain", type=positive, metavar="X", help=gain)
    add_json_option(parser)
    today = date.today().isoformat()
    option(
        "--date", default=today, metavar="DAY", help="day of the loads (default today)"
    )
    trees = "seed of the trees that it is compared with (default 0)"
    option("--seed", type=seed, default=0, metavar="S", help=trees)


def run(args: argparse.Namespace) -> int:
    """Fit, judge on probings left out, print, write."""
    from holdfast.drivers.calibration import write_calibration
    from holdfast.sessions.calibration import (
        as_json,
        calibrate,
        in_words,
        shear_gain_in_words,
    )
    from holdfast.sessions.known_loads import read_load_sets
    from holdfast.training.progress import stages

    # Before the fit, whose result would otherwise be lost.
    require_writable(args.out.parent)
    require_json_writable(args)
    figures = []
    lines = []
    with stages(STAGES) as begin:
        begin(f"reading {args.path}")
        for k, loads in enumerate(read_load_sets(args.path)):
            calibration, errors = calibrate(
                loads, args.path.name, args.date, args.seed, begin
            )
            if args.shear_gain is not None:
                calibration = replace(calibration, shear_gain=args.shear_gain)
            # A folder may hold normal and shear probings: each set gets a file of its own.
            target = _target(args.out, k, loads.name)
            write_calibration(target, calibration)
            gain = calibration.shear_gain
            figures.append(as_json(loads, errors, args.seed) | {"shear_gain": gain})
            lines += [*in_words(loads, errors), shear_gain_in_words(gain)]
            lines += [f"  written: {target}", ""]

    show_found(args, "\n".join(lines), {"studies": figures})
    return 0


def _target(out: Path, number: int, name: str) -> Path:
    """FILE for the first set of loads, FILE's stem with the set's name for the others."""
    return out if number == 0 else out.with_stem(f"{out.stem}.{name}")
