"""The classical detectors at many settings, from one pass of the step graph.

Guard and filter bank do not depend on a threshold, so the graph steps them once. The laws that have
a threshold follow here, with the same operations in the same order: they fire at the very samples
at which the `detectors` of a graph with that setting do (a test compares them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from onnx import TensorProto

from holdfast.core.contract import (
    NORMAL_AXIS,
    BoolArray,
    FloatArray,
)
from holdfast.edge_runtime.graph import BATCH, open_session, steps_of
from holdfast.evaluation.model_outputs import everywhere
from holdfast.export.builder import GraphBuilder
from holdfast.export.detectors import add_bank, noise_gain
from holdfast.export.guard import add_guard
from holdfast.export.spec import NOISE_RMS, StepSpec
from holdfast.training.recording import Recording

OUTPUTS = ("loudest", "now", "usable")


NARROW = 2048
"""Signals times settings that numpy steps in about the time of one."""


@dataclass(frozen=True)
class DetectorSignals:
    """What the detectors of one recording compare with their thresholds.

    loudest [T, 2 S]: the largest rectified band of each shear channel, unit per second. shear,
    normal [T, S]: of each sensor, guarded. shear_usable [T, 2 S], usable [T, S].
    """

    loudest: FloatArray
    shear_usable: BoolArray
    shear: FloatArray
    normal: FloatArray
    usable: BoolArray


def detector_signals(
    spec: StepSpec, recordings: Sequence[Recording]
) -> list[DetectorSignals]:
    """Step guard and bank over every recording, each from a fresh state."""
    steps = steps_of(open_session(_signals_graph(spec)), OUTPUTS)
    return [
        _signals(*(out[name][:, 0] for name in OUTPUTS))
        for out in everywhere(steps, recordings)
    ]


class _ShortPast(StepSpec):
    """The same step without the 0.5 s of samples that only features read."""

    @property
    def history_samples(self) -> int:
        """The fewest that the guard can keep."""
        return 3

    @property
    def settle_samples(self) -> int:
        """A sensor settles as long as with the whole history."""
        return super().history_samples + 1


def _signals_graph(spec: StepSpec) -> bytes:
    graph, spec = GraphBuilder(spec.n_sensors), _ShortPast(**vars(spec))
    guarded = add_guard(graph, spec)
    rectified = add_bank(graph, spec, guarded)
    graph.node("ReduceMax", rectified, graph.ints(1), out="loudest", keepdims=1)
    graph.node("Identity", guarded.now, out="now")
    graph.node("Identity", guarded.usable, out="usable")
    graph.output("loudest", TensorProto.DOUBLE, 1, graph.n_channels)
    graph.output("now", TensorProto.DOUBLE, 1, graph.n_channels)
    graph.output("usable", TensorProto.BOOL, 1, graph.n_channels)
    return bytes(graph.model().SerializeToString())


def _signals(
    loudest: FloatArray, now: FloatArray, usable: BoolArray
) -> DetectorSignals:
    is_shear = np.arange(now.shape[1]) % 3 != NORMAL_AXIS
    x, y = now[:, 0::3], now[:, 1::3]
    return DetectorSignals(
        loudest[:, is_shear],
        usable[:, is_shear],
        np.sqrt(x * x + y * y),
        now[:, NORMAL_AXIS::3],
        usable[:, NORMAL_AXIS::3],
    )


def cone_fires(one: DetectorSignals, spec: StepSpec, friction: float) -> BoolArray:
    """[T] whether some usable finger, pressed hard enough, leaves the cone of this friction."""
    outside = one.shear > one.normal * friction
    pressed = one.normal > spec.detectors.min_normal_n
    return np.asarray((outside & pressed & one.usable).any(axis=1))


def band_pass_fires(
    signals: Sequence[DetectorSignals], spec: StepSpec, ratios: Sequence[float]
) -> list[list[BoolArray]]:
    """Setting -> recording -> [T] whether some usable shear signal exceeds ratio x its noise floor.

    The floor follows the signal and depends on the ratio, so it is stepped for each of them.
    """
    fires: list[list[BoolArray]] = [[] for _ in ratios]
    order = sorted(range(len(signals)), key=lambda k: len(signals[k].loudest))
    for first in range(0, len(order), BATCH):
        batch = [signals[k] for k in order[first : first + BATCH]]
        stepped = _step_floors(*_padded(batch), _Floor.of(spec), np.asarray(ratios))
        for place in range(len(ratios)):
            fires[place] += [
                stepped[: len(one.loudest), place, k].copy()
                for k, one in enumerate(batch)
            ]
    back = np.argsort(order)
    return [[of_setting[k] for k in back] for of_setting in fires]


def is_narrow(signals: Sequence[DetectorSignals], n_settings: int) -> bool:
    """Whether all settings are stepped together in about the time of one: few long recordings."""
    return n_settings * sum(one.loudest.shape[1] for one in signals) <= NARROW


@dataclass(frozen=True)
class _Floor:
    """Constants of the noise floor: its least value, its rates while quiet and firing, its clip."""

    least: float
    rates: FloatArray
    clip: float

    @staticmethod
    def of(spec: StepSpec) -> _Floor:
        rules = spec.detectors
        fast = min(1.0, 1.0 / (rules.floor_tau_s * spec.rate_hz))
        return _Floor(
            NOISE_RMS[spec.unit] * noise_gain(spec.rate_hz, spec.carried_bands()),
            np.array([fast, fast * rules.firing_rate]),
            rules.floor_clip,
        )


def _padded(batch: Sequence[DetectorSignals]) -> tuple[FloatArray, BoolArray]:
    """loudest and usable [T, B, 2 S], silent after a recording's end."""
    shape = (
        max(len(one.loudest) for one in batch),
        len(batch),
        batch[0].loudest.shape[1],
    )
    loudest, usable = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
    for k, one in enumerate(batch):
        loudest[: len(one.loudest), k] = one.loudest
        usable[: len(one.loudest), k] = one.shear_usable
    return loudest, usable


def _step_floors(
    loudest: FloatArray, usable: BoolArray, constants: _Floor, ratios: FloatArray
) -> BoolArray:
    """[T, R, B] whether any signal [T, B, C] exceeds its floor times each of the ratios [R]."""
    fires = np.empty((len(loudest), len(ratios), loudest.shape[1]), dtype=np.bool_)
    ratio = ratios[:, None, None]
    floor, peak, limit = (np.zeros((len(ratios), *loudest.shape[1:])) for _ in range(3))
    for t in range(len(loudest)):
        np.maximum(floor, constants.least, out=floor)
        np.copyto(peak, floor)
        np.copyto(peak, loudest[t], where=usable[t])
        above = peak > np.multiply(floor, ratio, out=limit)
        above.any(axis=2, out=fires[t])
        np.minimum(peak, np.multiply(floor, constants.clip, out=limit), out=peak)
        peak -= floor
        peak *= constants.rates[above.view(np.int8)]
        floor += peak
    return fires
