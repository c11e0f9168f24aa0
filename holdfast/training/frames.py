"""Recordings from pandas: a data frame a trial, named `[<person>/]<object>/<action>/<name>`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from holdfast.core.contract import NOTHING, SITUATIONS, FloatArray, Unit
from holdfast.core.errors import DataNotFound, LabelError, NotANumber
from holdfast.core.trial_file import Trial, trial_of
from holdfast.core.trial_layout import (
    LABELLED_ACTIONS,
    named_mass,
    object_name,
    plain_word,
)
from holdfast.training.datasets.thesis import (
    OPEN_HAND,
    assembled,
    prepared,
    require_unit,
)
from holdfast.training.datasets.trials import (
    EMPTY_HAND,
    FOLDERS,
    TrialPlace,
    TrialReader,
    action_of,
)
from holdfast.training.recording import DataSet
from holdfast.training.timeline import (
    ACTION_S,
    OF_WHOLE_TRIAL,
    Phase,
    Phases,
    events_of,
    events_of_whole_trial,
    scripted,
    whole,
)
from holdfast.training.windows import Choice, TimedTrial

if TYPE_CHECKING:
    import pandas as pd

LABEL = "label"
"""The column of situations, where a frame has one."""
NAME = "<person>/<object>/<action>/<name>"
"""How a frame is named; the person may be left out."""
NO_LABEL = -1
"""The code of a row without a situation."""


def recordings_from_frames(
    frames: Mapping[str, pd.DataFrame],
    *,
    unit: Unit = "N",
    masses_g: Mapping[str, float] | None = None,
    action_at_s: float | Mapping[str, float] = ACTION_S,
    name: str = "frames",
    windows: Choice = "balanced",
    seed: int = 0,
) -> DataSet:
    """A data set of data frames, one a trial, as a folder of such trials would be read.

    frames: `[<person>/]<object>/<action>/<name>` (or `[<person>/]nothing/<name>`) -> columns Time
    (s), X1, Y1, Z1, .. in `unit`, and where it is known `label`: the situation of each row, empty
    for none. masses_g: of objects that are not in the table; where one has none, no weight is
    known of the set. action_at_s: where the action starts without a column of labels, for all
    trials or by name. windows, seed: as `load` takes them. Frames are not changed. Raises a
    DataError that names the frame.
    """
    if not frames:
        raise DataNotFound("no data frame", where=name, next_step=f"name each {NAME}")
    require_unit(unit, Path(name))

    readers = []
    for key, frame in frames.items():
        starts_s = action_at_s
        if isinstance(starts_s, Mapping):
            starts_s = starts_s.get(key, ACTION_S)
        read = partial(_timed, key, frame, unit, masses_g, starts_s)
        readers.append(TrialReader(TrialPlace(Path(key)), read))
    about = {"name": name, "kind": "recorded"}
    data = assembled(about, readers, channels=None, seed=seed, windows=windows)
    return replace(data, notes={**data.notes, "layout": "frames"})


def _timed(
    key: str,
    frame: pd.DataFrame,
    unit: Unit,
    masses_g: Mapping[str, float] | None,
    action_at_s: float,
) -> TimedTrial:
    """A frame as a trial, its phases by its column of labels or by the script."""
    person, name, action = _named(key)
    trial = _trial(key, frame.drop(columns=LABEL, errors="ignore"))
    recording = prepared(trial, unit, key)

    events = None
    if LABEL in frame:
        phases = _phases(trial, frame)
        labels_by = "label column"
    elif name is None or action is None:
        phases = whole(len(recording.samples), NOTHING)
        labels_by = OPEN_HAND
    else:
        phases = scripted(trial, recording.samples, action, name, action_at_s)
        if action in LABELLED_ACTIONS:
            n_rows = len(recording.samples)
            events = events_of_whole_trial(n_rows, trial.rate_hz, action)
        labels_by = OF_WHOLE_TRIAL.get(action, f"script, action at {action_at_s:g} s")

    mass = named_mass(name, masses_g) if name else None
    named = replace(
        recording,
        object_name=name,
        action=action,
        phases=phases,
        events=events_of(phases, trial.rate_hz) if events is None else events,
        person=person,
    )
    return TimedTrial(
        named,
        heavy=mass.heavy if mass else None,
        timed=LABEL in frame or action in LABELLED_ACTIONS,
        mass=mass,
        labels_by=labels_by,
    )


def _named(key: str) -> tuple[str | None, str | None, str | None]:
    """Person, object and action of a frame's name. Raises LabelError."""
    # The last part names the trial alone; what stands above it says what the trial is.
    *above, last = key.split("/")[:-1] or [""]
    if plain_word(last) == EMPTY_HAND and len(above) < 2:
        person = above[0] if above else None
        return person, None, None

    action = action_of(last)
    if action is None or not 1 <= len(above) <= 2 or not all(above):
        raise LabelError(
            "not the name of a trial",
            where=key,
            next_step=f"name the frame {NAME}, the action one of {', '.join(FOLDERS)}",
        )
    person = above[0] if len(above) == 2 else None
    return person, object_name(above[-1]), action


def _trial(key: str, frame: pd.DataFrame) -> Trial:
    """A frame without labels, checked as a file of the same columns is."""
    try:
        table: FloatArray = frame.to_numpy(dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise NotANumber(
            f"holds more than numbers ({error})",
            where=key,
            next_step="convert its columns",
        ) from None
    return trial_of([str(column) for column in frame.columns], table, Path(key))


def _phases(trial: Trial, frame: pd.DataFrame) -> Phases:
    """Runs of equal labels; a row whose label is no text has none. Raises LabelError."""
    codes = np.full(len(frame), NO_LABEL)
    for row, label in enumerate(frame[LABEL].tolist()):
        if not isinstance(label, str) or not label:
            continue
        if label not in SITUATIONS:
            raise LabelError(
                f"{label!r} is not a situation",
                where=str(trial.path),
                next_step=f"write one of {', '.join(SITUATIONS)} in the column {LABEL}, or nan",
            )
        codes[row] = SITUATIONS.index(label)

    # A lost sample is a row of the trial and none of the frame: rows are looked up by time.
    time_s = frame["Time"].to_numpy(np.float64)
    first = np.flatnonzero(np.diff(codes, prepend=NO_LABEL - 1))
    starts = np.searchsorted(trial.t_s, time_s[first] - time_s[0]).tolist()
    stops = [*starts[1:], len(trial.t_s)]

    phases = []
    for start, stop, code in zip(starts, stops, codes[first].tolist(), strict=True):
        if code != NO_LABEL:
            phases.append(Phase(start, stop, code))
    return tuple(phases)
