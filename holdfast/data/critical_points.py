"""Recordings -> critical points, the second of four steps, OFFLINE: these functions look ahead.

Nothing here may run on a hand; the causal detectors that do are in `export`. Two methods look for
the moment at which a grip changes:

band-pass  slip rings. Engeberg and Meek's bank, H(s) = s [wn^2 / (s^2 + 2 z wn s + wn^2)]^2 [wl /
           (s + wl)], ten bands on every shear channel; the largest rectified band against the
           recording's own noise.
friction   the ratio of shear to normal force jumps, and the force itself has moved a moment later.

Every rule is in seconds and every threshold is relative to the recording itself, so that one
setting serves all objects, rates and units.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from holdfast.core.contract import NORMAL_AXIS, BoolArray, FloatArray, IntArray
from holdfast.data.recording import Recording, runs_of
from holdfast.step.detectors import sections
from holdfast.step.spec import bands_for

PointMethod = Literal["band-pass", "friction", "both"]

NOISE_TIMES = 6.0  # a point stands this far above the median of its signal
LEAST_SHARE = 0.02  # of the recording's largest swing, where there is no noise
REST_S = 0.1  # unloaded start, the zero of all forces
EDGE_S = 1.0  # ignored at both ends: filters settle, hands come and go
RECOVERY_S = 0.3  # quiet between two excursions of one signal
BAND_PASS_APART_S = 0.6
STEP_S = 0.02  # the ratio's jump is taken over this time
LEAST_JUMP = 0.1  # of the friction ratio, dimensionless
NORMAL_JUMP = 5.0  # times stricter where only the normal force moved
SHEAR_AHEAD_S = 0.3
NORMAL_AHEAD_S = 0.1  # to both sides: 0.2 s in all
FRICTION_APART_S = 0.5
FUSED_APART_S = 0.5


@dataclass(frozen=True)
class CriticalPoint:
    """A moment at which a grip changes. source: the method that detected it, or both."""

    row: int
    t_s: float
    source: PointMethod


def offline_critical_points(recording: Recording) -> list[CriticalPoint]:
    """Both methods or-ed, in order of time: the first of any 0.5 s, none within 1 s of either end.

    Raises RateError where the rate carries no band.
    """
    rate_hz = recording.rate_hz
    # Filters and quotients would carry a lost value on, so it is held before anything else.
    held = _held(recording.samples, recording.valid)
    # The median of the rest: a single bad row of the unloaded start does not move the zero.
    samples = held - np.median(held[: _rows(REST_S, rate_hz)], axis=0)
    by_band = band_pass_rows(samples, rate_hz)
    by_friction = friction_rows(samples, rate_hz)

    apart = _rows(FUSED_APART_S, rate_hz)
    rows = _first_of_any(np.union1d(by_band, by_friction), apart)
    points = []
    for row in rows.tolist():
        source = _source(row, by_band, by_friction, apart)
        points.append(CriticalPoint(row, row / rate_hz, source))
    return points


def band_pass_envelope(samples: FloatArray, rate_hz: float) -> FloatArray:
    """[T, C] -> [T, 2 C / 3] largest |output| over the bands of each shear channel, unit/s.

    Each channel has a separate state, settled at its first value, which starts afresh with every
    call.
    """
    from scipy.signal import sosfilt  # here, because its import takes a second

    shear = np.delete(samples, np.s_[NORMAL_AXIS::3], axis=1)
    # Only changes enter the bank: it starts at rest and does not ring with an offset.
    changes = shear - shear[0]
    outputs = []
    for band in bands_for(rate_hz):
        output = sosfilt(sections(rate_hz, band), changes, axis=0)
        outputs.append(output)

    # Each band answers to its own frequency; the largest answer is kept, since any of them is a
    # sign.
    return np.abs(outputs).max(axis=0)


def band_pass_rows(samples: FloatArray, rate_hz: float) -> IntArray:
    """Rows at which a shear channel rises above its noise: the first of any 0.6 s."""
    envelope = band_pass_envelope(samples, rate_hz)

    # A slip is rare, so the median of the envelope is the noise of its channel.
    noise = NOISE_TIMES * np.median(envelope, axis=0)
    # A made recording may have no noise at all; then a share of its largest swing counts.
    least = LEAST_SHARE * envelope.max()
    above = envelope > np.maximum(noise, least)

    quiet = _rows(RECOVERY_S, rate_hz)
    edges = np.concatenate([_fresh_edges(channel, quiet) for channel in above.T])
    rows = _inside(np.unique(edges), len(samples), rate_hz)
    return _first_of_any(rows, _rows(BAND_PASS_APART_S, rate_hz))


def _fresh_edges(above: BoolArray, quiet: int) -> IntArray:
    """First rows of the excursions that begin at least `quiet` rows after the one before ended."""
    starts, stops = runs_of(above)
    # The bank rings on: an excursion right after another is the same event.
    fresh = np.ones(len(starts), dtype=np.bool_)
    pauses = starts[1:] - stops[:-1]
    fresh[1:] = pauses >= quiet
    return starts[fresh]


def friction_rows(samples: FloatArray, rate_hz: float) -> IntArray:
    """Rows where a sensor's shear-to-normal ratio jumps and the force moves a moment later.

    Each sensor has its cone in its fixed axes: no component whose sign or scale depends on the
    trial. The normal force under the fraction bar never falls below a tenth of what the recording's
    most loaded sensor carries, so the ratio is bounded where contact is light and has no pole. Of
    marks within 0.5 s the largest jump is kept.
    """
    forces = samples.reshape(len(samples), -1, 3)
    shear = forces[..., :NORMAL_AXIS]
    normal = forces[..., NORMAL_AXIS:]

    # Most steps of a recording are noise, so the median step is the size of the noise.
    steps = np.abs(np.diff(forces, axis=0))
    noise = np.median(steps, axis=0).max()
    # A quantile: one spike of a sensor is not a load.
    load = np.quantile(np.abs(normal), 0.95, axis=0).max()
    least = max(0.1 * load, NOISE_TIMES * noise)
    if least == 0.0:
        return np.empty(0, dtype=np.int64)

    ratio = shear / np.maximum(normal, least)
    jump = _distance(ratio, _rows(STEP_S, rate_hz), 0)
    # A jump stands above the noise of its own sensor's ratio.
    noise_of_jump = np.median(jump, axis=0)
    size = np.maximum(LEAST_JUMP, NOISE_TIMES * noise_of_jump)

    # The force moves a moment later than the ratio, so it is compared over a longer time.
    ahead = _rows(SHEAR_AHEAD_S, rate_hz)
    around = _rows(NORMAL_AHEAD_S, rate_hz)
    shear_change = np.maximum(
        _distance(shear, ahead, ahead), _distance(shear, 0, ahead)
    )
    shear_moved = shear_change > least
    normal_moved = _distance(normal, around, around) > least

    # The force must have moved too; where only the normal force did, the jump must be larger.
    by_shear = (jump > size) & shear_moved
    by_normal = (jump > NORMAL_JUMP * size) & normal_moved
    marked = by_shear | by_normal
    strength = np.where(marked, jump, 0.0).max(axis=1)
    rows = _inside(np.flatnonzero(strength), len(samples), rate_hz)
    return _largest_of_any(rows, strength[rows], _rows(FRICTION_APART_S, rate_hz))


def _distance(x: FloatArray, back: int, ahead: int) -> FloatArray:
    """[T, S, A] -> [T, S]: how far x[t + ahead] is from x[t - back]; clamped at the ends."""
    rows = np.arange(len(x))
    later = x[np.minimum(rows + ahead, len(x) - 1)]
    earlier = x[np.maximum(rows - back, 0)]
    change = later - earlier
    return np.sqrt(np.square(change).sum(axis=2))


def _held(samples: FloatArray, valid: BoolArray) -> FloatArray:
    """Lost values replaced by the last good one, else the first good one, else zero."""
    import pandas as pd  # late: dense windows need no critical points

    good = np.isfinite(samples) & np.repeat(valid, 3, axis=1)
    known = pd.DataFrame(np.where(good, samples, np.nan))
    # The filters and quotients that follow need a finite value in every row.
    return known.ffill().bfill().fillna(0.0).to_numpy()


def _rows(seconds: float, rate_hz: float) -> int:
    """A time as a number of rows, at least one."""
    return max(1, round(seconds * rate_hz))


def _inside(rows: IntArray, n_rows: int, rate_hz: float) -> IntArray:
    """The rows that keep off both ends of a recording."""
    edge = _rows(EDGE_S, rate_hz)
    return rows[(rows >= edge) & (rows < n_rows - edge)]


def _first_of_any(rows: IntArray, apart: int) -> IntArray:
    """Rows in order, without those that follow a kept one within `apart` rows."""
    kept: list[int] = []
    for row in rows.tolist():
        if not kept or row - kept[-1] > apart:
            kept.append(row)
    return np.array(kept, dtype=np.int64)


def _largest_of_any(rows: IntArray, size: FloatArray, apart: int) -> IntArray:
    """Rows in order, without those within `apart` rows of a kept one of larger size."""
    kept: list[int] = []
    # Stable: of equal sizes the earlier row wins.
    by_size = np.argsort(-size, kind="stable")
    for row in rows[by_size].tolist():
        if all(abs(row - other) > apart for other in kept):
            kept.append(row)
    return np.array(sorted(kept), dtype=np.int64)


def _source(
    row: int, by_band: IntArray, by_friction: IntArray, apart: int
) -> PointMethod:
    """Which methods have a point in the time that one fused point stands for."""
    # A fused point is the first of its group, so the points that it stands for lie at it or after
    # it.
    in_band = _any_within(by_band, row, apart)
    in_friction = _any_within(by_friction, row, apart)
    if in_band and in_friction:
        return "both"
    return "band-pass" if in_band else "friction"


def _any_within(rows: IntArray, first: int, apart: int) -> bool:
    """Whether one of the rows lies in first .. first + apart."""
    return bool(np.any((rows >= first) & (rows <= first + apart)))
