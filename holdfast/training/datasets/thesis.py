"""Reader of the thesis' layout: `<root>/[<person>/]<object>/<action>/trial_<n>.csv`.

In the root there may be a `meta.json` {"unit", "kind", "name", "recordings by", "redistributable",
"action_at_s", "masses_g"}; in an object's folder a `meta.json` {"mass_g"}; beside a trial its
truth, `trial_<n>.truth.json`, with the phases that replace the script (the actions `hold` and
`daily` need them) or with "action_at_s" alone. The preparation is the thesis': magnets
turned the right way round, the mean of five rows subtracted, time from zero. Its moving average is
left out, because it removes the vibrations that the band-pass bank detects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from holdfast.core.contact import NORMAL_FLOOR
from holdfast.core.contract import NOTHING, RATE_TOLERANCE, UNITS, Unit
from holdfast.core.errors import (
    ChannelError,
    DataNotFound,
    LabelError,
    RateError,
    UnitError,
)
from holdfast.core.objects import MASSES_KEY, mass_of, object_name, read_json
from holdfast.core.reading import Json
from holdfast.core.trial_file import Trial, read_trial
from holdfast.core.trial_layout import META, truth_path
from holdfast.edge_runtime.preparation import Preparation
from holdfast.export.bank import bands_for
from holdfast.training.datasets.places import Fault, TrialPlace, places, refuse
from holdfast.training.datasets.places import recognises as recognises
from holdfast.training.datasets.reading import (
    ChannelsNotOffered,
    TrialReader,
    finite_sensors,
    read_all,
)
from holdfast.training.progress import Part, ignored, span
from holdfast.training.recording import DataSet, LabelledRows, Recording
from holdfast.training.splits import grouped
from holdfast.training.timeline import (
    ACTION_KEY,
    ACTION_S,
    Phase,
    RiskyEvent,
    action_start_s,
    events_of,
    has_phases,
    labels_by,
    read_events,
    read_truth,
    scripted,
    whole,
)
from holdfast.training.windows import (
    Choice,
    TimedTrial,
    class_counts,
    counts_table,
    dense_windows,
    labelled_rows,
    natural_windows,
    sample_counts,
    undersample,
)

Phased = Callable[[Trial, Recording], tuple[tuple[Phase, ...], tuple[RiskyEvent, ...]]]
CAVEAT = (
    "Light and heavy differ only by object: windows without contact keep the light/heavy label of "
    "their trial although no signal carries it. Where a trial has no truth file its labels follow "
    "the script (action from {at_s:g} s), not a measurement."
)
OPEN_HAND = "open hand"
"""What the labels come from where the trial is that of the hand alone."""
READING = 0.5
"""Of the time of `load`; the rest is for finding the windows."""


def preparation(unit: Unit) -> Preparation:
    """The thesis', but a reversed magnet turns the whole sensor round (docs/decisions.md).

    A first value that is negative by noise alone turns nothing round.
    """
    return Preparation(
        bias_rows=5,
        statistic="mean",
        flip_negative_normal=True,
        flip_beyond=NORMAL_FLOOR[unit],
        turns="sensor",
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
    windows: training/windows.py; thesis draws by the seed, and every class must be there; none
    leaves the task and its counts out.
    People are the groups; without at least two, every trial is one. `notes` has the counts of
    samples and of the windows, these also as a table, and where they were drawn from the natural
    ones, the counts of those. rate_hz is the median over the trials to three digits, so that a
    clock that is a microsecond off does not cost the window a sample. Raises a DataError, such as
    RateError for a trial more than 10 % off the others, which names the place.
    """
    meta = meta_of(root)
    found = read_all(readers(root), part=span(part, 0.0, READING))
    trials = [trial for trial in found if trial]
    if not trials:
        raise DataNotFound(
            "no trials",
            where=root,
            next_step="give a folder with <object>/<action>/trial_<n>.csv in it",
        )
    rest = span(part, READING, 1.0)
    return assembled(
        meta, trials, channels=channels, seed=seed, windows=windows, part=rest
    )


def readers(root: Path, fault: Fault = refuse) -> list[TrialReader]:
    """All trials of a folder, to be read one by one.

    fault: receives the DataError of each folder that is at no trial's place. Raises one for the
    set's meta.json.
    """
    meta = meta_of(root)
    return [
        TrialReader(one, partial(timed, one, root, meta)) for one in places(root, fault)
    ]


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
    rate_hz = common_rate([trial.recording for trial in trials])
    has = 3 * trials[0].recording.n_sensors
    if channels is not None and channels != has:
        raise ChannelsNotOffered(str(meta["name"]), channels, [has])
    tasks, counted = _task_of_windows(trials, windows, seed, part)
    recordings, group_kind = grouped([trial.recording for trial in trials])
    return DataSet(
        name=str(meta["name"]),
        recordings=recordings,
        tasks=tasks,
        rate_hz=rate_hz,
        unit=meta["unit"],
        preparation=preparation(meta["unit"]),
        kind=str(meta["kind"]),
        redistributable=meta.get("redistributable") is True,
        caveat=CAVEAT.format(at_s=meta.get(ACTION_KEY, ACTION_S)),
        group_kind=group_kind,
        notes={
            "layout": "thesis",
            "recordings_by": str(meta.get("recordings by", "not stated")),
            "seed": seed,
            "bands_hz": list(bands_for(rate_hz)),
            "samples": sample_counts(trials),
            **counted,
        },
    )


def _task_of_windows(
    trials: list[TimedTrial], windows: Choice, seed: int, part: Part
) -> tuple[dict[str, LabelledRows], Json]:
    """The task "classes" on the chosen windows, and their counts for the notes; none for none."""
    if windows == "none":
        return {}, {}
    chosen, drawn_from = _chosen_windows(trials, windows, seed, part)
    counts = {"windows": class_counts(chosen), "table": counts_table(chosen)}
    return {"classes": labelled_rows(chosen)}, {**drawn_from, **counts}


def _chosen_windows(
    trials: list[TimedTrial], windows: Choice, seed: int, part: Part
) -> tuple[pd.DataFrame, Json]:
    """The windows that were chosen, and the note on the natural ones where these were found."""
    if windows == "balanced":
        return dense_windows(trials, part), {}
    natural = natural_windows(trials, part)
    note = {"windows_natural": class_counts(natural)}
    return (undersample(natural, seed) if windows == "thesis" else natural), note


def meta_of(root: Path) -> Json:
    """The set's meta.json, with what is assumed where it says nothing. Raises a DataError."""
    where = root / META
    meta = {"unit": "N", "kind": "recorded", "name": root.resolve().name} | read_json(
        where
    )
    require_unit(meta["unit"], where)
    if not isinstance(meta.get(MASSES_KEY, {}), dict):
        example = f'{{"{MASSES_KEY}": {{"mug": 320.0}}}}'
        raise LabelError(
            f"{MASSES_KEY} is no table", where=where, next_step=f"write {example}"
        )
    action_start_s(meta, where)
    return meta


def require_unit(unit: object, where: Path) -> None:
    """Raise UnitError where a meta.json gives no unit that is known."""
    if unit not in UNITS:
        raise UnitError(
            f"unit {unit!r} is not one of {', '.join(UNITS)}",
            where=where,
            next_step="write the unit the channels are in",
        )


def timed(
    place: TrialPlace, root: Path, meta: Json, phased: Phased | None = None
) -> TimedTrial:
    """Read and prepare a trial. phased: gives its phases; default: its truth, else the script."""
    trial, unit = read_trial(place.path), meta["unit"]
    trial_id = place.path.relative_to(root).with_suffix("").as_posix()
    recording = Recording(
        trial_id=trial_id,
        group=trial_id,
        samples=preparation(unit).apply(trial.raw),
        valid=trial.valid & finite_sensors(trial.raw),
        rate_hz=trial.rate_hz,
        unit=unit,
        object_name=object_name(place.object_folder.name)
        if place.object_folder
        else None,
        action=place.action,
        person=place.person,
    )
    action_at_s = action_start_s(meta, root / META) or ACTION_S
    phases, events = (
        phased(trial, recording) if phased else _phased(trial, recording, action_at_s)
    )
    recording = replace(recording, phases=phases, events=events)
    folder = place.object_folder
    mass = mass_of(folder, meta.get(MASSES_KEY)) if folder else None
    return TimedTrial(
        recording,
        phases,
        heavy=mass.heavy if mass else None,
        timed=has_phases(truth_path(trial.path)),
        mass=mass,
        labels_by=labels_by(truth_path(trial.path), action_at_s)
        if folder
        else OPEN_HAND,
    )


def _phased(
    trial: Trial, recording: Recording, action_at_s: float
) -> tuple[tuple[Phase, ...], tuple[RiskyEvent, ...]]:
    truth = truth_path(trial.path)
    phases = _phases(trial, recording, action_at_s)
    return phases, read_events(truth) if has_phases(truth) else events_of(
        phases, trial.rate_hz
    )


def _phases(
    trial: Trial, recording: Recording, action_at_s: float
) -> tuple[Phase, ...]:
    if recording.object_name is None or recording.action is None:
        return whole(len(trial.t_s), NOTHING)
    truth = truth_path(trial.path)
    if has_phases(truth):
        return read_truth(truth, trial.t_s)
    action_at_s = action_start_s(read_json(truth), truth) or action_at_s
    return scripted(
        trial, recording.samples, recording.action, recording.object_name, action_at_s
    )


def common_rate(recordings: Sequence[Recording], fault: Fault = refuse) -> float:
    """Median sampling rate, Hz, to three digits.

    fault: receives a RateError or ChannelError for each recording that differs from the others.
    """
    rate_hz = float(f"{np.median([recording.rate_hz for recording in recordings]):.3g}")
    for recording in recordings:
        if abs(recording.rate_hz / rate_hz - 1.0) > RATE_TOLERANCE:
            fault(
                RateError(
                    f"runs at {recording.rate_hz:.4g} Hz, the set at {rate_hz:g} Hz",
                    where=recording.trial_id,
                    cause="recorded with other settings",
                    next_step="move it to a set of its own",
                )
            )
        if recording.n_sensors != recordings[0].n_sensors:
            fault(
                ChannelError(
                    f"{recording.n_sensors} sensors, but {recordings[0].n_sensors} in "
                    f"{recordings[0].trial_id}",
                    where=recording.trial_id,
                    next_step="move it to a set of its own",
                )
            )
    return rate_hz
