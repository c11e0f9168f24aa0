"""Several sets as one: their recordings and windows side by side, named by set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from holdfast.core.contract import RATE_TOLERANCE
from holdfast.core.errors import (
    ChannelError,
    DataError,
    LabelError,
    RateError,
    UnitError,
)
from holdfast.training.recording import DataSet, LabelledRows, Recording


def join(sets: Sequence[DataSet]) -> DataSet:
    """One set of several, each with the windows it has, at the rate of the first.

    Trials and groups get their set's name before theirs, so that people of two sets stay two
    groups. Redistributable only if all are. Raises RateError, UnitError, ChannelError, LabelError
    or DataError.
    """
    first, *others = sets
    for other in others:
        require_alike(other, first)
    names = [data.name for data in sets]
    if len(set(names)) < len(names):
        raise DataError(
            f"the same set twice ({', '.join(names)})", next_step="give every set once"
        )
    if not others:
        return first
    starts = np.cumsum([0, *(len(data.recordings) for data in sets)])
    return replace(
        first,
        name=" + ".join(names),
        recordings=[
            _named(recording, data.name)
            for data in sets
            for recording in data.recordings
        ],
        tasks={
            task: _together([data.tasks[task] for data in sets], starts.tolist())
            for task in first.tasks
        },
        kind=" + ".join(dict.fromkeys(data.kind for data in sets)),
        redistributable=all(data.redistributable for data in sets),
        caveat=" ".join(dict.fromkeys(data.caveat for data in sets)),
        notes={"sets": {data.name: data.notes for data in sets}},
        group_kind=" and by ".join(dict.fromkeys(data.group_kind for data in sets)),
        lacks=tuple(
            name for name in first.lacks if all(name in data.lacks for data in sets)
        ),
    )


def require_alike(other: DataSet, first: DataSet) -> None:
    """Check that one model fits both sets.

    Raises RateError, UnitError, ChannelError, LabelError or DataError.
    """
    wrong = (
        (
            RateError,
            abs(other.rate_hz / first.rate_hz - 1.0) > RATE_TOLERANCE,
            f"at {other.rate_hz:g} Hz",
            f"{first.rate_hz:g} Hz",
        ),
        (UnitError, other.unit != first.unit, f"in {other.unit}", first.unit),
        (
            ChannelError,
            other.n_sensors != first.n_sensors,
            f"of {other.n_sensors} sensors",
            str(first.n_sensors),
        ),
        (
            LabelError,
            set(other.tasks) != set(first.tasks),
            f"with the tasks {', '.join(other.tasks)}",
            ", ".join(first.tasks),
        ),
        (
            DataError,
            other.preparation != first.preparation,
            "tared in another way",
            "the same",
        ),
    )
    for error, differs, has, wanted in wrong:
        if differs:
            raise error(
                f"{other.name} is {has}, {first.name}: {wanted}",
                where=other.name,
                cause="recorded with other settings",
                next_step="use sets that were recorded alike, or one of them alone",
            )


def _named(recording: Recording, name: str) -> Recording:
    return replace(
        recording,
        trial_id=f"{name}/{recording.trial_id}",
        group=f"{name}/{recording.group}",
    )


def _together(parts: Sequence[LabelledRows], starts: Sequence[int]) -> LabelledRows:
    trial = np.concatenate(
        [part.trial + start for part, start in zip(parts, starts[:-1], strict=True)]
    )
    row, label = (
        np.concatenate([getattr(part, field) for part in parts])
        for field in ("row", "label")
    )
    return LabelledRows(trial, row, label, parts[0].classes)
