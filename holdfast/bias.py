"""`holdfast bias --source URL --out FILE`: what the unloaded hand reads, with a look at how good
that is.

Hand open, nothing touched, two seconds. Where something is odd nothing is written, unless --anyway.
"""

from __future__ import annotations

import argparse

import numpy as np

from drivers.calibration import bias_of, write_bias
from edge_runtime.command import path_argument, show
from edge_runtime.errors import DataError
from edge_runtime.live import Source
from edge_runtime.writing import require_writable
from holdfast.live_options import add_live_options, force_of
from holdfast.live_sources import open_live
from holdfast.messages import say
from holdfast.real_time import RunClock

RATE_HZ = 100.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    add_live_options(parser)
    parser.add_argument(
        "--out", type=path_argument, required=True, metavar="FILE", help="the bias, as JSON"
    )
    parser.add_argument(
        "--seconds", type=float, default=2.0, metavar="S", help="for so long (default 2)"
    )
    parser.add_argument("--anyway", action="store_true", help="write it although something is odd")


def run(args: argparse.Namespace) -> int:
    """Measure, judge, write."""
    require_writable(args.out.parent)
    clock = RunClock()
    source = open_live(args.source, clock=clock, say=say, to_force=force_of(args.calibration))
    try:
        rows = unloaded(source, clock, args.seconds)
    finally:
        source.close()
    bias, warnings = bias_of(rows, source.unit)
    for warning in warnings:
        say(f"warning: {warning}")
    # a reversed magnet is turned by the model's preparation
    odd = len(warnings) - bool(bias.reversed.any())
    if odd and not args.anyway:
        raise DataError(
            "not a good bias, nothing is written",
            cause="the lines above",
            next_step="mend that, or add --anyway",
        )
    write_bias(args.out, bias)
    show(f"{bias.n} rows, spread at most {bias.spread.max():.3g} {bias.unit}: {args.out}")
    return 0


def unloaded(source: Source, clock: RunClock, seconds: float) -> np.ndarray:
    """[T, C] of a source, nan where a sensor is not valid."""
    start_ns, rows = clock.now_ns(), []
    for k in range(round(seconds * RATE_HZ)):
        clock.wait_until(start_ns + round(k * 1e9 / RATE_HZ))
        measured = source.read()
        if measured is None:
            break
        rows.append(np.where(np.repeat(measured.valid, 3), measured.values, np.nan))
    return np.array(rows).reshape(-1, source.n_channels)
