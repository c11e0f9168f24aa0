"""What happens in a trial, by time: labels that change, marks, fingers lost and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.interop.carried import CarriedTrial


@dataclass(frozen=True)
class Happening:
    """One line of a log. is_loss: a finger is not valid from here on."""

    t_ns: int
    text: str
    is_loss: bool = False


def happenings(trial: CarriedTrial) -> list[Happening]:
    """All of a trial."""
    stamps = trial.t_ns.tolist()
    labels = [
        Happening(stamps[first], f"label: {name} ({trial.about['labels_by']})")
        for first, _, name in trial.phases()
    ]
    marks = [
        Happening(trial.start_ns + round(1e9 * one.t_s), f"mark: {one.text} ({one.provenance})")
        for one in trial.marks
    ]
    return sorted(labels + marks + _losses(trial, stamps), key=lambda one: one.t_ns)


def _losses(trial: CarriedTrial, stamps: list[int]) -> list[Happening]:
    """Where a finger is lost, also from the start, and where it is back."""
    there = trial.valid
    before = np.vstack([np.ones((1, there.shape[1]), dtype=np.bool_), there[:-1]])
    return [
        Happening(
            stamps[row],
            f"finger {sensor + 1} {'is back' if there[row, sensor] else 'is lost'}",
            is_loss=not there[row, sensor],
        )
        for row, sensor in np.argwhere(there != before).tolist()
    ]
