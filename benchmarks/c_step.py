"""The step in C beside the step in onnxruntime: the same file, the same call from Python."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import numpy as np

from benchmarks.calls import C_STEP
from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import CompilerFailed
from holdfast.edge_runtime.c_engine import LIBRARY, CompiledModel
from holdfast.edge_runtime.graph import run_recording
from holdfast.edge_runtime.model import ANSWERS, Model
from holdfast.export.c.exporting import export_c


def c_step_of(
    model: Model, stream: tuple[FloatArray, BoolArray], work: Path
) -> dict[str, Callable[[], object]]:
    """Step over a stream in the compiled library, by its name; empty without a compiler.

    Raises AssertionError where a label differs from onnxruntime's.
    """
    try:
        export_c(model.path, work / "c", build=True)
    except CompilerFailed:
        return {}
    steps = CompiledModel(model.path, work / "c" / LIBRARY).stepper(ANSWERS)
    rows, turn = list(zip(*stream, strict=True)), cycle(range(len(stream[0])))

    def step() -> None:
        steps.sample[0], steps.valid[0] = rows[next(turn)]
        steps.step()

    expected = run_recording(model.session, *stream, ["situation"])["situation"]
    for label in expected:
        step()
        if not np.array_equal(steps.out["situation"][0], label):
            raise AssertionError("the C form does not label as onnxruntime does")
    return {C_STEP: step}
