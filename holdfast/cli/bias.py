"""`holdfast bias --source URL --out FILE`: measures the bias of the open, untouched hand.

It takes two seconds. A bias that is not good is not written, unless --anyway.
"""

from __future__ import annotations

import argparse

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    positive,
    require_json_writable,
    show_found,
)
from holdfast.cli.options import add_calibration_option, add_source_option, set_reader
from holdfast.core.errors import command, count_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    add_source_option(parser)
    add_calibration_option(parser)
    option = parser.add_argument
    option(
        "--out",
        type=path_argument,
        required=True,
        metavar="FILE",
        help="bias to write (JSON)",
    )
    option(
        "--seconds",
        type=positive,
        default=2.0,
        metavar="S",
        help="duration of the measurement (default 2)",
    )
    option("--anyway", action="store_true", help="write it even if it is not good")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, judge, write."""
    from holdfast.core.writing import require_writable
    from holdfast.drivers.calibration import write_bias
    from holdfast.live.hand_files import force_of
    from holdfast.live.running import RunClock, say
    from holdfast.live.sources import open_live
    from holdfast.sessions.calibrate import measure_bias, require_good

    require_writable(args.out.parent)
    require_json_writable(args)

    clock = RunClock()
    # Opening may take seconds, and simulating a scene longer.
    say(f"opening {args.source}")
    source = open_live(
        args.source,
        clock=clock,
        report=say,
        to_force=force_of(args.calibration),
        read_set=set_reader(args.source),
    )
    try:
        measured = measure_bias(source, clock, say, args.seconds)
    finally:
        source.close()

    # A bias that is off shifts every force that is measured with it.
    if not args.anyway:
        require_good(measured, "nothing is written")

    bias = measured.bias
    write_bias(args.out, bias)
    spread = float(bias.spread.max())
    run = command("run", "MODEL", "--source", "URL", "--bias", args.out)
    next_step = f"next: {run}"
    words = f"{count_of(bias.n, 'row')}, spread at most {spread:.3g} {bias.unit}"
    words += f"\nbias written to {args.out}"
    found = {
        "out": args.out,
        "rows": bias.n,
        "largest_spread": spread,
        "unit": bias.unit,
    }
    show_found(args, f"{words}; {next_step}", found)
    return 0
