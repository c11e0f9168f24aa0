"""`python -m benchmarks WHAT`: measures what accuracy costs in time, as JSON and tables.

`make bench NAME=WHAT` is the same.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path

from holdfast.cli.command import (
    STDOUT,
    add_json_option,
    path_argument,
    require_outputs,
    write_found,
)
from holdfast.cli.options import CORES, add_job_options, chosen_workers
from holdfast.core.contract import Json
from holdfast.core.schema import model_path
from tools.harness import Program, measured_now, run_script

MODEL = model_path("holdfast-150hz")


@dataclass(frozen=True)
class Measure:
    """One WHAT: what it measures, the kind of its data, and the function that measures it.

    alone: no part of `all`, because it needs more than the checkout.
    """

    about: str
    kind: str
    measure: Callable[[argparse.Namespace], Json]
    alone: bool = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program."""
    programs: dict[str, Measure | Program] = {**MEASURES, **PROGRAMS}
    lines = [f"  {name:<14}{one.about}" for name, one in programs.items()]
    parser.epilog = "WHAT:\n" + "\n".join(lines)
    option = parser.add_argument
    what = "one of the list below, or all"
    option("what", choices=(*MEASURES, "all"), metavar="WHAT", help=what)
    default = Path("build/bench")
    out = "folder for the results (default build/bench); cost continues there where it stopped"
    option("--out", type=path_argument, default=default, metavar="DIR", help=out)
    add_job_options(parser, CORES)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, write WHAT.json, print the tables."""
    from holdfast.core.progress import Stages
    from holdfast.core.writing import require_writable
    from holdfast.evaluation.formats import table_lines, write_measured

    require_writable(args.out)
    require_outputs(args)
    chosen = [args.what]
    if args.what == "all":
        chosen = [name for name, one in MEASURES.items() if not one.alone]
    found: dict[str, Json] = {}
    begin = Stages()
    for what in chosen:
        measure = MEASURES[what]
        begin(f"{what}: {measure.about}")
        figures = found[what] = measure.measure(args)
        written = write_measured(args.out, what, measure.kind, figures)
        if args.json != STDOUT:
            print("\n".join([*table_lines(figures), *written]))
    write_found(args, found)
    return 0


def _cost(args: argparse.Namespace) -> Json:
    from benchmarks.cost.surface import cost

    found = cost(args.out / "cost", workers=chosen_workers(args))
    return {**measured_now(), **found}


def _simulator(args: argparse.Namespace) -> Json:
    from benchmarks.simulator import plausibility, prices, step_curve

    return {
        "prices": [asdict(row) for row in prices()],
        "step": [asdict(row) for row in step_curve()],
        "plausibility": [asdict(row) for row in plausibility()],
    }


def _import(args: argparse.Namespace) -> Json:
    from benchmarks.long_import import long_import

    return {**measured_now(), **long_import()}


def _hand(args: argparse.Namespace) -> Json:
    from benchmarks.hand import fault_table, scan_costs

    return {
        "scans": [asdict(row) for row in scan_costs()],
        "faults": [asdict(row) for row in fault_table(MODEL)],
    }


def _runtimes(args: argparse.Namespace) -> Json:
    from benchmarks.runtimes.here import measure

    return measure(MODEL)


def _arm(args: argparse.Namespace) -> Json:
    from benchmarks.runtimes.arm import measure

    # of `make models SIZE=tiny`
    return measure([MODEL, MODEL.with_name(f"{MODEL.stem}-tiny.onnx")])


MEASURES: dict[str, Measure] = {
    "cost": Measure(
        "recall and delay by size, features, learner, rate, debounce (hours; --dask)",
        "scenes simulated, people public real data",
        _cost,
    ),
    "hand": Measure("scans by bridge, faults (minutes)", "simulated", _hand),
    "import": Measure(
        "time and memory of a log of 2,000,000 rows, over those of pandas",
        "simulated, time on this machine",
        _import,
        alone=True,
    ),
    "simulator": Measure(
        "error by step, CPU time of every effect",
        "simulated, time on this machine",
        _simulator,
    ),
    "runtimes": Measure(
        "the default model in every runtime of this machine: labels, bits, time",
        "simulated",
        _runtimes,
        alone=True,
    ),
    "arm": Measure(
        "the default and the tiny model on emulated Arm processors",
        "emulated",
        _arm,
        alone=True,
    ),
}


PROGRAMS = {
    "world": Program(
        "benchmarks.world.program", "the model in a second physics", "build/world"
    ),
}
"""Measures with options of their own; they are no part of `all`."""


def main(words: Sequence[str]) -> int:
    """Run a program by its name, or a measure."""
    if words and words[0] in PROGRAMS:
        program = PROGRAMS[words[0]]
        module = import_module(program.module)
        name = f"python -m benchmarks {words[0]}"
        return run_script(
            name, str(module.__doc__), module.add_arguments, module.run, words[1:]
        )
    return run_script("python -m benchmarks", str(__doc__), add_arguments, run, words)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
