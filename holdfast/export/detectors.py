"""The band-pass filter bank of Engeberg and Meek, and the causal detectors of the step graph.

For every shear signal and band (f_n = 10, 15 .. 55 Hz, w_n = 2 pi f_n), in parallel::

    H(s) = s * [w_n^2 / (s^2 + 2 z w_n s + w_n^2)]^2 * [w_l / (s + w_l)]
    z = 0.1,  w_l = 2 pi 75 Hz

The differentiator alone has a pole on the unit circle after the bilinear transform. It cancels the
low-pass' zero analytically, so both together are one stable section. The section is driven by the
difference of two samples, so that a large offset never enters the filter::

    u[t] = (K w_l d[t] - (w_l - K) u[t-1]) / (K + w_l),   K = 2 fs,   d[t] = x[t] - x[t-1]

Each resonator is prewarped to its nominal frequency. The bank of a signal has one shared state and
four for each band; a step is one product [1 + states] x [1 + states, states + bands]. The mean that
contact is judged by (guard.py) is one more state of the same product.

The detectors are computed at every sample. (The critical points of training, which may look ahead,
are in training/critical_points.py.) band_pass: the largest |output| over the bands of any shear
signal exceeds a multiple of that signal's noise floor, a clipped running mean that almost stops
while the detector fires. band_pass_point: the first sample of such an excursion, after enough
quiet. friction_cone: |shear| > mu x normal at a finger with enough normal force; without a
division. Unit N only.
"""

from __future__ import annotations

import math

import numpy as np
from onnx import TensorProto

from holdfast.core.contract import FloatArray
from holdfast.export.builder import GraphBuilder
from holdfast.export.guard import GuardOutputs
from holdfast.export.spec import NOISE_RMS, ContactRule, StepSpec

DAMPING = 0.1
"""z of every resonator."""
LOW_PASS_HZ = 75.0
"""Corner frequency of the low-pass that stands behind the differentiator (w_l)."""
STATES_PER_BAND = 4
"""Two resonators of second order, in transposed direct form II."""
GRAIN = 1e-30
"""Every number in the filter moves this far towards zero: silence must not become subnormal
numbers, which are slow. Numbers from 1e-13 on stay as they are."""


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


def add_bank(
    graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs
) -> tuple[str, list[str]]:
    """Step the band-pass bank of every channel; returns |outputs| [B, bands, C], and the means.

    The normal has a bank too: separating its channels costs more than stepping it. means: for the
    contact rule, [B, 1, C] in units of its hysteresis, and as a step of the zero; none without it.
    """
    bands = spec.usable_bands()
    matrix = step_matrix(spec.rate_hz, bands)
    size = 1 + STATES_PER_BAND * len(bands)
    sizes = [size, len(bands)]
    # a Split names several outputs, which the builder does not number
    outs = ["bank_next", "bank_out"]

    rule = spec.contact
    if rule is not None:
        matrix = _with_means(matrix, size, spec.rate_hz, rule)
        size += 1
        sizes = [size, len(bands), 1, 1]
        outs += ["mean", "zero_step"]

    before = graph.state("bank", size)
    difference = graph.node("Sub", guarded.now, guarded.last)
    inputs = [difference, before]
    if rule is not None:
        inputs.append(guarded.last)

    # difference and state side by side, so that a whole step is one matrix product
    joined = graph.node("Concat", *inputs, axis=1)
    # a sensor without a past has no difference yet
    begun = graph.node("Mul", joined, guarded.begun)

    # x - clip(x) is 0 up to GRAIN, x itself from 1e-13 on, a multiple of 1e-46 in between:
    # never subnormal
    grains = graph.node("Clip", begun, -GRAIN, GRAIN)
    rested = graph.node("Sub", begun, grains)

    # The matrix stands on the left: its product runs along the channels, so a batch multiplies
    # each recording by the same matrix in the same order as a recording alone.
    stepped = graph.node("MatMul", matrix.T, rested)
    advanced, outputs, *means = graph.nodes("Split", stepped, sizes, outs=outs, axis=1)

    # a lost sample holds the state: the last good value would read as a step of 0
    following = graph.node("Where", guarded.good, advanced, before)
    graph.keep("bank", following)
    return graph.node("Abs", outputs), means


def _with_means(
    matrix: FloatArray, size: int, rate_hz: float, rule: ContactRule
) -> FloatArray:
    """The matrix [1 + S, S + bands] of a step, with the mean of the contact rule as a state.

    Inputs: difference, S states, mean, last sample. Outputs: S states, mean, bands, mean again,
    step of the zero. The mean is a low-pass m += share (x / hysteresis - m) with x = last +
    difference.
    """
    hysteresis = rule.on - rule.off
    share = 1.0 - math.exp(-1.0 / (rule.mean_s * rate_hz))
    mean = np.zeros(size + 3)
    mean[[0, size + 2]] = share / hysteresis
    mean[size + 1] = 1.0 - share
    step = mean * hysteresis / (rule.zero_s * rate_hz)

    # the two inputs more do not reach the bank
    of_bank = np.vstack([matrix, np.zeros((2, matrix.shape[1]))])
    columns = [of_bank[:, :size], mean[:, None], of_bank[:, size:]]
    return np.hstack([*columns, mean[:, None], step[:, None]])


def detector_names(spec: StepSpec) -> tuple[str, ...]:
    """Columns of the `detectors` output; the cone exists only where the unit is N."""
    names = ("band_pass", "band_pass_point")
    if spec.unit == "N":
        return (*names, "friction_cone")
    return names


def add_detectors(
    graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs, rectified: str
) -> None:
    """Publish `detectors` [B, D] bool, in any channel, in the order of `detector_names`."""
    firing = _band_pass(graph, spec, guarded, rectified)
    point = _band_pass_point(graph, spec, firing)
    rows = [firing, point]
    if spec.unit == "N":
        rows.append(_friction_cone(graph, spec, guarded))

    # each row [B, 1, C] has its flags in the columns of its channels; one "any" serves all rows
    joined = graph.node("Concat", *rows, axis=1)
    graph.node("ReduceMax", joined, [2], out="detectors", keepdims=0)
    graph.output("detectors", TensorProto.BOOL, len(rows))


def _band_pass(
    graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs, rectified: str
) -> str:
    """[B, 1, C]: a usable shear signal is above its noise floor.

    For a channel that is not usable, the peak is its floor.
    """
    rules = spec.detectors
    gain = noise_gain(spec.rate_hz, spec.usable_bands())
    quiet_peak = NOISE_RMS[spec.unit] * gain

    # a fresh state is 0, and a channel can be quieter than the sensor's noise for a while
    before = graph.state("floor", 1)
    floor = graph.node("Max", before, quiet_peak)
    loudest = graph.node("ReduceMax", rectified, [1], keepdims=1)
    peak = graph.node("Where", guarded.usable, loudest, floor)

    # the normal is not shear
    ratio = np.tile([rules.band_ratio, rules.band_ratio, np.inf], spec.n_sensors)
    threshold = graph.node("Mul", floor, ratio)
    above = graph.node("Greater", peak, threshold)

    # while it fires, the floor almost stops: a slip must not raise its threshold
    # A running mean with this time constant moves by this share of the distance at each sample.
    fast = min(1.0, 1.0 / (rules.floor_tau_s * spec.rate_hz))
    slow = fast * rules.firing_rate
    # a look-up costs less than a choice
    is_above = graph.node("Cast", above, to=TensorProto.INT64)
    rate = graph.node("Gather", [fast, slow], is_above)

    # clipped, so that one loud sample cannot raise the floor for seconds
    most = graph.node("Mul", floor, rules.floor_clip)
    clipped = graph.node("Min", peak, most)
    distance = graph.node("Sub", clipped, floor)
    change = graph.node("Mul", distance, rate)
    following = graph.node("Add", floor, change)
    graph.keep("floor", following)
    return above


def _band_pass_point(graph: GraphBuilder, spec: StepSpec, firing: str) -> str:
    """[B, 1, C]: an excursion begins, at least `quiet_s` after the last one in any channel.

    The count of quiet samples is not limited: a float64 is exact for longer than a hand lasts.
    """
    quiet = graph.state("quiet", 1)
    fired = graph.node("ReduceMax", firing, [2], keepdims=1)
    longer = graph.node("Add", quiet, 1.0)
    following = graph.node("Where", fired, 0.0, longer)
    graph.keep("quiet", following)

    # the count before this sample: an excursion that begins now has not ended the quiet yet
    needed = spec.detectors.quiet_s * spec.rate_hz
    enough = graph.node("GreaterOrEqual", quiet, needed)

    return graph.node("And", firing, enough)


def _friction_cone(graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs) -> str:
    """[B, 1, C] in the normal's column: |shear| > mu x normal at a usable, pressed finger."""
    rules = spec.detectors

    # shear > mu x normal instead of shear / normal > mu: no division by a small force
    squares = graph.node("Mul", guarded.now, guarded.now)
    # One product adds the squares of x and y and puts the sum into the column of z.
    shear_to_normal = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    matrix = np.kron(np.eye(spec.n_sensors), shear_to_normal)
    squared_shear = graph.node("MatMul", squares, matrix)
    shear = graph.node("Sqrt", squared_shear)
    most = graph.node("Mul", guarded.now, rules.friction)
    outside = graph.node("Greater", shear, most)

    # in the columns of shear, no force is enough
    least = np.tile([np.inf, np.inf, rules.min_normal_n], spec.n_sensors)
    pressed = graph.node("Greater", guarded.now, least)

    slips = graph.node("And", outside, pressed)
    return graph.node("And", slips, guarded.usable)
