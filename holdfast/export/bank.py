"""The band-pass filter bank of Engeberg and Meek as one stable linear state-space step.

For every shear signal and band (f_n = 10, 15 .. 55 Hz, w_n = 2 pi f_n), in parallel::

    H(s) = s * [w_n^2 / (s^2 + 2 z w_n s + w_n^2)]^2 * [w_l / (s + w_l)]
    z = 0.1,  w_l = 2 pi 75 Hz

The differentiator alone has a pole on the unit circle after the bilinear transform. It cancels the
low-pass' zero analytically, so both together are one stable section. The section is driven by the
difference of two samples, so that a large offset never enters the filter::

    u[t] = (K w_l d[t] - (w_l - K) u[t-1]) / (K + w_l),   K = 2 fs,   d[t] = x[t] - x[t-1]

Each resonator is prewarped to its nominal frequency. The bank of a signal has one shared state and
four for each band; a step is one product [1 + states] x [1 + states, states + bands].
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import RateError

BANDS_HZ = tuple(float(f) for f in range(10, 60, 5))
DAMPING = 0.1
LOW_PASS_HZ = 75.0
STATES_PER_BAND = 4
HIGHEST_SHARE = 0.46
"""Closer to half the rate, prewarping makes a band ring: 25 Hz at 50.1 Hz for 32 s."""

Array = npt.NDArray[np.float64]


def bands_for(
    rate_hz: float, bands_hz: tuple[float, ...] = BANDS_HZ
) -> tuple[float, ...]:
    """The bands below 0.46 of a sampling rate. Raises RateError if there is none."""
    carried = tuple(f for f in bands_hz if f < HIGHEST_SHARE * rate_hz)
    if not carried:
        raise RateError(
            f"{rate_hz:.4g} Hz carries none of the bands",
            cause=f"the lowest band is {min(bands_hz):g} Hz "
            f"and needs more than {min(bands_hz) / HIGHEST_SHARE:.4g} Hz",
            next_step="record faster",
        )
    return carried


def sections(rate_hz: float, band_hz: float) -> Array:
    """[3, 6] second-order sections of a band as in scipy: low-passed difference, resonators."""
    gain, feedback = _first_section(rate_hz)
    b, a = _resonator(rate_hz, band_hz)
    first = [gain, -gain, 0.0, 1.0, feedback, 0.0]
    return np.array([first, [*b, *a], [*b, *a]])


def step_matrix(rate_hz: float, bands_hz: tuple[float, ...]) -> Array:
    """[1 + S, S + bands] of one step: (d, state) -> (next state, outputs), S = 1 + 4 bands."""
    size = 1 + STATES_PER_BAND * len(bands_hz)
    identity = np.eye(1 + size)
    return np.array([_step(row[0], row[1:], rate_hz, bands_hz) for row in identity])


def noise_gain(
    rate_hz: float, bands_hz: tuple[float, ...], seconds: float = 3.0
) -> float:
    """RMS output of the loudest band for white noise of RMS 1 at the input, in 1/s.

    The number goes into the model file. It is summed row by row, because a matrix product may sum
    in another order on another processor.
    """
    matrix = step_matrix(rate_hz, bands_hz)
    size = matrix.shape[0] - 1
    state, response = np.zeros(size), []
    for difference in [1.0, -1.0] + [0.0] * math.ceil(seconds * rate_hz):
        out = (np.concatenate([[difference], state])[:, None] * matrix).sum(axis=0)
        state = out[:size]
        response.append(out[size:])
    return float(np.sqrt((np.array(response) ** 2).sum(axis=0)).max())


def _first_section(rate_hz: float) -> tuple[float, float]:
    k, low = 2.0 * rate_hz, 2.0 * math.pi * LOW_PASS_HZ
    return k * low / (k + low), (low - k) / (k + low)


def _resonator(rate_hz: float, band_hz: float) -> tuple[Array, Array]:
    """b and a of w^2 / (s^2 + 2 z w s + w^2), bilinear, prewarped to the band's frequency."""
    warped = math.tan(math.pi * band_hz / rate_hz)
    denominator = 1.0 + 2.0 * DAMPING * warped + warped**2
    b = warped**2 * np.array([1.0, 2.0, 1.0]) / denominator
    a = np.array(
        [denominator, 2.0 * (warped**2 - 1.0), 1.0 - 2.0 * DAMPING * warped + warped**2]
    )
    return b, a / denominator


def _step(
    difference: float, state: Array, rate_hz: float, bands_hz: tuple[float, ...]
) -> Array:
    """One step in the form that the matrix is derived from (transposed direct form II)."""
    gain, feedback = _first_section(rate_hz)
    u = gain * difference - feedback * state[0]
    following, outputs = [u], []
    for index, band_hz in enumerate(bands_hz):
        b, a = _resonator(rate_hz, band_hz)
        signal = u
        start = 1 + STATES_PER_BAND * index
        for s1, s2 in (state[start : start + 2], state[start + 2 : start + 4]):
            out = b[0] * signal + s1
            following += [b[1] * signal - a[1] * out + s2, b[2] * signal - a[2] * out]
            signal = out
        outputs.append(signal)
    return np.array(following + outputs)
