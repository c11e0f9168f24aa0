"""Recordings from pandas: a data frame a trial, named `[<person>/]<object>/<action>/<name>`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from holdfast.core.contract import NOTHING, SITUATIONS, FloatArray, Unit
from holdfast.core.errors import DataNotFound, LabelError, NotANumber
from holdfast.core.objects import Mass, named_mass, object_name, plain_word
from holdfast.core.trial_file import Trial, trial_of
from holdfast.training.datasets.places import EMPTY_HAND, FOLDERS
from holdfast.training.datasets.reading import finite_sensors
from holdfast.training.datasets.thesis import (
    OPEN_HAND,
    assembled,
    preparation,
    require_unit,
)
from holdfast.training.recording import DataSet, Recording
from holdfast.training.timeline import ACTION_S, Phase, events_of, scripted, whole
from holdfast.training.windows import Choice, TimedTrial

if TYPE_CHECKING:
    import pandas as pd

LABEL = "label"
NAME = "<person>/<object>/<action>/<name>"


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
    for none. masses_g: of objects that are not in the table. action_at_s: where the action starts
    without a column of labels, for all trials or by name. windows, seed: as `load` takes them.
    Frames are not changed. Raises a DataError that names the frame.
    """
    if not frames:
        raise DataNotFound("no data frame", where=name, next_step=f"name each {NAME}")
    require_unit(unit, Path(name))
    starts = (
        action_at_s
        if isinstance(action_at_s, Mapping)
        else dict.fromkeys(frames, action_at_s)
    )
    trials = [
        _timed(key, frame, unit, masses_g, starts.get(key, ACTION_S))
        for key, frame in frames.items()
    ]
    about = {"name": name, "unit": unit, "kind": "recorded"}
    data = assembled(about, trials, channels=None, seed=seed, windows=windows)
    return replace(data, notes={**data.notes, "layout": "frames"})


def _timed(
    key: str,
    frame: pd.DataFrame,
    unit: Unit,
    masses_g: Mapping[str, float] | None,
    action_at_s: float,
) -> TimedTrial:
    person, thing, action = _named(key)
    labels = frame[LABEL].tolist() if LABEL in frame else None
    trial = _trial(key, frame.drop(columns=LABEL, errors="ignore"))
    samples = preparation(unit).apply(trial.raw)
    valid = trial.valid & finite_sensors(trial.raw)
    where = (key, key, samples, valid, trial.rate_hz, unit)
    recording = Recording(*where, thing, action, person=person)
    if labels is not None:
        phases, by = (
            _phases(trial, frame["Time"].to_numpy(np.float64), labels),
            "label column",
        )
    elif thing is None or action is None:
        phases, by = whole(len(samples), NOTHING), OPEN_HAND
    else:
        phases = scripted(trial, samples, action, thing, action_at_s)
        by = f"script, action at {action_at_s:g} s"
    recording = replace(
        recording, phases=phases, events=events_of(phases, trial.rate_hz)
    )
    mass = _mass(key, thing, masses_g)
    heavy = mass.heavy if mass else None
    return TimedTrial(recording, phases, heavy, labels is not None, mass, by)


def _named(key: str) -> tuple[str | None, str | None, str | None]:
    """Person, object and action of a frame's name. Raises LabelError."""
    *above, last = key.split("/")[:-1] or [""]
    if plain_word(last) == EMPTY_HAND and len(above) < 2:
        return (above[0] if above else None), None, None
    action = next((one for one in FOLDERS if plain_word(one) == plain_word(last)), None)
    if action is None or not 1 <= len(above) <= 2 or not all(above):
        raise LabelError(
            "not the name of a trial",
            where=key,
            next_step=f"name the frame {NAME}, the action one of {', '.join(FOLDERS)}",
        )
    return (above[0] if len(above) == 2 else None), object_name(above[-1]), action


def _trial(key: str, frame: pd.DataFrame) -> Trial:
    try:
        table: FloatArray = frame.to_numpy(dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise NotANumber(
            f"holds more than numbers ({error})",
            where=key,
            next_step="convert its columns",
        ) from None
    return trial_of([str(column) for column in frame.columns], table, Path(key))


def _phases(
    trial: Trial, time_s: FloatArray, labels: list[object]
) -> tuple[Phase, ...]:
    """Runs of equal labels; a row that is no text has none. Raises LabelError."""
    known = {name: index for index, name in enumerate(SITUATIONS)}
    codes = np.array(
        [known.get(one, -2) if isinstance(one, str) and one else -1 for one in labels]
    )
    if (codes == -2).any():
        raise LabelError(
            f"{labels[int(np.argmax(codes == -2))]!r} is not a situation",
            where=str(trial.path),
            next_step=f"write one of {', '.join(SITUATIONS)} in the column {LABEL}, or nan",
        )
    first = np.flatnonzero(np.diff(codes, prepend=-3))
    rows = [
        *np.searchsorted(trial.t_s, time_s[first] - time_s[0]).tolist(),
        len(trial.t_s),
    ]
    runs = zip(rows[:-1], rows[1:], codes[first].tolist(), strict=True)
    return tuple(Phase(start, stop, code) for start, stop, code in runs if code >= 0)


def _mass(
    key: str, thing: str | None, masses_g: Mapping[str, float] | None
) -> Mass | None:
    if thing is None:
        return None
    mass = named_mass(thing, masses_g)
    if mass is None:
        raise LabelError(
            f"no mass given for object {thing!r}",
            where=key,
            next_step=f"weigh it and give masses_g={{{thing!r}: 120.0}}",
        )
    return mass
