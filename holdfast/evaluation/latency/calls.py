"""Calls that are timed: the whole step of a model file, and the grip controller's command."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle

from holdfast.core.contract import BoolArray, FloatArray, Sample
from holdfast.edge_runtime.graph import StepGraph
from holdfast.edge_runtime.grip_control import GripControl
from holdfast.edge_runtime.model import golden_input
from holdfast.edge_runtime.monitor import GripMonitor, Model

STEP = "ours, whole step"
GRIP = "ours, grip command"
FLOOR = "floor"
"""Names of the calls of `holdfast bench latency`, as latency.json has them."""
Stream = tuple[FloatArray, BoolArray]
"""Values [T, C] and valid [T, C/3] of samples that calls take in turn."""


def step_of(model: Model, stream: Stream | None = None) -> Callable[[], object]:
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


def grip_of(model: Model, stream: Stream) -> Callable[[], object]:
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


def golden(model: Model) -> Stream:
    """The sequence every file is checked with at load, of this model."""
    card = model.card
    return golden_input(card.n_channels, card.unit, card.settle_samples)
