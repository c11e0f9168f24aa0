"""`python -m benchmarks WHAT`: measures what accuracy costs in time, as JSON, a picture and tables.

`make bench NAME=WHAT` is the same; `make bench` measures all.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import (
    STDOUT,
    add_json_option,
    path_argument,
    require_json_writable,
    write_found,
)
from holdfast.cli.options import CORES, add_job_options, chosen_workers
from holdfast.core.contract import Json
from holdfast.core.schema import model_path
from tools.harness import Program, measured_now, run_script

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from holdfast.evaluation.jobs import Workers

MODEL = model_path("holdfast-150hz")
SURFACES = ("cost", "robust")
"""Of these the front alone is printed."""
LIVE_HZ = (150.0, 400.0)
LIVE_S = 60.0


@dataclass(frozen=True)
class BenchRequest:
    """Folder of the results, and where the points of `cost` are measured."""

    out: Path
    workers: Workers


@dataclass(frozen=True)
class Measure:
    """One WHAT: what it measures, the kind of its data, and the function that measures it.

    alone: no part of `all`, because it needs more than the checkout.
    """

    about: str
    kind: str
    measure: Callable[[BenchRequest], Json]
    alone: bool = False


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program."""
    lines = [f"  {name:<14}{one.about}" for name, one in MEASURES.items()]
    lines += [f"  {name:<14}{one.about}" for name, one in PROGRAMS.items()]
    parser.epilog = "WHAT:\n" + "\n".join(lines)
    option = parser.add_argument
    what = "one of the list below, or all"
    option("what", choices=(*MEASURES, "all"), metavar="WHAT", help=what)
    check = "exit 1 if the limit of cost does not hold"
    option("--check", action="store_true", help=check)
    default = Path("build/bench")
    out = "folder for the results (default build/bench); cost continues there where it stopped"
    option("--out", type=path_argument, default=default, metavar="DIR", help=out)
    add_job_options(parser, CORES)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Measure, write WHAT.json and WHAT.svg, print the tables."""
    from benchmarks.cost.page import short
    from benchmarks.pictures import PICTURES
    from holdfast.core.writing import require_writable
    from holdfast.evaluation.provenance import table_lines, write_measured
    from holdfast.training.progress import Stages

    require_writable(args.out)
    require_json_writable(args)
    request = BenchRequest(args.out, chosen_workers(args))
    chosen = [args.what]
    if args.what == "all":
        chosen = [name for name, one in MEASURES.items() if not one.alone]
    found: dict[str, Json] = {}
    begin = Stages()
    for what in chosen:
        measure = MEASURES[what]
        begin(f"{what}: {measure.about}")
        figures = found[what] = measure.measure(request)
        picture = PICTURES[what](figures) if what in PICTURES else None
        written = write_measured(args.out, what, measure.kind, figures, picture)
        if args.json != STDOUT:
            tables = table_lines(short(figures) if what in SURFACES else figures)
            print("\n".join([*tables, *written]))
    write_found(args, found)
    return int(args.check and any(one.get("broken") for one in found.values()))


def _rows(rows: Iterable[DataclassInstance]) -> list[Json]:
    """Dataclasses as the rows of a table in WHAT.json."""
    return [asdict(row) for row in rows]


def _effects(request: BenchRequest) -> Json:
    from benchmarks.effects import empty_list_over_core, prices

    return {"prices": _rows(prices()), "empty_list_over_core": empty_list_over_core()}


def _simulator(request: BenchRequest) -> Json:
    from benchmarks.simulator import plausibility, size_curve, step_curve

    step = _rows(step_curve())
    sizes = asdict(size_curve())
    leads = _rows(plausibility())
    return {"step": step, **sizes, "plausibility": leads}


def _cost(request: BenchRequest) -> Json:
    from benchmarks.cost.peers import peer_times
    from benchmarks.cost.surface import cost

    surface = cost(request.out / "cost", workers=request.workers)
    return {**surface, **peer_times(MODEL)}


def _robust(request: BenchRequest) -> Json:
    from benchmarks.cost.point import ON_HANDS
    from benchmarks.cost.surface import cost

    # The folder of the whole surface: what is measured here is not measured there again.
    measured = cost(request.out / "cost", ON_HANDS, workers=request.workers)
    return {**measured_now(), **measured}


def _hand(request: BenchRequest) -> Json:
    from benchmarks.hand import fault_table, latency, scan_costs
    from benchmarks.memory import memory

    scans = scan_costs()
    live = [latency(MODEL, rate_hz, LIVE_S) for rate_hz in LIVE_HZ]
    compute_ms = 1e-3 * sum(
        live[0].latency_us[stage]["p50"]
        for stage in ("convert", "step", "decide", "emit")
    )
    return {
        "scans": _rows(scans),
        "faults": [row.to_json() for row in fault_table(MODEL, compute_ms)],
        "live": _rows(live),
        "memory": _rows(memory(MODEL)),
    }


def _runtimes(request: BenchRequest) -> Json:
    from benchmarks.runtimes.here import measure

    return measure(MODEL)


def _arm(request: BenchRequest) -> Json:
    from benchmarks.runtimes.arm import measure
    from holdfast.core.errors import DataNotFound

    tiny = MODEL.with_name(f"{MODEL.stem}-tiny.onnx")
    if not tiny.is_file():
        raise DataNotFound(
            "no such model", where=tiny, next_step="make models SIZE=tiny"
        )
    return measure([MODEL, tiny])


MEASURES: dict[str, Measure] = {
    "cost": Measure(
        "recall and delay by trees, depth, features, rate, window, debounce (hours; --dask)",
        "scenes simulated, people public real data",
        _cost,
    ),
    "robust": Measure(
        "what robustness costs: the points of cost that are asked on other hands too",
        "scenes simulated",
        _robust,
        alone=True,
    ),
    "effects": Measure(
        "time per sample of every effect of a scene", "time on this machine", _effects
    ),
    "hand": Measure(
        "scans by bridge, faults, latency of the live loop by stage (minutes)",
        "simulated",
        _hand,
    ),
    "simulator": Measure(
        "error by step, CPU time by size",
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
