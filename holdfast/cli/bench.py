"""`holdfast bench latency`: whether this machine is fast enough: one decision, and its budgets.

The parts of a decision, what accuracy costs in time, a hand, the simulator: `make bench NAME=..` in
a checkout.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from holdfast.cli.command import (
    STDOUT,
    add_json_option,
    path_argument,
    require_json_writable,
    show,
    write_found,
)

LATENCY = "latency"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "what",
        choices=[LATENCY],
        metavar="latency",
        help="latency: the time of one decision",
    )
    option("--check", action="store_true", help="exit 1 if a budget is exceeded")
    out = "folder for the results (default build/bench)"
    default = Path("build/bench")
    option("--out", type=path_argument, default=default, metavar="DIR", help=out)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, write latency.json, print the tables."""
    from holdfast.core.schema import model_path
    from holdfast.core.writing import require_writable
    from holdfast.evaluation.bench import KIND, figures_of
    from holdfast.evaluation.provenance import table_lines, write_measured
    from holdfast.training.progress import stages

    require_writable(args.out)
    require_json_writable(args)
    with stages(1) as begin:
        begin("latency: time of one decision")
        # The shipped model: figures of two machines are then of the same file.
        figures = figures_of(model_path("holdfast-150hz"))

    written = write_measured(args.out, LATENCY, KIND, figures, None)
    if args.json != STDOUT:
        show("\n".join([*table_lines(figures), *written]))
    write_found(args, {LATENCY: figures})
    # Only with --check: a machine for trying things may be slower than the budgets.
    return int(args.check and bool(figures["broken"]))
