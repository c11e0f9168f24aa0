"""One model file in every runtime of this machine, in one run."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.runtimes import onnx_programs
from benchmarks.runtimes.c_programs import (
    CLANG,
    GCC,
    SINGLE_GCC,
    WASM,
    StreamAnswers,
    answers_of,
)
from benchmarks.runtimes.stream import Stream, stream_of
from holdfast.core.contract import Json
from holdfast.core.schema import LIBRARY
from holdfast.edge_runtime.c_engine import CompiledModel
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.model import Model
from holdfast.export.c.exporting import export_c

BUILT = Path("build/runtimes")
"""Examples that were built, for the next time."""
ROUNDS = 3
"""Each runtime answers the stream in turn: what slows this machine down meets all of them."""
ONNX = "onnxruntime, from Python"
FROM_PYTHON = "C, gcc, from Python"


def measure(path: Path) -> Json:
    """Labels that differ, bits that differ, and the time of a step, of every runtime."""
    model = Model(path)
    stream = stream_of(model)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        export_c(path, work / "c", build=True)
        library = CompiledModel(path, work / "c" / LIBRARY)
        runs: dict[str, Callable[[], StreamAnswers]] = {
            ONNX: lambda: from_python(model, stream),
            FROM_PYTHON: lambda: from_python(library, stream),
        }
        runs |= {
            one.name: partial(answers_of, one, work / "c", stream, work)
            for one in (GCC, CLANG, WASM, SINGLE_GCC)
            if one.is_installed
        }
        runs |= {
            one.name: partial(onnx_programs.answers_of, one.build(BUILT), path, stream)
            for one in onnx_programs.PROGRAMS
            if one.is_installed()
        }
        found: dict[str, list[StreamAnswers]] = {key: [] for key in runs}
        for _ in range(ROUNDS):
            for key, run in runs.items():
                found[key].append(run())
    rows = [row(key, each, stream, found[GCC.name][0]) for key, each in found.items()]
    python_us = rows[0]["step_us"]
    for one in rows:
        one["beside_python"] = one["step_us"] / python_us
    return {
        "model": model.card.model_id,
        "rows": len(stream.labels),
        "runtimes": rows,
    }


def row(
    name: str, rounds: list[StreamAnswers], stream: Stream, reference: StreamAnswers
) -> Json:
    """One runtime: all that it answered beside onnxruntime's labels and gcc's bits."""
    first = rounds[0]
    return {
        "runtime": name,
        "labels_differ": int((first.labels != stream.labels).sum()),
        "same_bits": same_bits(first, reference),
        "step_us": float(np.median([one.step_us for one in rounds])),
    }


def same_bits(one: StreamAnswers, reference: StreamAnswers) -> bool | None:
    """Whether everything a row leaves is equal, the state too; None where it is not known."""
    if not one.rows.size:
        return None
    return one.rows.shape == reference.rows.shape and bool(
        (one.rows == reference.rows).all()
    )


def from_python(model: OpenedModel, stream: Stream) -> StreamAnswers:
    """The step called from Python, as the live path does."""
    steps = model.stepper(["situation", "unknown"])
    labels = np.zeros(len(stream.labels), np.int32)
    begin = perf_counter()
    for k, (values, valid) in enumerate(zip(stream.values, stream.valid, strict=True)):
        steps.sample[0] = values
        steps.valid[0] = valid
        out = steps.step()
        labels[k] = -1 if out["unknown"][0] else out["situation"][0]
    spent_s = perf_counter() - begin
    nothing = np.zeros((len(labels), 0), np.uint8)
    return StreamAnswers(labels, nothing, 1e6 * spent_s / len(labels))
