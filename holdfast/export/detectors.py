"""The classical detectors as causal parts of the step graph, computed at every sample.

(The critical points of training, which may look ahead, are in training/critical_points.py.)

band_pass: the largest |output| over the bands of any shear signal exceeds a multiple of that
signal's own noise floor, a clipped running mean that almost stops while the detector fires.
band_pass_point: the first sample of such an excursion, after enough quiet. friction_cone: |shear| >
mu x normal at a finger with enough normal force; without a division. Unit N only.
"""

from __future__ import annotations

import numpy as np
from onnx import TensorProto

from holdfast.export.bank import STATES_PER_BAND, noise_gain, step_matrix
from holdfast.export.builder import GraphBuilder
from holdfast.export.guard import Guarded
from holdfast.export.spec import NOISE_RMS, StepSpec

GRAIN = 1e-30
"""Every number in the filter moves this far towards zero: silence must not become subnormal
numbers, which are slow."""


def detector_names(spec: StepSpec) -> tuple[str, ...]:
    """Columns of the `detectors` output; the cone exists only where the unit is N."""
    return ("band_pass", "band_pass_point") + (
        ("friction_cone",) if spec.unit == "N" else ()
    )


def add_bank(graph: GraphBuilder, spec: StepSpec, guarded: Guarded) -> str:
    """Step the band-pass bank of every channel; returns |outputs| [B, bands, C].

    The normal has a bank too: separating its channels costs more than stepping it.
    """
    bands = spec.carried_bands()
    size = 1 + STATES_PER_BAND * len(bands)
    before = graph.state("bank", size)
    difference = graph.node("Sub", guarded.now, guarded.last)
    joined = graph.node(
        "Mul", graph.node("Concat", difference, before, axis=1), guarded.begun
    )
    # x - clip(x) is 0 up to GRAIN, x itself from 1e-13 on, a multiple of 1e-46 in between:
    # never subnormal
    grains = graph.node("Clip", joined, graph.constant(-GRAIN), graph.constant(GRAIN))
    rested = graph.node("Sub", joined, grains)
    stepped = graph.node(
        "MatMul", graph.constant(step_matrix(spec.rate_hz, bands).T), rested
    )
    advanced, outputs = graph.nodes(
        "Split",
        stepped,
        graph.ints(size, len(bands)),
        outs=["bank_next", "bank_out"],
        axis=1,
    )
    graph.keep("bank", graph.node("Where", guarded.good, advanced, before))
    return graph.node("Abs", outputs)


def add_detectors(
    graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str
) -> None:
    """Publish `detectors` [B, D] bool, in any channel, in the order of `detector_names`."""
    firing = _band_pass(graph, spec, guarded, rectified)
    rows = [firing, _band_pass_point(graph, spec, firing)]
    if spec.unit == "N":
        rows.append(_friction_cone(graph, spec, guarded))
    graph.node(
        "ReduceMax",
        graph.node("Concat", *rows, axis=1),
        graph.ints(2),
        out="detectors",
        keepdims=0,
    )
    graph.output("detectors", TensorProto.BOOL, len(rows))


def _band_pass(
    graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str
) -> str:
    """[B, 1, C]: a usable shear signal is above its noise floor.

    For a channel that is not usable, the peak is its floor.
    """
    rules = spec.detectors
    quiet_peak = NOISE_RMS[spec.unit] * noise_gain(spec.rate_hz, spec.carried_bands())
    floor = graph.node("Max", graph.state("floor", 1), graph.constant(quiet_peak))
    loudest = graph.node("ReduceMax", rectified, graph.ints(1), keepdims=1)
    peak = graph.node("Where", guarded.usable, loudest, floor)
    # the normal is not shear
    ratio = np.tile([rules.band_ratio, rules.band_ratio, np.inf], spec.n_sensors)
    above = graph.node("Greater", peak, graph.node("Mul", floor, graph.constant(ratio)))
    fast = min(1.0, 1.0 / (rules.floor_tau_s * spec.rate_hz))
    rate = graph.node(
        "Where", above, graph.constant(fast * rules.firing_rate), graph.constant(fast)
    )
    clipped = graph.node(
        "Min", peak, graph.node("Mul", floor, graph.constant(rules.floor_clip))
    )
    change = graph.node("Mul", graph.node("Sub", clipped, floor), rate)
    graph.keep("floor", graph.node("Add", floor, change))
    return above


def _band_pass_point(graph: GraphBuilder, spec: StepSpec, firing: str) -> str:
    """[B, 1, C]: an excursion begins, at least `quiet_s` after the last one in any channel.

    The count of quiet samples is not limited: a float64 is exact for longer than a hand lasts.
    """
    quiet = graph.state("quiet", 1)
    fired = graph.node("ReduceMax", firing, graph.ints(2), keepdims=1)
    longer = graph.node("Add", quiet, graph.constant(1.0))
    graph.keep("quiet", graph.node("Where", fired, graph.constant(0.0), longer))
    needed = graph.constant(spec.detectors.quiet_s * spec.rate_hz)
    return graph.node("And", firing, graph.node("GreaterOrEqual", quiet, needed))


def _friction_cone(graph: GraphBuilder, spec: StepSpec, guarded: Guarded) -> str:
    """[B, 1, C] in the normal's column: |shear| > mu x normal at a usable, pressed finger."""
    rules = spec.detectors
    squares = graph.node("Mul", guarded.now, guarded.now)
    to_normal = np.kron(
        np.eye(spec.n_sensors), [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    )
    shear = graph.node("Sqrt", graph.node("MatMul", squares, graph.constant(to_normal)))
    outside = graph.node(
        "Greater", shear, graph.node("Mul", guarded.now, graph.constant(rules.friction))
    )
    least = np.tile([np.inf, np.inf, rules.min_normal_n], spec.n_sensors)
    pressed = graph.node("Greater", guarded.now, graph.constant(least))
    return graph.node("And", graph.node("And", outside, pressed), guarded.usable)
