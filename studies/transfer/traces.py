"""proactive_slip_uskin beside scenes: traces to look at, no score (seven trials)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.core.contract import GRASP, RISKY_SLIP, FloatArray
from holdfast.core.reading import Json
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.recording import DataSet, Recording
from studies.transfer.statistics import Sides, forces

BEFORE_S, AFTER_S = 1.0, 2.0
"""Drawn around the first sign of a slip."""
TARE = Preparation(bias_rows=5)
"""Both begin in the grip: changes from it are drawn."""


def trace(name: str, recording: Recording, onset: int, end: int, sides: Sides) -> Json:
    """Changes of normal force and shear from one second before a slip, over the largest of either.

    onset, end: rows of the slip.
    """
    rate_hz = recording.rate_hz
    first = max(0, onset - round(BEFORE_S * rate_hz))
    stop = min(len(recording.samples), onset + round(AFTER_S * rate_hz))
    samples = TARE.apply(recording.samples[first:stop])
    normal, shear = forces(samples, sides)
    size = max(np.abs(normal).max(), np.abs(shear).max(), 1e-9)
    t_s = (np.arange(first, stop) - onset) / rate_hz
    return {
        "name": name,
        "t_s": _short(t_s),
        "normal": _short(normal / size),
        "shear": _short(shear / size),
        "slip_s": [0.0, round((min(end, stop) - onset) / rate_hz, 3)],
    }


def _short(values: FloatArray) -> list[float]:
    return [round(float(one), 3) for one in values]


def real_traces(data: DataSet, sides: Sides) -> list[Json]:
    """The three trials that slip."""
    found: list[Json] = []
    task = data.tasks["situations"]
    for number, recording in enumerate(data.recordings):
        here = task.trial == number
        slips = task.row[here][task.label[here] != GRASP]
        if slips.size:
            name = recording.trial_id.removeprefix("data_sample_")
            found.append(
                trace(name, recording, int(slips[0]), int(slips[-1]) + 1, sides)
            )
    return found


def scene_traces(sets: Sequence[tuple[str, DataSet, Sides]], count: int) -> list[Json]:
    """The first risky slip of each action, scene by scene, `count` in all."""
    found: list[Json] = []
    for name, data, sides in sets:
        seen: set[str | None] = set()
        for recording in data.recordings:
            risky = [one for one in recording.phases if one.situation == RISKY_SLIP]
            if risky and recording.action not in seen and len(found) < count:
                seen.add(recording.action)
                title = f"{name}: {recording.action}"
                found.append(
                    trace(title, recording, risky[0].first, risky[-1].stop, sides)
                )
    return found
