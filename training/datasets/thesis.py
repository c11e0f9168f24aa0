"""Reader of the thesis' layout: `<root>/<object>/<action>/trial_<n>.csv`.

Beside the objects there may be the hand alone, `nothing/trial_<n>.csv` or `nothing.csv`; in the
root a `meta.json` {"unit", "kind", "name", "recordings by", "redistributable"}; in an object's
folder a `meta.json` {"mass_g"}; beside a trial its truth, `trial_<n>.truth.json`, which replaces
the script and which the actions `hold` and `daily` need. The preparation is the thesis': magnets
turned the right way round, the mean of five rows subtracted, time from zero. Its moving average is
left out, because it removes the vibrations that the band-pass bank detects.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from edge_runtime.contact import NORMAL_FLOOR
from edge_runtime.contract import NOTHING, RATE_TOLERANCE, UNITS, Unit
from edge_runtime.errors import ChannelError, DataNotFound, LabelError, RateError, UnitError
from edge_runtime.preparation import Preparation
from edge_runtime.reading import Json
from edge_runtime.trial_file import Trial, read_trial
from edge_runtime.trial_layout import SITUATION_OF_ACTION, truth_path
from export.bank import bands_for
from training.datasets.channels import ChannelsNotOffered
from training.datasets.rows import finite_sensors
from training.objects import is_heavy, mass_g, object_name, plain_word, read_json
from training.recording import DataSet, Recording
from training.say import Part, ignored, span
from training.timeline import (
    UNSCRIPTED,
    Phase,
    RiskyEvent,
    events_of,
    read_events,
    read_truth,
    scripted,
    whole,
)
from training.windows import (
    Choice,
    TimedTrial,
    balance,
    class_counts,
    counts_table,
    dense_windows,
    labelled_rows,
    natural_windows,
    sample_counts,
)

EMPTY_HAND = "nothing"
FOLDERS = (*SITUATION_OF_ACTION, *UNSCRIPTED)
TRIAL_NAME = re.compile(r"trial_(\d+)\.csv")
Phased = Callable[[Trial, Recording], tuple[tuple[Phase, ...], tuple[RiskyEvent, ...]]]
CAVEAT = (
    "Light and heavy differ only by object: windows without contact keep the light/heavy label of "
    "their trial although no signal carries it. Where a trial has no truth file its labels follow "
    "the script (action from 7 s), not a measurement."
)


@dataclass(frozen=True)
class TrialPlace:
    """Where a trial is; `object_folder` and `action` are None for the hand alone."""

    path: Path
    object_folder: Path | None = None
    action: str | None = None


READING = 0.5
"""Of the time of `load`; the rest is for finding the windows."""


def recognises(root: Path) -> bool:
    """Whether a folder holds an `<object>/<action>/trial_<n>.csv` with an action of the thesis."""
    return any(
        _action(path.parent)
        for path in root.glob("*/*/trial_*.csv")
        if TRIAL_NAME.fullmatch(path.name)
    )


def preparation(unit: Unit) -> Preparation:
    """The thesis'; a first value that is negative by noise alone turns nothing round."""
    return Preparation(
        bias_rows=5, statistic="mean", flip_negative_normal=True, flip_beyond=NORMAL_FLOOR[unit]
    )


def load(
    root: Path,
    *,
    channels: int | None = None,
    seed: int = 0,
    windows: Choice = "balanced",
    part: Part = ignored,
) -> DataSet:
    """All trials of a folder, with the task "classes" (labels 0..7). part: how much is read.

    channels: refuse the set if it has another number; None takes it as it is.
    windows: balanced (drawn by the seed; every class must be there), natural (every one), or dense.
    Every trial is a group of its own. `notes` has the counts of samples, of all windows and of
    those kept, and the latter as a table. rate_hz is the median over the trials to three digits, so
    that a clock that is a microsecond off does not cost the window a sample. Raises a DataError,
    such as RateError for a trial more than 10 % off the others, which names the place.
    """
    meta = _meta(root)
    places, trials = list(_places(root)), []
    for number, place in enumerate(places, 1):
        trials.append(timed(place, root, meta["unit"]))
        part(READING * number / len(places))
    if not trials:
        raise DataNotFound(
            "no trials",
            where=root,
            next_step="give a folder with <object>/<action>/trial_<n>.csv in it",
        )
    about = {"name": root.resolve().name, **meta}
    rest = span(part, READING, 1.0)
    return assembled(about, trials, channels=channels, seed=seed, windows=windows, part=rest)


def assembled(
    meta: Json,
    trials: list[TimedTrial],
    *,
    channels: int | None,
    seed: int,
    windows: Choice,
    part: Part = ignored,
) -> DataSet:
    """A data set of trials. meta: name, unit, kind, origin. Raises RateError or ChannelError."""
    rate_hz = _common_rate([trial.recording for trial in trials])
    has = 3 * trials[0].recording.n_sensors
    if channels is not None and channels != has:
        raise ChannelsNotOffered(str(meta["name"]), channels, [has])
    natural = natural_windows(trials, part)
    chosen = {
        "balanced": lambda: balance(natural, seed),
        "natural": lambda: natural,
        "dense": lambda: dense_windows(trials),
    }[windows]()
    return DataSet(
        name=str(meta["name"]),
        recordings=[trial.recording for trial in trials],
        tasks={"classes": labelled_rows(chosen)},
        rate_hz=rate_hz,
        unit=meta["unit"],
        preparation=preparation(meta["unit"]),
        kind=str(meta["kind"]),
        redistributable=meta.get("redistributable") is True,
        caveat=CAVEAT,
        notes={
            "layout": "thesis",
            "recordings_by": str(meta.get("recordings by", "not stated")),
            "seed": seed,
            "bands_hz": list(bands_for(rate_hz)),
            "samples": sample_counts(trials),
            "windows_natural": class_counts(natural),
            "windows": class_counts(chosen),
            "table": counts_table(chosen),
        },
    )


def _meta(root: Path) -> Json:
    meta = {"unit": "N", "kind": "recorded"} | read_json(root / "meta.json")
    if meta["unit"] not in UNITS:
        raise UnitError(
            f"unit {meta['unit']!r} is not one of {', '.join(UNITS)}",
            where=root / "meta.json",
            next_step="write the unit the channels are in",
        )
    return meta


def _places(root: Path) -> Iterator[TrialPlace]:
    """Every trial of the folder, objects and actions by name, trials by number."""
    for folder in sorted(path for path in root.iterdir() if path.is_dir()) if root.is_dir() else ():
        if plain_word(folder.name) == EMPTY_HAND:
            yield from (TrialPlace(path) for path in _numbered(folder))
            continue
        for actions in sorted(path for path in folder.iterdir() if path.is_dir()):
            for path in _numbered(actions):
                yield TrialPlace(path, folder, _known_action(actions))
    if (root / f"{EMPTY_HAND}.csv").is_file():
        yield TrialPlace(root / f"{EMPTY_HAND}.csv")


def _numbered(folder: Path) -> list[Path]:
    matches = ((TRIAL_NAME.fullmatch(path.name), path) for path in folder.iterdir())
    return [path for _, path in sorted((int(match[1]), path) for match, path in matches if match)]


def _action(folder: Path) -> str | None:
    return next(
        (action for action in FOLDERS if plain_word(action) == plain_word(folder.name)), None
    )


def _known_action(folder: Path) -> str:
    action = _action(folder)
    if action is None:
        raise LabelError(
            f"{folder.name!r} is not an action",
            where=folder,
            next_step=f"name the folder one of {', '.join(FOLDERS)}, or move it out of the set",
        )
    return action


def timed(place: TrialPlace, root: Path, unit: Any, phased: Phased | None = None) -> TimedTrial:
    """Read and prepare a trial. phased: gives its phases; default: its truth, else the script."""
    trial = read_trial(place.path)
    trial_id = place.path.relative_to(root).with_suffix("").as_posix()
    recording = Recording(
        trial_id=trial_id,
        group=trial_id,
        samples=preparation(unit).apply(trial.raw),
        valid=trial.valid & finite_sensors(trial.raw),
        rate_hz=trial.rate_hz,
        unit=unit,
        object_name=object_name(place.object_folder.name) if place.object_folder else None,
        action=place.action,
    )
    phases, events = (phased or _phased)(trial, recording)
    recording = replace(recording, phases=phases, events=events)
    heavy = is_heavy(mass_g(place.object_folder)) if place.object_folder else None
    return TimedTrial(recording, phases, heavy, timed=truth_path(trial.path).exists())


def _phased(trial: Trial, recording: Recording) -> tuple[tuple[Phase, ...], tuple[RiskyEvent, ...]]:
    phases = _phases(trial, recording)
    return phases, _events(trial, phases)


def _phases(trial: Trial, recording: Recording) -> tuple[Phase, ...]:
    if recording.object_name is None or recording.action is None:
        return whole(len(trial.t_s), NOTHING)
    truth = truth_path(trial.path)
    if truth.exists():
        return read_truth(truth, trial.t_s)
    return scripted(trial, recording.samples, recording.action, recording.object_name)


def _events(trial: Trial, phases: tuple[Phase, ...]) -> tuple[RiskyEvent, ...]:
    truth = truth_path(trial.path)
    return read_events(truth) if truth.exists() else events_of(phases, trial.rate_hz)


def _common_rate(recordings: list[Recording]) -> float:
    rate_hz = float(f"{np.median([recording.rate_hz for recording in recordings]):.3g}")
    for recording in recordings:
        if abs(recording.rate_hz / rate_hz - 1.0) > RATE_TOLERANCE:
            raise RateError(
                f"runs at {recording.rate_hz:.4g} Hz, the set at {rate_hz:g} Hz",
                where=recording.trial_id,
                cause="recorded with other settings",
                next_step="move it to a set of its own",
            )
        if recording.n_sensors != recordings[0].n_sensors:
            raise ChannelError(
                f"{recording.n_sensors} sensors, but {recordings[0].n_sensors} in "
                f"{recordings[0].trial_id}",
                where=recording.trial_id,
                next_step="move it to a set of its own",
            )
    return rate_hz
