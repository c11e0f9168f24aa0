"""Statistics of scenes beside the real sets: shear in holds, noise, tremor, load rates, grip.

A statistic is one value a hold or a trial; the table has its 5, 50 and 95 %. Shear is the length of
the summed shear of a side of the grip, so that it does not hang on how a sensor is turned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from holdfast.core.contract import GRASP, NORMAL_AXIS, NOTHING, FloatArray
from holdfast.core.reading import Json
from holdfast.core.trial_layout import NORMAL_FLOOR
from holdfast.training.recording import DataSet, Recording

TREMOR_HZ = (4.0, 12.0)
RATE_OVER_S = 0.1
"""A load rate is the change over so long."""
SETTLES_S = 0.5
"""After contact, before a hold is measured."""
LEAVES_S = 0.1
"""Before the end of a hold."""
HOLD_S = 1.0
"""Of a hold at least, after both are taken off."""
QUIET_ROWS = 30
"""Of a hand without contact at least."""
GRIPPED = 0.5
"""Load rates are taken while the normal force is above this share of the hold's."""
PERCENT = (5.0, 50.0, 95.0)
Sides = Sequence[Sequence[int]]
"""Sensors, from 0, of each side of the grip: their axes point the same way."""
STATISTICS = {
    "shear_over_normal": "shear over normal force in a hold",
    "grip_n": "grip in a hold, N (sum of the sensors)",
    "noise_shear_mn": "noise of a quiet sensor, x and y, mN rms",
    "noise_normal_mn": "noise of a quiet sensor, z, mN rms",
    "tremor_share": "4 to 12 Hz in a hold, rms over the grip",
    "load_rate_n_s": "largest load rate while gripped, N/s",
    "load_rate_share": "largest load rate over the hold's grip, 1/s",
}
"""Key -> what it is."""
IN_FIELD_STATISTICS = {
    "noise_shear_ut": "noise in the grip, x and y, uT rms",
    "noise_normal_ut": "noise in the grip, z, uT rms",
    "tremor_ut": "4 to 12 Hz in a held clip, uT rms over all channels",
    "change_ut_s": "largest change of the field in a clip, uT/s",
}
"""Of clips in uT, whose bias is taken in the grip."""
Values = dict[str, list[float]]


@dataclass(frozen=True)
class Hold:
    """A stretch of steady holding. normal_n, shear_n: [T] sums over the sides."""

    recording: Recording
    rows: slice
    normal_n: FloatArray
    shear_n: FloatArray


def forces(samples: FloatArray, sides: Sides) -> tuple[FloatArray, FloatArray]:
    """[T, C] -> [T] normal and [T] shear: lengths of each side's summed shear, added."""
    by_sensor = samples.reshape(len(samples), -1, 3)
    shear = np.zeros(len(samples))
    for side in sides:
        x, y = by_sensor[:, list(side), :2].sum(axis=1).T
        shear += np.hypot(x, y)
    return by_sensor[:, :, NORMAL_AXIS].sum(axis=1), shear


def holds(recording: Recording, sides: Sides) -> Iterator[Hold]:
    """The steady part of every grasp phase that is long enough."""
    rate_hz = recording.rate_hz
    normal_n, shear_n = forces(recording.samples, sides)
    for phase in recording.phases:
        if phase.situation != GRASP:
            continue
        first = phase.first + round(SETTLES_S * rate_hz)
        stop = phase.stop - round(LEAVES_S * rate_hz)
        if stop - first >= HOLD_S * rate_hz:
            rows = slice(first, stop)
            yield Hold(recording, rows, normal_n[rows], shear_n[rows])


def statistics(data: DataSet, sides: Sides) -> Values:
    """Every statistic of a set in N: one value a hold, a trial, or a quiet axis of a sensor."""
    found: Values = {name: [] for name in STATISTICS}
    floor = NORMAL_FLOOR[data.unit]
    for recording in data.recordings:
        for kind, value in _noise(recording):
            found[f"noise_{kind}_mn"].append(1e3 * value)
        for hold in holds(recording, sides):
            grip = float(np.median(hold.normal_n))
            if grip <= floor:
                continue
            found["grip_n"].append(grip)
            ratio = np.median(hold.shear_n / np.maximum(hold.normal_n, floor))
            found["shear_over_normal"].append(float(ratio))
            tremor = rms_in_band(hold.shear_n, recording.rate_hz)
            found["tremor_share"].append(tremor / grip)
            rate = load_rate(hold, sides, grip)
            found["load_rate_n_s"].append(rate)
            found["load_rate_share"].append(rate / grip)
    return found


def rms_in_band(signal: FloatArray, rate_hz: float) -> float:
    """Rms of a signal [T] between 4 and 12 Hz."""
    sections = butter(2, TREMOR_HZ, "bandpass", fs=rate_hz, output="sos")
    filtered = sosfiltfilt(sections, signal - signal.mean())
    return float(np.sqrt(np.mean(filtered**2)))


def load_rate(hold: Hold, sides: Sides, grip: float) -> float:
    """Largest rate of change of shear, from the hold on while it is gripped, N/s."""
    recording = hold.recording
    samples = recording.samples[hold.rows.start :]
    normal_n, _ = forces(samples, sides)
    let_go = np.flatnonzero(normal_n < GRIPPED * grip)
    samples = samples[: let_go[0]] if let_go.size else samples
    lag = max(1, round(RATE_OVER_S * recording.rate_hz))
    if len(samples) <= lag:
        return 0.0
    _, change = forces(samples[lag:] - samples[:-lag], sides)
    return float(change.max() * recording.rate_hz / lag)


def _noise(recording: Recording) -> Iterator[tuple[str, float]]:
    """Rms noise of each axis in the first quiet stretch."""
    for phase in recording.phases:
        if phase.situation == NOTHING and phase.stop - phase.first >= QUIET_ROWS:
            first = phase.first
            rms = noise_rms(recording.samples[first : first + QUIET_ROWS])
            for axis, value in enumerate(rms):
                yield "normal" if axis % 3 == NORMAL_AXIS else "shear", float(value)
            return


def noise_rms(samples: FloatArray) -> FloatArray:
    """[T, C] -> [C] rms of white noise, from the differences of neighbours."""
    change = np.diff(samples, axis=0)
    rms: FloatArray = np.sqrt(np.mean(change**2, axis=0) / 2.0)
    return rms


def field_statistics(data: DataSet) -> Values:
    """Statistics of clips in uT, whose first half second lies in the grip."""
    found: Values = {name: [] for name in IN_FIELD_STATISTICS}
    for clip in data.recordings:
        rate_hz, samples = clip.rate_hz, clip.samples
        for axis, value in enumerate(noise_rms(samples[: round(0.5 * rate_hz)])):
            kind = "normal" if axis % 3 == NORMAL_AXIS else "shear"
            found[f"noise_{kind}_ut"].append(float(value))
        if clip.action == "hold":
            bands = [rms_in_band(channel, rate_hz) for channel in samples.T]
            found["tremor_ut"].append(float(np.sqrt(np.sum(np.square(bands)))))
        lag = round(RATE_OVER_S * rate_hz)
        change = np.sqrt(np.sum((samples[lag:] - samples[:-lag]) ** 2, axis=1))
        found["change_ut_s"].append(float(change.max() * rate_hz / lag))
    return found


def spread_rows(name: str, real: bool, found: Values) -> list[Json]:
    """5, 50 and 95 % of every statistic of a set."""
    rows = []
    for key, values in found.items():
        row: Json = {"set": name, "real": real, "statistic": key, "n": len(values)}
        spread: list[float | None] = [None, None, None]
        if values:
            spread = [float(one) for one in np.percentile(values, PERCENT)]
        rows.append(row | dict(zip(("p5", "p50", "p95"), spread, strict=True)))
    return rows


def within(rows: Sequence[Json]) -> list[Json]:
    """For each statistic, whether either end of the real 5 to 95 % lies in that of some scene.

    Scenes at 0 and at 10 do not cover 5: an end counts where one scene's own spread holds it.
    """
    verdicts = []
    for key in dict.fromkeys(row["statistic"] for row in rows):
        of_key = [row for row in rows if row["statistic"] == key and row["n"]]
        scenes = [row for row in of_key if not row["real"]]
        if not scenes:
            continue
        for row in of_key:
            if row["real"]:
                low = _holding(scenes, row["p5"])
                high = _holding(scenes, row["p95"])
                verdicts.append(
                    {
                        "statistic": key,
                        "set": row["set"],
                        "p5_within": bool(low),
                        "p95_within": bool(high),
                        "by_one_scene": [name for name in low if name in high],
                    }
                )
    return verdicts


def _holding(scenes: Sequence[Json], value: float) -> list[str]:
    """The scenes whose 5 to 95 % hold a value."""
    return [one["set"] for one in scenes if one["p5"] <= value <= one["p95"]]
