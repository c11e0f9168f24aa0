"""`holdfast bench WHAT`: what accuracy costs in time, each as JSON, a picture and tables.

effects      ns per sample of every effect of a scene
latency      one decision beside its peers, in turns; --check holds it against edge_runtime/budget.toml
cost         what is found and how late, against trees, depth, features, rate, window and debounce; goes on where
             it was; HOLDFAST_DASK=ADDRESS measures on a Dask cluster
training     CPU seconds of simulating, features and training against the number of trials
instructions a step and a forest counted by callgrind, and a projection to a small board
hand         scans of six fingertips by bridge, faults, delays, and the live loop's latency by stage
onset        error of the slip's start as a camera sees it, over accelerations and on pulls (needs the extra camera)
simulator    step against slip time, trials and elements against CPU time, medians of lead, and beside it other
             laws of friction and, after `make peers`, MuJoCo on the same hold and pull
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from edge_runtime.command import path_argument
from edge_runtime.writing import require_writable, write_whole


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "what", choices=(*MEASURES, "all"), metavar="WHAT", help=f"{', '.join(MEASURES)}, all"
    )
    parser.add_argument(
        "--check", action="store_true", help="with latency: exit 1 where a budget is broken"
    )
    parser.add_argument(
        "--out",
        type=path_argument,
        default=Path("build/bench"),
        metavar="DIR",
        help="default build/bench",
    )


def run(args: argparse.Namespace) -> int:
    """Measure, write WHAT.json and WHAT.svg, print the tables."""
    from benchmarks.pictures import PICTURES

    require_writable(args.out)
    for what in MEASURES if args.what == "all" else (args.what,):
        figures = MEASURES[what](args.out)
        path = write_whole(
            args.out / f"{what}.json", json.dumps(figures | _host(what), indent=2) + "\n"
        )
        picture = write_whole(path.with_suffix(".svg"), PICTURES[what](figures))
        _print_tables(what, figures)
        print(f"{path}\n{picture}")
        for line in figures.get("broken", []):
            print(f"over budget: {line}")
        if args.check and figures.get("broken"):
            return 1
    return 0


def _print_tables(what: str, figures: dict[str, Any]) -> None:
    from benchmarks.cost.page import short
    from evaluation.page import markdown

    for title, rows in short(figures).items() if what == "cost" else figures.items():
        if (
            isinstance(rows, list)
            and rows
            and isinstance(rows[0], dict)
            and "latency_us" not in rows[0]
        ):
            print(f"{title}\n{markdown(rows)}\n")


def _effects(out: Path) -> dict[str, Any]:
    from benchmarks.effects import empty_list_over_core, prices

    return {"prices": prices(), "empty_list_over_core": empty_list_over_core()}


def _simulator(out: Path) -> dict[str, Any]:
    from benchmarks.friction_peers import table
    from benchmarks.hold_and_pull import rows
    from benchmarks.simulator import plausibility, size_curve, step_curve

    peers = {"hold_and_pull": rows(out), "friction": table()}
    return {"step": step_curve(), **size_curve(), "plausibility": plausibility(), **peers}


def _latency(out: Path) -> dict[str, Any]:
    from benchmarks.hand import memory
    from benchmarks.latency import broken, latency

    figures, processes = latency(MODEL), memory(MODEL)
    return figures | {"memory": processes, "broken": broken(figures, processes[-1]["resident_mb"])}


def _instructions(out: Path) -> dict[str, Any]:
    from benchmarks.instructions import INSTRUCTIONS_A_CYCLE, instructions

    return {"rows": instructions(MODEL), "assumed_instructions_a_cycle": INSTRUCTIONS_A_CYCLE}


def _training(out: Path) -> dict[str, Any]:
    from benchmarks.training_time import training_times

    return {"rows": training_times()}


def _cost(out: Path) -> dict[str, Any]:
    from benchmarks.cost.surface import cost

    return cost(out / "cost", dask=os.environ.get("HOLDFAST_DASK"))


def _hand(out: Path) -> dict[str, Any]:
    from benchmarks.hand import fault_table, latency, memory, scan_costs
    from benchmarks.hand_delays import delays
    from edge_runtime.monitor import Model

    act_samples = Model(MODEL).card.decision.act_samples
    scans = scan_costs()
    live = [latency(MODEL, rate_hz, LIVE_S) for rate_hz in LIVE_HZ]
    compute_ms = 1e-3 * sum(
        live[0]["latency_us"][stage]["p50"] for stage in ("convert", "step", "decide", "emit")
    )
    figures = {
        "scans": scans,
        "faults": fault_table(MODEL, compute_ms),
        "live": live,
        "act_samples": act_samples,
    }
    return figures | {"delays": delays(scans, compute_ms, act_samples), "memory": memory(MODEL)}


def _onset(out: Path) -> dict[str, Any]:
    from benchmarks.onset import held, pulls, ramps

    return {"ramps": ramps(), "pulls": pulls(), "held": held()}


MEASURES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "latency": _latency,
    "cost": _cost,
    "training": _training,
    "instructions": _instructions,
    "effects": _effects,
    "hand": _hand,
    "onset": _onset,
    "simulator": _simulator,
}
MODEL = Path(__file__).resolve().parent.parent / "models" / "holdfast-150hz.onnx"
LIVE_HZ, LIVE_S = (150.0, 400.0), 60.0


KINDS = {
    "cost": "scenes simulated, people public real data",
    "hand": "simulated",
    "onset": "simulated",
    "effects": "time on this machine",
    "latency": "time on this machine, samples simulated",
    "training": "time on this machine, trials simulated",
    "instructions": "counted by callgrind",
    "simulator": "simulated, time on this machine",
}
LIBRARIES = ("numpy", "scipy", "scikit-learn", "onnx", "onnxruntime", "skl2onnx")
SEED = 0


def _host(what: str) -> dict[str, Any]:
    """What stands in every JSON: where and with what it was measured. All measures draw from fixed
    seeds."""
    machine = {
        "machine": platform.machine(),
        "system": platform.system(),
        "cpus": os.cpu_count(),
        "cpu": _cpu(),
    }
    versions = {"python": platform.python_version()} | {name: version(name) for name in LIBRARIES}
    return {"kind": KINDS[what], "seed": SEED, "host": machine, "versions": versions}


def _cpu() -> str | None:
    """The processor's name, where Linux tells."""
    try:
        text = Path("/proc/cpuinfo").read_text("utf-8")
    except OSError:
        return None
    names = [
        line.partition(":")[2].strip()
        for line in text.splitlines()
        if line.startswith("model name")
    ]
    return names[0] if names else None
