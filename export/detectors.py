"""The classical detectors, causal, as parts of the step graph: they run on the hand at every sample.

(The labeller's critical points, which may look ahead, are training/critical_points.py.)

band_pass: the largest |output| over the bands of any shear signal exceeds a multiple of that signal's
own noise floor, a clipped running mean that all but freezes while the detector fires.
band_pass_point: the first sample of such an excursion, after enough quiet.
friction_cone: |shear| > mu x normal at some finger that is pressed hard enough; no division. Unit N only.
"""

from __future__ import annotations

import numpy as np
from onnx import TensorProto

from edge_runtime.contract import FloatArray
from export.bank import STATES_PER_BAND, noise_gain, step_matrix
from export.builder import GraphBuilder
from export.guard import Guarded
from export.spec import NOISE_RMS, StepSpec

SUBNORMAL_BELOW = 1e-30
"""Filter states smaller than this are zero: silence must not end in slow subnormal numbers."""


def detector_names(spec: StepSpec) -> tuple[str, ...]:
    """Columns of the `detectors` output; the cone exists only where the unit is N."""
    return ("band_pass", "band_pass_point") + (("friction_cone",) if spec.unit == "N" else ())


def add_bank(graph: GraphBuilder, spec: StepSpec, guarded: Guarded) -> str:
    """Step the band-pass bank of every shear signal; returns |outputs| [B, n, 2 x bands]."""
    bands = spec.carried_bands()
    size = 1 + STATES_PER_BAND * len(bands)
    before = graph.state("bank", 2 * size)
    difference = graph.node("Sub", guarded.now, guarded.last)
    joined = graph.node("Concat", difference, before, axis=2)
    rested = graph.node("Where", guarded.fresh, graph.constant(0.0), joined)
    stepped = graph.node("MatMul", rested, graph.constant(_sensor_matrix(spec.rate_hz, bands)))
    advanced, outputs = graph.nodes(
        "Split", stepped, graph.ints(2 * size, 2 * len(bands)), outs=["bank_next", "bank_out"], axis=2
    )
    # not Shrink: onnxruntime 1.31 computes it in float32, whatever the type of its input
    faded = graph.node("Less", graph.node("Abs", advanced), graph.constant(SUBNORMAL_BELOW))
    flushed = graph.node("Where", faded, graph.constant(0.0), advanced)
    graph.keep("bank", graph.node("Where", guarded.good, flushed, before))
    return graph.node("Abs", outputs)


def _sensor_matrix(rate_hz: float, bands_hz: tuple[float, ...]) -> FloatArray:
    """One sensor's step: (dx, dy, dz, state x, state y) -> (state x, state y, outputs x, outputs y).

    dz is multiplied by zero: one product with a few zeros is cheaper than cutting z off and gluing on.
    """
    one = step_matrix(rate_hz, bands_hz)
    size = one.shape[0] - 1
    matrix = np.zeros((3 + 2 * size, 2 * one.shape[1]))
    for axis in range(2):
        rows = np.r_[axis, 3 + axis * size : 3 + (axis + 1) * size]
        outputs = 2 * size + axis * len(bands_hz)
        columns = np.r_[axis * size : (axis + 1) * size, outputs : outputs + len(bands_hz)]
        matrix[np.ix_(rows, columns)] = one
    return matrix


def add_detectors(graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str) -> None:
    """Publish `detectors` [B, D] bool in the order of `detector_names`."""
    firing = _band_pass(graph, spec, guarded, rectified)
    columns = [firing, _band_pass_point(graph, spec, firing)]
    if spec.unit == "N":
        columns.append(_friction_cone(graph, spec, guarded))
    graph.node("Flatten", graph.node("Concat", *columns, axis=2), out="detectors", axis=1)
    graph.output("detectors", TensorProto.BOOL, len(columns))


def _band_pass(graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str) -> str:
    """[B, 1, 1]: some usable shear signal is above its noise floor."""
    rules, bands = spec.detectors, spec.carried_bands()
    peak = graph.node("ReduceMax", graph.reshape(rectified, 0, 0, 2, len(bands)), graph.ints(3), keepdims=0)
    quiet_peak = NOISE_RMS[spec.unit] * noise_gain(spec.rate_hz, bands)
    floor = graph.node("Max", graph.state("floor", 2), graph.constant(quiet_peak))
    above = graph.node("Greater", peak, graph.node("Mul", floor, graph.constant(rules.band_ratio)))
    rate = min(1.0, 1.0 / (rules.floor_tau_s * spec.rate_hz))
    slow, fast = graph.constant(rate * rules.firing_rate), graph.constant(rate)
    heard = graph.node("Min", peak, graph.node("Mul", floor, graph.constant(rules.floor_clip)))
    change = graph.node("Mul", graph.node("Sub", heard, floor), graph.node("Where", above, slow, fast))
    graph.keep("floor", graph.node("Where", guarded.usable, graph.node("Add", floor, change), floor))
    return graph.node("ReduceMax", graph.node("And", above, guarded.usable), graph.ints(1, 2), keepdims=1)


def _band_pass_point(graph: GraphBuilder, spec: StepSpec, firing: str) -> str:
    """[B, 1, 1]: an excursion begins, at least `quiet_s` after the end of the previous one.

    Every sensor keeps the same count, so that all state is a sensor's.
    """
    needed = spec.detectors.quiet_s * spec.rate_hz
    quiet = graph.state("quiet", 1)
    longer = graph.node("Min", graph.node("Add", quiet, graph.constant(1.0)), graph.constant(needed + 1.0))
    graph.keep("quiet", graph.node("Where", firing, graph.constant(0.0), longer))
    rested = graph.node("GreaterOrEqual", graph.columns(quiet, 0, 1), graph.constant(needed))
    return graph.node("And", firing, rested)


def _friction_cone(graph: GraphBuilder, spec: StepSpec, guarded: Guarded) -> str:
    """[B, 1, 1]: |shear| > mu x normal and normal > minimum, at some usable finger."""
    rules = spec.detectors
    shear, normal = graph.nodes("Split", guarded.now, graph.ints(2, 1), outs=["shear", "normal"], axis=2)
    magnitude = graph.node("ReduceL2", shear, graph.ints(2), keepdims=1)
    outside = graph.node("Greater", magnitude, graph.node("Mul", normal, graph.constant(rules.friction)))
    pressed = graph.node("Greater", normal, graph.constant(rules.min_normal_n))
    slipping = graph.node("And", graph.node("And", outside, pressed), guarded.usable)
    return graph.node("ReduceMax", slipping, graph.ints(1), keepdims=1)
