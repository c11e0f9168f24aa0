"""Disturbed copies of recordings, so that a learner does not lean on what sensors happen to do.

A copy is a recording as another hand would have felt it: gains, tilted fingertips, noise, offsets
that jump, sensors that die, play, smoothing. Each nuisance strikes a copy by
chance, `CHANCE`, with a size drawn from its range. The ranges are those that the study of
distortions asks about (studies/distortions); its trials and its seeds are others.

A jump in the readings is short, so the windows around it are added to those of the recording.
Directions are not varied: pooled features are the same however a sensor is turned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from holdfast.core.contract import (
    CLASSES,
    NORMAL_FLOOR,
    SITUATIONS,
    BoolArray,
    FloatArray,
)
from holdfast.core.hand_card import HandCard, fill_unmeasured
from holdfast.data.recording import DataSet, LabelledRows, Recording
from holdfast.step.pooled import side_matrix
from holdfast.training.crossval import spec_for
from holdfast.training.plan import POOLED_GROUPS

CHANCE = {
    "tilt": 0.4,
    "own tilt": 0.25,
    "gain": 0.5,
    "own gain": 0.3,
    "shear gain": 0.5,
    "play": 0.25,
    "smoothing": 0.2,
    "dead sensors": 0.3,
    "offset": 0.35,
    "noise": 0.5,
    "coarse steps": 0.25,
}
"""How often a copy has a nuisance."""
TILT_DEG, OWN_TILT_DEG = 15.0, 12.0
GAIN = (0.4, 2.5)
OWN_GAIN = (0.5, 2.0)
SHEAR_GAIN = (0.5, 1.6)
SMOOTHING_S = (0.003, 0.030)
# Shares of the normal force of a touching finger (NORMAL_FLOOR), which is 0.3 N.
PLAY = 1.0
OFFSET = 1.15
NOISE = 0.17
DEAD_NOISE = 0.17
COARSE_STEP = 0.13
AFTER_S = 0.02
"""Every sample so long after a jump is a window of the copy."""
LATER_S, LATER_EVERY_S = 0.5, 0.02
"""And so far apart while the jump is in the history of the features."""
FIRST_SHARE = 0.15
"""Of a recording, before which nothing jumps: its bias is taken there."""


@dataclass(frozen=True)
class Copy:
    """A disturbed recording, and the rows at which its readings jump."""

    recording: Recording
    jumps: tuple[int, ...]


def with_copies(data: DataSet, copies: int, seed: int) -> DataSet:
    """The set, and so many disturbed copies of each recording, in the group of the recording."""
    recordings = list(data.recordings)
    parts = {task: [rows] for task, rows in data.tasks.items()}
    thumb = _thumb(data)
    for number in range(1, copies + 1):
        made = []
        for index, recording in enumerate(data.recordings):
            rng = np.random.default_rng([seed, number, index])
            made.append(disturbed(recording, thumb, rng, data.hand))

        first = len(recordings)
        for copy in made:
            name = f"{copy.recording.trial_id}~{number}"
            recordings.append(replace(copy.recording, trial_id=name))
        for task, rows in data.tasks.items():
            for of_copy in (rows, _around_jumps(made, rows)):
                moved = replace(of_copy, trial=of_copy.trial + first)
                parts[task].append(moved)

    tasks = {task: LabelledRows.concatenated(rows) for task, rows in parts.items()}
    return replace(data, recordings=recordings, tasks=tasks)


def _thumb(data: DataSet) -> BoolArray:
    """[S] which sensors are on the thumb's side, as the pooled features have it."""
    sides = side_matrix(spec_for(data, POOLED_GROUPS))
    return np.asarray(sides[:, 0] > 0.0)


def _around_jumps(copies: Sequence[Copy], rows: LabelledRows) -> LabelledRows:
    """Windows at and after the jumps, labelled by the phase that they fall in.

    None for a task whose labels are neither situations nor classes.
    """
    per = {SITUATIONS: 1, CLASSES: 2}.get(rows.classes, 0)
    # A recording without any window has no known object.
    heavy = dict(zip(rows.trial.tolist(), (rows.label % 2).tolist(), strict=True))
    found: list[tuple[int, int, int]] = []
    for trial in sorted(heavy) if per else []:
        weight = heavy[trial] if per == 2 else 0
        recording = copies[trial].recording
        for row in _rows_after(copies[trial]):
            for phase in recording.phases:
                if phase.first <= row < phase.stop:
                    found.append((trial, row, per * phase.situation + weight))

    trials, last_rows, labels = np.array(found, np.int64).reshape(-1, 3).T
    return LabelledRows(trials, last_rows, labels, rows.classes)


def _rows_after(copy: Copy) -> Iterator[int]:
    """The rows of the windows of a copy's jumps."""
    rate_hz = copy.recording.rate_hz
    soon = max(2, round(AFTER_S * rate_hz))
    later = round(LATER_S * rate_hz)
    every = max(1, round(LATER_EVERY_S * rate_hz))
    for at in copy.jumps:
        yield from range(at, at + soon)
        yield from range(at + soon, at + later, every)


def disturbed(
    recording: Recording,
    thumb: BoolArray,
    rng: np.random.Generator,
    hand: HandCard | None = None,
) -> Copy:
    """A copy as another hand would have felt it. thumb [S]: sensors on the thumb's side.

    hand: an axis that it does not measure stays 0.0.
    """
    shape = (len(recording.samples), recording.n_sensors, 3)
    values = recording.samples.reshape(shape)
    floor = NORMAL_FLOOR[recording.unit]
    jumps: list[int] = []

    values = _tilted(values, thumb, rng)
    values = _scaled(values, rng)
    values = _lagging(values, recording.rate_hz, floor, rng)
    values, valid = _dying(values, recording.valid, floor, jumps, rng)
    values = _displaced(values, floor, jumps, rng)
    if _strikes("noise", rng):
        rms = rng.uniform(0.0, NOISE * floor)
        values = values + rms * rng.normal(size=shape)

    if _strikes("coarse steps", rng):
        step = COARSE_STEP * floor
        values = np.rint(values / step) * step

    # last: what strikes a hand does not make it measure more
    samples = fill_unmeasured(values.reshape(recording.samples.shape), hand)
    return Copy(replace(recording, samples=samples, valid=valid), tuple(jumps))


def _strikes(name: str, rng: np.random.Generator) -> bool:
    return bool(rng.random() < CHANCE[name])


def _tilted(
    values: FloatArray, thumb: BoolArray, rng: np.random.Generator
) -> FloatArray:
    """Fingertips at an angle on the object: a part of the normal force reads as shear.

    All by the same angle, thumb and fingers facing each other, and each by one of its own.
    """
    facing = np.where(thumb, -1.0, 1.0)
    degrees = np.zeros(len(thumb))
    if _strikes("tilt", rng):
        degrees = rng.uniform(-TILT_DEG, TILT_DEG) * facing
    if _strikes("own tilt", rng):
        degrees = degrees + rng.uniform(-OWN_TILT_DEG, OWN_TILT_DEG, len(thumb))

    axis = int(rng.integers(2))
    cos = np.cos(np.radians(degrees))
    sin = np.sin(np.radians(degrees))
    shear, normal = values[..., axis], values[..., 2]
    tilted = values.copy()
    tilted[..., axis] = cos * shear + sin * normal
    tilted[..., 2] = cos * normal - sin * shear
    return tilted


def _scaled(values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Gains of all sensors, of each, and of the shear."""
    gain = np.ones((values.shape[1], 3))
    if _strikes("gain", rng):
        gain *= np.exp(rng.uniform(*np.log(GAIN)))
    if _strikes("own gain", rng):
        low, high = np.log(OWN_GAIN)
        gain *= np.exp(rng.uniform(low, high, (len(gain), 1)))

    if _strikes("shear gain", rng):
        gain[:, :2] *= rng.uniform(*SHEAR_GAIN)
    return values * gain


def _lagging(
    values: FloatArray, rate_hz: float, floor: float, rng: np.random.Generator
) -> FloatArray:
    """Play, in which a reading follows late, and a low-pass of first order."""
    if _strikes("play", rng):
        half = 0.5 * PLAY * floor * rng.random()
        last = values[0]
        followed = np.empty_like(values)
        for row, now in enumerate(values):
            last = np.clip(last, now - half, now + half)
            followed[row] = last
        values = followed

    if _strikes("smoothing", rng):
        share = 1.0 - np.exp(-1.0 / (rate_hz * rng.uniform(*SMOOTHING_S)))
        # from the first reading on, as if it had always been there
        before = (1.0 - share) * values[:1]
        values = lfilter([share], [1.0, share - 1.0], values, axis=0, zi=before)[0]

    return values


def _dying(
    values: FloatArray,
    valid: BoolArray,
    floor: float,
    jumps: list[int],
    rng: np.random.Generator,
) -> tuple[FloatArray, BoolArray]:
    """One or two sensors die: marked invalid, or with their last value, or with noise."""
    if not _strikes("dead sensors", rng):
        return values, valid

    which = rng.permutation(values.shape[1])[: int(rng.integers(1, 3))]
    at = _moment(len(values), rng)
    fault = int(rng.integers(3))
    jumps.append(at)
    values = values.copy()
    values[at:, which] = values[at, which]
    if fault == 0:
        valid = valid.copy()
        valid[at:, which] = False
    elif fault == 1:
        noise = rng.normal(size=(len(values) - at, len(which), 3))
        values[at:, which] = DEAD_NOISE * floor * noise

    return values, valid


def _displaced(
    values: FloatArray, floor: float, jumps: list[int], rng: np.random.Generator
) -> FloatArray:
    """Every axis moves at one moment, up or down by the same size: a cable, a knock."""
    if not _strikes("offset", rng):
        return values

    at = _moment(len(values), rng)
    jumps.append(at)
    signs = rng.choice([-1.0, 1.0], values.shape[1:])
    moved = values.copy()
    moved[at:] += rng.uniform(0.0, OFFSET * floor) * signs
    return moved


def _moment(length: int, rng: np.random.Generator) -> int:
    return int(rng.integers(int(FIRST_SHARE * length), length))
