"""Simulated newtons beside real ones: each hand in units of its own grip.

A set of taxels on one pad carries a part of the grip that nobody recorded, and the newtons of the
real set are not verified. So a hand is scaled by its own level: the median of its summed normal
force while it touches. That is one number for a person, of their own samples without any label; a
hand can measure it in its first grasps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from holdfast.core.contract import NORMAL_AXIS
from holdfast.core.trial_layout import NORMAL_FLOOR
from holdfast.training.recording import DataSet


def levels(data: DataSet, *, by_group: bool) -> dict[str, float]:
    """Median of the summed normal force over the samples above the floor, in the set's unit.

    by_group: one level for every person, else one for the whole set, by the name "".
    """
    floor = NORMAL_FLOOR[data.unit]
    forces: dict[str, list[np.ndarray]] = {}
    for recording in data.recordings:
        force = recording.samples[:, NORMAL_AXIS::3].sum(axis=1)
        name = recording.group if by_group else ""
        forces.setdefault(name, []).append(force[force > floor])
    found = {}
    for name, parts in forces.items():
        touched = np.concatenate(parts)
        # a hand that never touches has no level, and keeps its samples
        found[name] = float(np.median(touched)) if touched.size else 1.0
    return found


def scaled(data: DataSet, factors: Mapping[str, float]) -> DataSet:
    """The same set with every sample times the factor of its group."""
    recordings = [
        replace(one, samples=one.samples * factors[one.group])
        for one in data.recordings
    ]
    return replace(data, recordings=recordings)


def at_level(data: DataSet, level: float) -> DataSet:
    """The set with every group's own level brought to this one."""
    own = levels(data, by_group=True)
    return scaled(data, {name: level / one for name, one in own.items()})
