"""`holdfast bench latency [MODEL]`: whether this machine is fast enough, hot and as deployed.

holdfast bench latency
holdfast bench latency holdfast-50hz --source usb://ft232h --calibration hand.calibration.json
holdfast bench latency mine.onnx --older before.onnx

What accuracy costs in time, a bus, the simulator: `make bench NAME=..` in a checkout.
"""

from __future__ import annotations

import argparse
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    STDOUT,
    add_json_option,
    path_argument,
    positive,
    require_json_writable,
    show,
    write_found,
)
from holdfast.cli.options import add_calibration_option
from holdfast.core.errors import HoldfastError
from holdfast.core.schema import DEFAULT_MODEL, LIBRARY, model_path

if TYPE_CHECKING:
    from holdfast.edge_runtime.engine import OpenedModel


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "what",
        choices=["latency"],
        metavar="latency",
        help="latency: the time of one decision, and the way of a sample",
    )
    option(
        "model",
        nargs="?",
        default=DEFAULT_MODEL,
        metavar="MODEL",
        help=f"a sealed model file (default: the shipped {DEFAULT_MODEL})",
    )
    option(
        "--older",
        type=path_argument,
        metavar="FILE",
        help="another file of this rate and hand, its step timed in the same run",
    )
    option(
        "--source",
        default="virtual://ft232h",
        metavar="URL",
        help="the hand whose samples are followed (default virtual://ft232h)",
    )
    add_calibration_option(parser)
    option(
        "--seconds",
        type=positive,
        default=20.0,
        metavar="S",
        help="of each call, and of each live run (default 20)",
    )
    option("--check", action="store_true", help="exit 1 if a budget is exceeded")
    out = "folder for the results (default build/bench)"
    default = Path("build/bench")
    option("--out", type=path_argument, default=default, metavar="DIR", help=out)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, write latency.json, print the tables."""
    from holdfast.core.writing import require_writable
    from holdfast.edge_runtime.model import Model
    from holdfast.evaluation.formats import table_lines, write_measured
    from holdfast.live.bench import BenchRequest, figures_of
    from holdfast.live.running import say

    require_writable(args.out)
    require_json_writable(args)
    path = model_path(args.model)
    say("timing a decision and the way of a sample, which takes minutes")
    with TemporaryDirectory() as work:
        request = BenchRequest(
            Model(path),
            compiled=_compiled(path, Path(work)),
            older=Model(args.older) if args.older else None,
            source=args.source,
            calibration=args.calibration,
            seconds=args.seconds,
        )
        figures = figures_of(request)

    written = write_measured(args.out, "latency", "time on this machine", figures)
    if args.json != STDOUT:
        show("\n".join([*table_lines(figures), *written]))
    write_found(args, {"latency": figures})
    # Only with --check: a machine for trying things may be slower than the budgets.
    return int(args.check and bool(figures["broken"]))


def _compiled(model: Path, work: Path) -> OpenedModel | None:
    """The model's C form, that beside it or one made here; None where neither can be."""
    from holdfast.edge_runtime.engine import AUTO, C, ModelChoice
    from holdfast.edge_runtime.model import Model

    opened = ModelChoice(str(model), AUTO).open()
    if not isinstance(opened, Model):
        return opened
    # a board has no compiler, or not the package that reads the graph
    with suppress(HoldfastError, ImportError):
        from holdfast.export.c.exporting import export_c

        export_c(model, work, build=True)
        return ModelChoice(str(model), C, str(work / LIBRARY)).open()
    return None
