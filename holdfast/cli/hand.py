"""What sets up a hand: `holdfast scan`, `bias`, `calibrate`, `bench` and `board`.

holdfast scan                                              the sensors on a bus, and their rate
holdfast bias --source usb://ft232h --out hand.bias.json   two seconds, the hand open and untouched
holdfast calibrate loads.csv --out hand.calibration.json   known loads: Time,X1..Zn,Fx,Fy,Fz
holdfast bench latency holdfast-50hz --source usb://ft232h whether this machine is fast enough
holdfast bench latency mine.onnx --older before.onnx
holdfast board udev                                        what the board needs installed

A bias that is not good is not written, unless --anyway. The errors of a calibration are on probings
left out. What accuracy costs in time, a bus, the simulator: `make bench NAME=..` in a checkout.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import closing, suppress
from dataclasses import asdict, replace
from datetime import date
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    STDOUT,
    add_json_option,
    add_out_option,
    path_argument,
    require_outputs,
    show,
    show_found,
    write_found,
)
from holdfast.cli.options import (
    add_hand_options,
    add_model_argument,
    add_seconds_option,
    set_reader,
)
from holdfast.core.errors import DeviceNotFound, HoldfastError, command, count_of
from holdfast.core.schema import LIBRARY, model_path

if TYPE_CHECKING:
    from holdfast.drivers.scan import ScannedBus
    from holdfast.edge_runtime.engine import OpenedModel

PARTS = {"udev": "70-holdfast.rules", "service": "holdfast.service"}


# -- scan


def add_scan_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    urls = "usb://ft232h, i2c://1, virtual://ft232h (default: every bridge on USB)"
    reads = "it only reads until a sensor or a mux has identified itself"
    parser.add_argument("url", nargs="?", metavar="URL", help=f"{urls}; {reads}")
    add_json_option(parser)


def run_scan(args: argparse.Namespace) -> int:
    """Look at one bus, or at every bridge that is plugged in: its sensors, their faults, its rate.

    Raises DeviceNotFound without a bridge, and other DeviceErrors.
    """
    from holdfast.drivers.bridges import bridges_on_usb

    urls = [args.url] if args.url else bridges_on_usb()
    if not urls:
        raise DeviceNotFound(
            "no bridge on USB",
            cause="no ft232h is plugged in, or udev denies access",
            next_step="holdfast doctor; holdfast scan i2c://1 for the board's own bus",
        )

    buses = list(map(_surveyed, urls))
    lines: list[str] = []
    for bus in buses:
        lines += bus.lines()
    show_found(args, "\n".join(lines), {"buses": list(map(asdict, buses))})
    return 0


def _surveyed(url: str) -> ScannedBus:
    from holdfast.drivers.chips import driver_of
    from holdfast.drivers.layout import read_layout
    from holdfast.drivers.scan import survey
    from holdfast.live.running import RunClock
    from holdfast.live.sources import open_bus, source_url

    clock = RunClock()
    # The sensors are not started: a scan shall leave everything as it is.
    with closing(open_bus(url, clock)) as bus:
        # The addresses of the fingers in the URL's layout.
        options = source_url(url).options
        chip = driver_of(options.chip)
        layout = read_layout(options.layout, chip.addresses)
        named = frozenset(finger.address for finger in layout)
        return survey(url, bus, chip, lambda s: clock.spend(round(1e9 * s)), named)


# -- bias and calibrate


def add_bias_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    add_hand_options(parser)
    add_out_option(parser, "bias to write (JSON)", "FILE")
    add_seconds_option(parser, "duration of the measurement (default 2)", 2.0)
    parser.add_argument(
        "--anyway", action="store_true", help="write it even if it is not good"
    )
    add_json_option(parser)


def run_bias(args: argparse.Namespace) -> int:
    """Measure the bias of the open, untouched hand; judge it, and write it where it is good.

    Raises OutputError, and the errors of the hand.
    """
    from holdfast.drivers.calibration import digest_of, write_bias
    from holdfast.live.hand_files import force_of
    from holdfast.live.running import RunClock, say
    from holdfast.live.sources import open_live
    from holdfast.sessions.calibrate import measure_bias, require_good

    require_outputs(args, args.out)

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

    with closing(source):
        measured = measure_bias(source, clock, say, args.seconds)

    # A bias that is off shifts every force that is measured with it.
    if not args.anyway:
        require_good(measured, "nothing is written")

    digest = digest_of(args.calibration) if args.calibration else ""
    today = date.today().isoformat()
    bias = replace(measured.bias, date=today, calibration=digest)
    write_bias(args.out, bias)
    spread = float(bias.spread.max())
    run = command("run", "MODEL", "--source", "URL", "--bias", args.out)
    words = f"{count_of(bias.n, 'row')}, spread at most {spread:.3g} {bias.unit}"
    words += f"\nbias written to {args.out}; next: {run}"
    found = {
        "out": args.out,
        "rows": bias.n,
        "largest_spread": spread,
        "unit": bias.unit,
    }
    show_found(args, words, found)
    return 0


def add_calibrate_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "path",
        type=path_argument,
        metavar="PATH",
        help="a CSV file Time,X1..Zn,Fx,Fy,Fz",
    )
    add_out_option(parser, "calibration to write", "FILE")
    option(
        "--load-unit",
        choices=("N", "mN", "gf"),
        default="N",
        help="unit of the loads (default N)",
    )
    add_json_option(parser)


def run_calibrate(args: argparse.Namespace) -> int:
    """Fit the map from field to force, judge it on probings left out, print and write it.

    The file has the columns Time, X1..Zn (uT) and Fx, Fy, Fz; every fingertip is pressed at least
    twice. Raises DataError, OutputError.
    """
    from holdfast.drivers.calibration import write_calibration
    from holdfast.sessions.calibrate import as_json, calibrate, in_words, read_loads

    # Before the fit, whose result would otherwise be lost.
    require_outputs(args, args.out)
    loads = read_loads(args.path, args.load_unit)
    fit = calibrate(loads, args.path.name, date.today().isoformat())
    write_calibration(args.out, fit.calibration)
    found = as_json(loads, fit)
    words = "\n".join([*in_words(found), f"  written: {args.out}"])
    show_found(args, words, found | {"written": args.out})
    return 0


# -- bench and board


def add_bench_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "what",
        choices=["latency"],
        metavar="latency",
        help="latency: the time of one decision, and the way of a sample",
    )
    add_model_argument(parser)
    option(
        "--older",
        type=path_argument,
        metavar="FILE",
        help="another file of this rate and hand, its step timed in the same run",
    )
    add_hand_options(parser, required=False, default="virtual://ft232h")
    add_seconds_option(parser, "of each live run (default 20)", 20.0)
    option("--check", action="store_true", help="exit 1 if a budget is exceeded")
    out = "folder for the results (default build/bench)"
    default = Path("build/bench")
    option("--out", type=path_argument, default=default, metavar="DIR", help=out)
    add_json_option(parser)


def run_bench(args: argparse.Namespace) -> int:
    """Measure, write latency.json, print the tables.

    Returns 1 where --check finds a budget exceeded.
    """
    from holdfast.edge_runtime.model import Model
    from holdfast.evaluation.formats import table_lines, write_measured
    from holdfast.live.bench import BenchRequest, figures_of
    from holdfast.live.running import say

    require_outputs(args, args.out / "latency.json")
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


def add_board_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "part", choices=PARTS, help="udev rules for the bridges, or a systemd unit"
    )


def run_board(args: argparse.Namespace) -> int:
    """Print one file, to be piped into place."""
    part = files("holdfast.drivers.board") / PARTS[args.part]
    sys.stdout.write(part.read_text(encoding="utf-8"))
    return 0
