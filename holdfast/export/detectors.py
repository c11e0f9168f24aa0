"""The band-pass filter bank of Engeberg and Meek, and the causal detectors of the step graph.

For every shear signal and band (f_n = 10, 15 .. 55 Hz, w_n = 2 pi f_n), in parallel::

    H(s) = s * [w_n^2 / (s^2 + 2 z w_n s + w_n^2)]^2 * [w_l / (s + w_l)]
    z = 0.1,  w_l = 2 pi 75 Hz

The differentiator alone has a pole on the unit circle after the bilinear transform. It cancels the
low-pass' zero analytically, so both together are one stable section. The section is driven by the
difference of two samples, so that a large offset never enters the filter::

    u[t] = (K w_l d[t] - (w_l - K) u[t-1]) / (K + w_l),   K = 2 fs,   d[t] = x[t] - x[t-1]

Each resonator is prewarped to its nominal frequency. The bank of a signal has one shared state and
four for each band. One product steps all that is linear in the past of a channel: the bank, and the
mean that contact is judged by (guard.py).

The detectors are computed at every sample. (The critical points of training, which may look ahead,
are in training/critical_points.py.) band_pass: the largest |output| over the bands of any shear
signal exceeds a multiple of that signal's noise floor, a clipped running mean that almost stops
while the detector fires. band_pass_point: the first sample of such an excursion, after enough
quiet. friction_cone: |shear| > mu x normal at a finger with enough normal force; without a
division. Unit N only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from onnx import TensorProto

from holdfast.core.contract import FloatArray
from holdfast.export.builder import GraphBuilder
from holdfast.export.guard import GuardOutputs
from holdfast.export.spec import NOISE_RMS, StepSpec

DAMPING = 0.1
"""z of every resonator."""
LOW_PASS_HZ = 75.0
"""Corner frequency of the low-pass that stands behind the differentiator (w_l)."""
STATES_PER_BAND = 4
"""Two resonators of second order, in transposed direct form II."""
GRAIN = 1e-100
"""The difference of two samples is this much more than it is: silence must not become subnormal
numbers, which are slow. float32 and the rounding of any reading know nothing so small."""


def sections(rate_hz: float, band_hz: float) -> FloatArray:
    """[3, 6] second-order sections of a band as in scipy: low-passed difference, resonators."""
    gain, feedback = _first_section(rate_hz)
    b, a = _resonator(rate_hz, band_hz)
    first = [gain, -gain, 0.0, 1.0, feedback, 0.0]
    resonator = [*b, *a]
    return np.array([first, resonator, resonator])


def _first_section(rate_hz: float) -> tuple[float, float]:
    """(gain, feedback) of the low-passed difference."""
    k = 2.0 * rate_hz
    low = 2.0 * math.pi * LOW_PASS_HZ
    total = k + low
    return k * low / total, (low - k) / total


def _resonator(rate_hz: float, band_hz: float) -> tuple[FloatArray, FloatArray]:
    """b and a of w^2 / (s^2 + 2 z w s + w^2), bilinear, prewarped to the band's frequency."""
    # without the tangent, the bilinear transform would move the band towards lower frequencies
    warped = math.tan(math.pi * band_hz / rate_hz)
    denominator = 1.0 + 2.0 * DAMPING * warped + warped**2
    b = warped**2 * np.array([1.0, 2.0, 1.0]) / denominator
    a_1 = 2.0 * (warped**2 - 1.0)
    a_2 = 1.0 - 2.0 * DAMPING * warped + warped**2
    return b, np.array([denominator, a_1, a_2]) / denominator


def step_matrix(rate_hz: float, bands_hz: tuple[float, ...]) -> FloatArray:
    """[1 + S, S + bands] of one step: (d, state) -> (next state, outputs), S = 1 + 4 bands."""
    # A step is linear, so the answers to unit vectors are the rows of its matrix. A unit vector
    # is the difference, the state of the first section, and the states of the bands.
    rows = []
    for vector in np.eye(2 + STATES_PER_BAND * len(bands_hz)):
        difference = vector[0]
        state = vector[1:]
        rows.append(_step(difference, state, rate_hz, bands_hz))

    return np.array(rows)


def _step(
    difference: float, state: FloatArray, rate_hz: float, bands_hz: tuple[float, ...]
) -> FloatArray:
    """One step in the form that the matrix is derived from (transposed direct form II)."""
    gain, feedback = _first_section(rate_hz)
    u = gain * difference - feedback * state[0]
    following = [u]
    outputs = []

    for index, band_hz in enumerate(bands_hz):
        b, a = _resonator(rate_hz, band_hz)
        signal = u
        start = 1 + STATES_PER_BAND * index
        # both resonators of a band are the same section, one after the other
        for at in (start, start + 2):
            out = b[0] * signal + state[at]
            following.append(b[1] * signal - a[1] * out + state[at + 1])
            following.append(b[2] * signal - a[2] * out)
            signal = out
        outputs.append(signal)

    return np.array(following + outputs)


def noise_gain(
    rate_hz: float, bands_hz: tuple[float, ...], seconds: float = 3.0
) -> float:
    """RMS output of the loudest band for white noise of RMS 1 at the input, in 1/s.

    The number goes into the model file. It is summed row by row, because a matrix product may sum
    in another order on another processor.
    """
    matrix = step_matrix(rate_hz, bands_hz)
    size = matrix.shape[0] - 1

    # The response to one impulse at rest tells all of a linear filter.
    state = np.zeros(size)
    response = []
    # the bank is driven by differences: an impulse of 1 goes up and comes down again
    impulse = [1.0, -1.0] + [0.0] * math.ceil(seconds * rate_hz)
    for difference in impulse:
        row = np.concatenate([[difference], state])
        out = (row[:, None] * matrix).sum(axis=0)
        state = out[:size]
        response.append(out[size:])

    # white noise of RMS 1 leaves a filter with the root of the energy of its impulse response
    energy = (np.array(response) ** 2).sum(axis=0)
    return float(np.sqrt(energy).max())


@dataclass(frozen=True)
class BankOutputs:
    """Names of what the product gives. rectified: [B, rows, C], outputs, negatives, and rows more.

    Each [B, 1, C], and 0 where the sensor is not usable: loudest, the largest of the rectified
    ones; now, the sample; means, for the contact rule, the mean and a step of the zero, none
    without it.
    """

    rectified: str
    loudest: str
    now: str
    means: list[str]


def add_bank(graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs) -> BankOutputs:
    """Step all that is linear in the past of a channel, by one product.

    The normal has a bank too: separating its channels costs more than stepping it.
    """
    bands = len(spec.usable_bands())
    matrix, n_states = _linear_step(spec)
    before = graph.state("bank", n_states)
    difference = graph.node("Sub", guarded.now, guarded.last)
    inputs = [difference, before, guarded.now, guarded.moved]
    joined = graph.node("Concat", *inputs, axis=1)

    # The matrix stands on the left: its product runs along the channels, so a batch multiplies
    # each recording by the same matrix in the same order as a recording alone.
    product = graph.node("MatMul", matrix, joined)
    # A lost sample holds the state: the last good value would read as a step of 0. A sensor without
    # a past has no difference yet.
    stepped = graph.node("Mul", product, guarded.moved)
    n_means = 0 if spec.contact is None else 2
    sizes = [n_states, 2 * bands + 1 + n_means]
    change, heard = graph.split(stepped, sizes, ["change", "heard"])
    following = graph.node("Add", before, change)
    graph.keep("bank", graph.node("Mul", following, guarded.alive))

    counted = graph.node("Mul", heard, guarded.usable)
    sizes = [2 * bands, *[1] * (1 + n_means)]
    names = ["bands", "usable_now", "mean", "zero_step"][: len(sizes)]
    swings, now, *means = graph.split(counted, sizes, names)
    loudest = graph.node("ReduceMax", swings, [1], keepdims=1)
    return BankOutputs(heard, loudest, now, means)


def _linear_step(spec: StepSpec) -> tuple[FloatArray, int]:
    """The matrix [outputs, inputs] of a step, and the number S of its states.

    Inputs: the difference of two samples, S states, the sample, and 1.0. Outputs: the change of S
    states, each band and its negative, the sample, and for the contact rule the mean and a step of
    the zero. The mean, the last state, is a low-pass m += share (x / hysteresis - m).
    """
    rule = spec.contact
    bank = step_matrix(spec.rate_hz, spec.usable_bands()).T
    n_states = bank.shape[1] - 1
    # behind the bank's inputs: the mean, where there is one, the sample, and 1.0
    more = 2 if rule is None else 3
    bank = np.pad(bank, ((0, 0), (0, more)))
    bank[:, -1] = GRAIN * bank[:, 0]
    of_bank, bands = bank[:n_states], bank[n_states:]
    change = of_bank - np.eye(n_states, bank.shape[1], k=1)
    now = np.eye(1, bank.shape[1], k=bank.shape[1] - 2)
    if rule is None:
        return np.vstack([change, bands, -bands, now]), n_states

    hysteresis = rule.on - rule.off
    share = 1.0 - math.exp(-1.0 / (rule.mean_s * spec.rate_hz))
    before = np.eye(1, bank.shape[1], k=1 + n_states)
    mean = share / hysteresis * now + (1.0 - share) * before
    step = mean * hysteresis / (rule.zero_s * spec.rate_hz)
    rows = [change, mean - before, bands, -bands, now, mean, step]
    return np.vstack(rows), n_states + 1


def detector_names(spec: StepSpec) -> tuple[str, ...]:
    """Columns of the `detectors` output; the cone exists only where the unit is N."""
    names = ("band_pass", "band_pass_point")
    if spec.unit == "N":
        return (*names, "friction_cone")
    return names


def add_detectors(
    graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs, bank: BankOutputs
) -> None:
    """Publish `detectors` [B, D] bool, in any channel, in the order of `detector_names`."""
    firing = _band_pass(graph, spec, guarded, bank.loudest)
    point = _band_pass_point(graph, spec, firing)
    rows = [firing, point]
    if spec.unit == "N":
        rows.append(_friction_cone(graph, spec, bank.now))

    # each row [B, 1, C] has its flags in the columns of its channels; one "any" serves all rows
    joined = graph.node("Concat", *rows, axis=1)
    graph.node("ReduceMax", joined, [2], out="detectors", keepdims=0)
    graph.output("detectors", TensorProto.BOOL, len(rows))


def _band_pass(
    graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs, loudest: str
) -> str:
    """[B, 1, C]: a usable shear signal is above its noise floor.

    The state is the floor over `floor_share`, s: so loudest / state is s x ratio, and the floor is
    multiplied by 1 - s + s x ratio at each sample, by 1 where the sensor is not usable.
    """
    rules = spec.detectors
    share = spec.floor_share
    quiet_peak = NOISE_RMS[spec.unit] * noise_gain(spec.rate_hz, spec.usable_bands())

    # a fresh state is 0, and a channel can be quieter than the sensor's noise for a while
    before = graph.state("floor", 1)
    floor = graph.node("Max", before, quiet_peak / share)
    ratio = graph.node("Div", loudest, floor)
    factor = graph.node("Add", ratio, guarded.still)

    # the normal is not shear
    ratios = np.tile([rules.band_ratio, rules.band_ratio, np.inf], spec.n_sensors)
    above = graph.node("Greater", factor, 1.0 - share + share * ratios)

    # Clipped, so that one loud sample cannot raise the floor for seconds. While it fires, the floor
    # almost stops: a slip must not raise its threshold.
    more = share * (rules.floor_clip - 1.0)
    clipped = graph.node("Min", factor, 1.0 + more)
    taken = graph.node("Where", above, 1.0 + more * rules.firing_rate, clipped)
    graph.keep("floor", graph.node("Mul", floor, taken))
    return above


def _band_pass_point(graph: GraphBuilder, spec: StepSpec, firing: str) -> str:
    """[B, 1, C]: an excursion begins, at least `quiet_s` after the last one in any channel.

    The count of quiet samples is not limited: a float64 is exact for longer than a hand lasts.
    """
    quiet = graph.state("quiet", 1)
    fired = graph.node("ReduceMax", firing, [2], keepdims=1)
    longer = graph.node("Add", quiet, 1.0)
    graph.keep("quiet", graph.node("Where", fired, 0.0, longer))

    # the count before this sample: an excursion that begins now has not ended the quiet yet
    needed = spec.detectors.quiet_s * spec.rate_hz
    enough = graph.node("GreaterOrEqual", quiet, needed)
    return graph.node("And", firing, enough)


def _friction_cone(graph: GraphBuilder, spec: StepSpec, now: str) -> str:
    """[B, 1, C] in the normal's column: |shear| > mu x normal at a usable, pressed finger."""
    rules = spec.detectors

    # Squares: no root, no division by a small force. One product puts the sum of those of x and y
    # into the column of z.
    squares = graph.node("Mul", now, now)
    to_normal = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    shear = graph.node("MatMul", squares, np.kron(np.eye(spec.n_sensors), to_normal))
    most = graph.node("Mul", squares, rules.friction**2)
    outside = graph.node("Greater", shear, most)

    # in the columns of shear, no force is enough
    least = np.tile([np.inf, np.inf, rules.min_normal_n], spec.n_sensors)
    pressed = graph.node("Greater", now, least)
    return graph.node("And", outside, pressed)
