"""What the baselines compare with their settings, sample by sample or window by window.

Guard and filter bank of the classical detectors do not depend on a threshold, so the graph steps
them once. The laws that have a threshold follow here, with the same operations in the same order:
they fire at the very samples at which the `detectors` of a graph with that setting do (a test
compares them). The shear rate needs no graph of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from onnx import TensorProto

from holdfast.core.contract import NORMAL_AXIS, BoolArray, FloatArray
from holdfast.data.recording import Recording
from holdfast.edge_runtime.graph import BATCH, open_session, steps_of
from holdfast.evaluation.model_outputs import everywhere
from holdfast.step.builder import GraphBuilder
from holdfast.step.detectors import add_bank, noise_gain
from holdfast.step.guard import USABLE, add_guard
from holdfast.step.spec import NOISE_RMS, StepSpec

OUTPUTS = ("loudest", "now", "usable")
NARROW = 2048
"""Signals times settings that numpy steps in about the time of one."""
BACK_SAMPLES = 2
"""The shear-rate threshold: samples back to the summed shear that the newest is compared with."""


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
    # The same graph nodes as in the model: the guard must hide the same lost samples.
    steps = steps_of(open_session(_signals_graph(spec)), OUTPUTS)
    signals = []
    for out in everywhere(steps, recordings):
        loudest = out["loudest"][:, 0]
        now = out["now"][:, 0]
        usable = out["usable"][:, 0]
        # Friction and vibration act along the skin: the bank listens to the shear axes only.
        is_shear = np.arange(now.shape[1]) % 3 != NORMAL_AXIS
        x = now[:, 0::3]
        y = now[:, 1::3]
        signals.append(
            DetectorSignals(
                loudest=loudest[:, is_shear],
                shear_usable=usable[:, is_shear],
                shear=np.sqrt(x * x + y * y),
                normal=now[:, NORMAL_AXIS::3],
                usable=usable[:, NORMAL_AXIS::3],
            )
        )

    return signals


class _ShortPast(StepSpec, frozen=True):
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
    graph = GraphBuilder(spec.n_sensors)
    spec = _ShortPast(**{**msgspec.structs.asdict(spec), "force_decides": False})
    # The bank reads the newest sample only; a short past makes the state, and the step, small.
    guarded = add_guard(graph, spec)
    bank = add_bank(graph, spec, guarded)
    graph.node("Identity", bank.loudest, out="loudest")
    graph.node("Identity", guarded.now, out="now")
    usable = graph.node("Gather", guarded.factors, [USABLE], axis=1)
    graph.node("Cast", usable, out="usable", to=TensorProto.BOOL)

    # Double precision: the thresholds are compared as the detectors of the model compare them.
    graph.output("loudest", TensorProto.DOUBLE, 1, graph.n_channels)
    graph.output("now", TensorProto.DOUBLE, 1, graph.n_channels)
    graph.output("usable", TensorProto.BOOL, 1, graph.n_channels)
    return bytes(graph.model().SerializeToString())


def cone_fires(spec: StepSpec, of: DetectorSignals, friction: float) -> BoolArray:
    """[T] whether some usable finger, pressed hard enough, leaves the cone of this friction."""
    # A product instead of a ratio: no division by a normal force near 0.
    outside = of.shear > of.normal * friction
    # A finger that barely touches has a large ratio of two small numbers.
    pressed = of.normal > spec.detectors.min_normal_n
    return np.asarray((outside & pressed & of.usable).any(axis=1))


def band_pass_fires(
    signals: Sequence[DetectorSignals], spec: StepSpec, ratios: Sequence[float]
) -> list[list[BoolArray]]:
    """Setting -> recording -> [T] whether some usable shear signal exceeds ratio x its noise floor.

    The floor follows the signal and depends on the ratio, so it is stepped for each of them.
    """
    # Recordings of about the same length are stepped together, so little is padded.
    lengths = [len(one.loudest) for one in signals]
    # The longest recording of a batch decides how many rows all of it takes.
    order = sorted(range(len(signals)), key=lengths.__getitem__)
    by_recording: dict[int, BoolArray] = {}
    for first in range(0, len(order), BATCH):
        places = order[first : first + BATCH]
        batch = [signals[k] for k in places]

        stepped = _step_floors(batch, _Floor.of(spec), np.asarray(ratios))
        for column, (k, one) in enumerate(zip(places, batch, strict=True)):
            # A copy, so that the padded array of the whole batch can be freed.
            by_recording[k] = stepped[: len(one.loudest), :, column].copy()

    fires = []
    for place in range(len(ratios)):
        # Back in the order of the recordings.
        at_ratio = [by_recording[k][:, place] for k in range(len(signals))]
        fires.append(at_ratio)

    return fires


def is_narrow(signals: Sequence[DetectorSignals], n_settings: int) -> bool:
    """Whether all settings are stepped together in about the time of one: few long recordings."""
    n_signals = sum(one.loudest.shape[1] for one in signals)
    return n_settings * n_signals <= NARROW


@dataclass(frozen=True)
class _Floor:
    """Constants of the noise floor: its least value, its rates while quiet and firing, its clip."""

    least: float
    rates: FloatArray
    clip: float

    @staticmethod
    def of(spec: StepSpec) -> _Floor:
        rules = spec.detectors
        # The floor never falls below what the chip's own noise leaves in a band.
        least = NOISE_RMS[spec.unit] * noise_gain(spec.rate_hz, spec.usable_bands())
        # First-order smoothing: a share of 1 / tau of each new sample enters the floor.
        tau_samples = rules.floor_tau_s * spec.rate_hz
        fast = min(1.0, 1.0 / tau_samples)
        # While it fires the floor follows slowly, so that a slip does not become its own noise.
        rates = np.array([fast, fast * rules.firing_rate])
        return _Floor(least, rates, rules.floor_clip)


def _step_floors(
    batch: Sequence[DetectorSignals], constants: _Floor, ratios: FloatArray
) -> BoolArray:
    """[T, R, B] whether any signal of B recordings exceeds its floor times each of the ratios [R].

    A recording is silent after its end.
    """
    n_rows = max(len(one.loudest) for one in batch)
    n_signals = batch[0].loudest.shape[1]
    shape = (n_rows, len(batch), n_signals)
    loudest = np.zeros(shape)
    usable = np.zeros(shape, dtype=np.bool_)
    for k, one in enumerate(batch):
        # Padding is never usable, so it fires nowhere.
        loudest[: len(one.loudest), k] = one.loudest
        usable[: len(one.loudest), k] = one.shear_usable

    fires = np.empty((n_rows, len(ratios), len(batch)), dtype=np.bool_)
    ratio = ratios[:, None, None]

    per_ratio = (len(ratios), len(batch), n_signals)
    floor = np.zeros(per_ratio)
    peak = np.zeros(per_ratio)
    limit = np.zeros(per_ratio)
    # In place: this is the loop that an evaluation spends most of its time in.
    for t in range(n_rows):
        np.maximum(floor, constants.least, out=floor)
        # A signal that is not usable equals its floor: it neither fires nor moves it.
        np.copyto(peak, floor)
        np.copyto(peak, loudest[t], where=usable[t])
        above = peak > np.multiply(floor, ratio, out=limit)
        above.any(axis=2, out=fires[t])

        # Clipped, so that one loud sample cannot lift the floor far.
        np.minimum(peak, np.multiply(floor, constants.clip, out=limit), out=peak)
        # From here on `peak` is what is still missing to the signal, and moves the floor by its
        # share.
        peak -= floor
        peak *= constants.rates[above.view(np.int8)]
        floor += peak

    return fires


def shear_change(samples: FloatArray) -> FloatArray:
    """[T, C] -> [T] change of the summed shear within two samples; 0 at the start."""
    by_sensor = samples.reshape(len(samples), -1, 3)
    shear_axes = by_sensor[..., :NORMAL_AXIS]
    shear = np.abs(shear_axes).sum(axis=(1, 2))

    jump = np.zeros(len(samples))
    now = shear[BACK_SAMPLES:]
    before = shear[:-BACK_SAMPLES]
    jump[BACK_SAMPLES:] = np.abs(now - before)
    return jump
