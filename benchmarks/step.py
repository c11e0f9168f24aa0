"""`make bench`: one step of a sealed model beside its bare forests and the machine's own jitter.

Absolute microseconds are this machine's; the ratio, taken in one run with both in turns, travels.
"""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Callable, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort

from edge_runtime.command import Parser, finish, place
from edge_runtime.contract import BoolArray, FloatArray
from edge_runtime.golden import golden_input
from edge_runtime.graph import StepGraph, open_session, run_recording
from edge_runtime.monitor import Model
from edge_runtime.timing import busy_wait, time_in_turns
from edge_runtime.writing import write_whole
from export.verify import cut_forests

DEFAULT_MODEL = Path("build/default/holdfast.onnx")
PERCENTILES = (50, 99, 99.9)


def run(path: Path) -> dict[str, Any]:
    """Time step, bare forests and a busy-wait of the step's own length, all in turns."""
    model = Model(path)
    step = _step(model)
    floor_us = float(np.median(time_in_turns({"step": step}, turns=5)["step"]))
    calls = {"whole step": step, "bare forests": _forests(model), "busy-wait (floor)": busy_wait(floor_us)}
    times = time_in_turns(calls)
    rows = {name: _percentiles(values) for name, values in times.items()}
    return {
        "model": model.card.model_id,
        "data": model.card.raw["training"]["data"],
        "n": len(times["whole step"]),
        "us": rows,
        "whole_over_bare_p50": rows["whole step"]["p50"] / rows["bare forests"]["p50"],
        "host": {"machine": platform.machine(), "cpus": os.cpu_count(), "onnxruntime": ort.__version__},
    }


def _step(model: Model) -> Callable[[], object]:
    """Steps over the golden sequence, again and again: signal, gaps and faults in it."""
    values, valid = _golden(model)
    graph, turn = StepGraph(model.session), cycle(range(len(values)))

    def step() -> None:
        index = next(turn)
        graph.sample[0] = values[index]
        graph.valid[0] = valid[index]
        graph.step()

    return step


def _forests(model: Model) -> Callable[[], object]:
    """The forests alone, on the very rows the whole step hands them, bound to buffers as the whole step is."""
    session = open_session(cut_forests(onnx.load(model.path)))
    rows = run_recording(model.session, *_golden(model), ["features"])["features"]
    row, turn = rows[:1].copy(), cycle(range(len(rows)))
    binding = session.io_binding()
    binding.bind_input("features", "cpu", 0, np.float32, row.shape, row.ctypes.data)
    for output in session.get_outputs():
        binding.bind_output(output.name, "cpu")

    def call() -> None:
        row[0] = rows[next(turn)]
        session.run_with_iobinding(binding)

    return call


def _golden(model: Model) -> tuple[FloatArray, BoolArray]:
    return golden_input(model.card.n_channels, model.card.unit, model.card.settle_samples)


def _percentiles(times: FloatArray) -> dict[str, float]:
    return {f"p{p:g}": float(np.percentile(times, p)) for p in PERCENTILES}


def main(argv: Sequence[str]) -> int:
    """Parse, run, write step.json, print the table."""
    parser = Parser(prog="step.py", description="one step beside its bare forests and the machine's jitter")
    parser.add_argument("--model", type=place, default=DEFAULT_MODEL, metavar="FILE")
    parser.add_argument("--out", type=place, default=Path("build/bench"), metavar="DIR")
    args = parser.parse_args(argv)
    result = run(args.model)
    write_whole(args.out / "step.json", json.dumps(result, indent=2) + "\n")
    for name, row in result["us"].items():
        print(f"{name:<20}" + "".join(f"{p} {value:8.1f} us   " for p, value in row.items()))
    print(f"whole step over bare forests, p50: {result['whole_over_bare_p50']:.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
