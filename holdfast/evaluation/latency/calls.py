"""Calls that are timed and counted: the whole step, also in C, and the learners alone."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from holdfast.core.contract import BoolArray, FloatArray, Sample
from holdfast.core.errors import CompilerFailed
from holdfast.edge_runtime.graph import StepGraph, run_recording
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model import ANSWERS, golden_input
from holdfast.edge_runtime.monitor import GripMonitor, Model

STEP = "ours, whole step"
C_STEP = "ours, whole step in C"
GRIP = "ours, grip command"
OWN = "ours, learner alone"
BARE = "bare forest, 100 full-depth trees"
FLOOR = "floor"
C_FLOOR = "floor of the step in C"
"""Names of the calls of `holdfast bench latency`, as latency.json has them."""


def step_of(
    model: Model, stream: tuple[FloatArray, BoolArray] | None = None
) -> Callable[[], object]:
    """Step over a stream again and again, by default over the golden sequence with its faults."""
    values, valid = stream or golden(model)
    graph = StepGraph(model.session)
    turn = cycle(range(len(values)))

    def step() -> None:
        index = next(turn)
        # Into the buffers of the graph, as the live loop does it: no array is made.
        graph.sample[0] = values[index]
        graph.valid[0] = valid[index]
        graph.step()

    return step


def c_step_of(
    model: Model, stream: tuple[FloatArray, BoolArray], work: Path
) -> dict[str, Callable[[], object]]:
    """Step over a stream in the compiled library, by its name; empty without a compiler.

    Raises AssertionError where a label differs from onnxruntime's.
    """
    from holdfast.edge_runtime.c_engine import LIBRARY, CompiledModel
    from holdfast.export.c.exporting import export_c

    try:
        export_c(model.path, work / "c", build=True)
    # A machine without a compiler measures everything else.
    except CompilerFailed:
        return {}

    steps = CompiledModel(model.path, work / "c" / LIBRARY).stepper(ANSWERS)
    values, valid = stream
    turn = cycle(range(len(values)))

    def step() -> None:
        index = next(turn)
        steps.sample[0] = values[index]
        steps.valid[0] = valid[index]
        steps.step()

    # One whole turn is checked before anything is timed; the turn ends where it began.
    expected = run_recording(model.session, values, valid, ["situation"])["situation"]
    for label in expected:
        step()
        if not np.array_equal(steps.out["situation"][0], label):
            raise AssertionError("the C form does not label as onnxruntime does")

    return {C_STEP: step}


def grip_of(model: Model, stream: tuple[FloatArray, BoolArray]) -> Callable[[], object]:
    """The grip controller's command for each sample of a stream, its predictions made before."""
    card = model.card
    values, valid = stream
    monitor = GripMonitor(model, None)
    period_ns = 1e9 / card.rate_hz
    predictions = []
    for k in range(len(values)):
        # Times at the model's rate: no sample is late, and no state unknown for it.
        t_ns = round(k * period_ns)
        sample = Sample(t_ns, values[k], valid[k], k)
        # All before the timing, so that only the controller is timed.
        predictions.append(monitor.feed(sample))

    fingers = card.n_channels // 3
    control = GripControl("holdfast", card.rate_hz, unit=card.unit, n_fingers=fingers)
    turn = cycle(range(len(values)))

    def command() -> None:
        index = next(turn)
        control.step(predictions[index], values[index], valid[index])

    return command


def learner_of(
    session: ort.InferenceSession, rows: npt.NDArray[np.float32]
) -> Callable[[], object]:
    """The learners alone on rows [N, F] in turn, bound to buffers as the whole step is."""
    # Bound once: a call then copies one row, and allocates nothing in Python.
    row = rows[:1].copy()
    turn = cycle(range(len(rows)))
    binding = session.io_binding()
    binding.bind_input("features", "cpu", 0, np.float32, row.shape, row.ctypes.data)
    for output in session.get_outputs():
        binding.bind_output(output.name, "cpu")

    def call() -> None:
        row[0] = rows[next(turn)]
        session.run_with_iobinding(binding)

    return call


def golden(model: Model) -> tuple[FloatArray, BoolArray]:
    """The sequence every file is checked with at load, of this model."""
    card = model.card
    return golden_input(card.n_channels, card.unit, card.settle_samples)
