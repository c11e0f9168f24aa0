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
are in data/critical_points.py.) band_pass: the largest |output| over the bands of any shear
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
from holdfast.step.builder import GraphBuilder
from holdfast.step.guard import MOVED, USABLE, GuardOutputs, hysteresis
from holdfast.step.spec import NOISE_RMS, StepSpec

DAMPING = 0.1
"""z of every resonator."""
LOW_PASS_HZ = 75.0
"""Corner frequency of the low-pass that stands behind the differentiator (w_l)."""
RINGS_S = 3.0
"""A band is silent so long after an impulse."""
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


def noise_gain(rate_hz: float, bands_hz: tuple[float, ...]) -> float:
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
    impulse = [1.0, -1.0] + [0.0] * math.ceil(RINGS_S * rate_hz)
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
    """Names of the product [B, rows, C], and of what it gives [B, 1, C].

    These are 0 where a sensor is not usable. loudest: the largest size of the bands. now: the
    sample. pressed: the sample less the least normal force, "" but in N. means: for the contact
    rule, the mean and a step of the zero, none without it.
    """

    product: str
    loudest: str
    now: str
    pressed: str
    means: list[str]


def add_bank(graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs) -> BankOutputs:
    """Step all that is linear in the past of a channel, by one product.

    The normal has a bank too: separating its channels costs more than stepping it.
    """
    matrix, sizes = _linear_step(spec)
    n_states = sizes["change"]
    before = graph.state("bank", n_states)
    difference = graph.node("Sub", guarded.now, guarded.last)
    inputs = [difference, before, guarded.now, guarded.alive]
    joined = graph.node("Concat", *inputs, axis=1)

    # The matrix stands on the left: its product runs along the channels, so a batch multiplies
    # each recording by the same matrix in the same order as a recording alone.
    product = graph.node("MatMul", matrix, joined)
    # A lost sample holds the state: the last good value would read as a step of 0. A sensor without
    # a past has no difference yet. All else is of usable sensors.
    factor_of_row = np.full(len(matrix), USABLE)
    factor_of_row[:n_states] = MOVED
    factors = graph.node("Gather", guarded.factors, factor_of_row, axis=1)
    stepped = graph.node("Mul", product, factors)
    parts = graph.split(stepped, sizes)

    following = graph.node("Add", before, parts["change"])
    graph.keep("bank", graph.node("Mul", following, guarded.alive))
    return BankOutputs(
        product=product,
        loudest=graph.node("ReduceMax", parts["bands"], [1], keepdims=1),
        now=parts["usable_now"],
        pressed=parts.get("pressed", ""),
        means=[parts[name] for name in MEANS if name in parts],
    )


MEANS = ("mean", "zero_step")
"""What the contact rule reads."""


def _linear_step(spec: StepSpec) -> tuple[FloatArray, dict[str, int]]:
    """The matrix [outputs, inputs] of a step, and its outputs: how many rows each name has.

    Inputs: the difference of two samples, S states, the sample, and 1.0. Outputs: the change of S
    states, each band and its negative, the sample, in N the sample less the least normal force,
    and for the contact rule the mean and a step of the zero. The mean, the last state, is a
    low-pass m += share (x - m), in units of the root of the hysteresis of squares.
    """
    rule = spec.contact
    of_bank = step_matrix(spec.rate_hz, spec.usable_bands()).T
    n_bank = of_bank.shape[1] - 1
    # behind the bank's inputs: the mean, where there is one, the sample, and 1.0
    inputs = np.eye(1 + n_bank + (2 if rule is None else 3))
    before, now, one = inputs[1 : 1 + n_bank], inputs[[-2]], inputs[[-1]]
    bank = of_bank @ inputs[: 1 + n_bank] + GRAIN * of_bank[:, :1] * one

    bands = bank[n_bank:]
    rows = {
        "change": bank[:n_bank] - before,
        "bands": np.vstack([bands, -bands]),
        "usable_now": now,
    }
    if spec.unit == "N":
        rows["pressed"] = now - spec.detectors.min_normal_n * one
    if rule is not None:
        unit = math.sqrt(hysteresis(rule))
        share = 1.0 - math.exp(-1.0 / (rule.mean_s * spec.rate_hz))
        mean_before = inputs[[1 + n_bank]]
        mean = share / unit * now + (1.0 - share) * mean_before
        rows["change"] = np.vstack([rows["change"], mean - mean_before])
        rows["mean"] = mean
        rows["zero_step"] = mean * unit / (rule.zero_s * spec.rate_hz)
    sizes = {name: len(some) for name, some in rows.items()}
    return np.vstack(list(rows.values())), sizes


def detector_names(spec: StepSpec) -> tuple[str, ...]:
    """Columns of the `detectors` output; the cone exists only where the unit is N."""
    names = ("band_pass", "band_pass_point")
    if spec.unit == "N":
        return (*names, "friction_cone")
    return names


def add_detectors(
    graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs, bank: BankOutputs
) -> None:
    """Publish `detectors` [B, D] bool, in any channel, in the order of `detector_names`.

    Each is a number that a threshold is exceeded by, so that one comparison of the largest number
    over the channels serves all. An excursion begins at least `quiet_s` after the last one in any
    channel: it exceeds the count of quiet samples too. That count is not limited: a float64 is
    exact for longer than a hand lasts.
    """
    quiet = graph.state("quiet", 1)
    # the count before this sample: an excursion that begins now has not ended the quiet yet
    least_quiet = math.ceil(spec.detectors.quiet_s * spec.rate_hz) - 0.5
    swing = _band_pass(graph, spec, guarded, bank.loudest, least_quiet)
    numbers = [swing, graph.node("Min", swing, quiet)]
    thresholds = [least_quiet, least_quiet]
    if bank.pressed:
        numbers.append(_friction_cone(graph, spec, bank))
        thresholds.append(0.0)

    joined = graph.node("Concat", *numbers, axis=1)
    largest = graph.node("ReduceMax", joined, [2], keepdims=0)
    graph.node("Greater", largest, thresholds, out="detectors")
    graph.output("detectors", TensorProto.BOOL, len(numbers))

    fired = graph.node("Gather", "detectors", [[0]], axis=1)
    longer = graph.node("Add", quiet, 1.0)
    graph.keep("quiet", graph.node("Where", fired, 0.0, longer))


def _band_pass(
    graph: GraphBuilder,
    spec: StepSpec,
    guarded: GuardOutputs,
    loudest: str,
    threshold: float,
) -> str:
    """[B, 1, C]: above the threshold where a usable shear signal is above its noise floor.

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
    scale = threshold / (1.0 - share + share * rules.band_ratio)
    swing = graph.node("Mul", factor, np.tile([scale, scale, 0.0], spec.n_sensors))
    above = graph.node("Greater", swing, threshold)

    # Clipped, so that one loud sample cannot raise the floor for seconds. While it fires, the floor
    # almost stops: a slip must not raise its threshold.
    more = share * (rules.floor_clip - 1.0)
    clipped = graph.node("Min", factor, 1.0 + more)
    taken = graph.node("Where", above, 1.0 + more * rules.firing_rate, clipped)
    graph.keep("floor", graph.node("Mul", floor, taken))
    return swing


def _friction_cone(graph: GraphBuilder, spec: StepSpec, bank: BankOutputs) -> str:
    """[B, 1, C]: above 0 in the normal's column where a usable finger is pressed hard enough and
    |shear| > mu x normal."""
    # Squares: no root, no division by a small force. One product of whole numbers, which is exact,
    # puts the sum of those of x and y less that of mu z into the column of z, and what is never
    # above 0 into the others.
    squares = graph.node("Mul", bank.now, bank.now)
    factors = [1.0, 1.0, spec.detectors.friction**2]
    scaled = graph.node("Mul", squares, np.tile(factors, spec.n_sensors))
    of_finger = [[-1.0, 0.0, 1.0], [0.0, -1.0, 1.0], [0.0, 0.0, -1.0]]
    outside = graph.node("MatMul", scaled, np.kron(np.eye(spec.n_sensors), of_finger))
    return graph.node("Min", outside, bank.pressed)
