"""Calls that are timed and counted: the whole step, the learners alone. Live path only."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

from holdfast.core.contract import BoolArray, FloatArray, Sample
from holdfast.edge_runtime.graph import StepGraph
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model import golden_input
from holdfast.edge_runtime.monitor import GripMonitor, Model

STEP, C_STEP, GRIP, OWN, BARE, SKLEARN, THESIS, FLOOR, C_FLOOR, WALK, TREELITE = (
    "ours, whole step",
    "ours, whole step in C",
    "ours, grip command",
    "ours, learner alone",
    "bare forest, 100 full-depth trees",
    "scikit-learn, the same trees",
    "the thesis' way",
    "floor",
    "floor of the step in C",
    "a walk in C, the same trees",
    "treelite, the same trees",
)
"""Names of the calls of `holdfast bench latency`, as latency.json has them."""


def step_of(
    model: Model, stream: tuple[FloatArray, BoolArray] | None = None
) -> Callable[[], object]:
    """Step over a stream again and again, by default over the golden sequence with its faults."""
    values, valid = stream or golden(model)
    graph, turn = StepGraph(model.session), cycle(range(len(values)))

    def step() -> None:
        index = next(turn)
        graph.sample[0] = values[index]
        graph.valid[0] = valid[index]
        graph.step()

    return step


def grip_of(model: Model, stream: tuple[FloatArray, BoolArray]) -> Callable[[], object]:
    """The grip controller's command for each sample of a stream, its predictions made before."""
    card, (values, valid) = model.card, stream
    monitor, period_ns = GripMonitor(model, None), 1e9 / card.rate_hz
    predictions = [
        monitor.feed(Sample(round(k * period_ns), values[k], valid[k], k))
        for k in range(len(values))
    ]
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
    row, turn = rows[:1].copy(), cycle(range(len(rows)))
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
    return golden_input(
        model.card.n_channels, model.card.unit, model.card.settle_samples
    )
