"""Recordings, the first of four steps: `<root>/[<person>/]<object>/<action>/trial_<n>.csv`.

The thesis' layout; critical points, windows and learner follow (training/__init__.py).

In the root there may be a `meta.json` {"unit", "kind", "name", "recordings by", "redistributable",
"action_at_s", "masses_g"}; in an object's folder a `meta.json` {"mass_g"}; next to a trial its
truth, `trial_<n>.truth.json`, with the phases that replace the script (a `daily` needs them; a
`hold` and a `slip` may do without) or with "action_at_s" alone. The preparation is the thesis':
magnets turned the right way round, the mean of five rows subtracted, time from zero. Its moving
average is left out, because it removes the vibrations that the band-pass bank detects.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from holdfast.core.contract import (
    CLASSES,
    NORMAL_FLOOR,
    NOTHING,
    RATE_TOLERANCE,
    BoolArray,
    FloatArray,
    Json,
    Unit,
    averaged_by,
    averaged_in_words,
)
from holdfast.core.errors import ChannelError, LabelError, RateError, count_of
from holdfast.core.hand_card import HandCard
from holdfast.core.schema import checked
from holdfast.core.trial_file import LONGEST_S, Trial, implausible_rate, read_trial
from holdfast.core.trial_layout import (
    LABELLED_ACTIONS,
    META,
    mass_of,
    object_name,
    read_json,
    truth_path,
)
from holdfast.data.datasets.trials import (
    Fault,
    TrialPlace,
    TrialReader,
    doubts_of,
    hand_beside,
    has_thesis_layout,
    places,
    refuse,
    require_history,
    require_possible,
    require_whole,
    warn_of,
)
from holdfast.data.lifts import LIFT, contact_rule, lift_phases
from holdfast.data.recording import (
    DataSet,
    LabelledRows,
    Recording,
    finite_sensors,
    grouped,
)
from holdfast.data.timeline import (
    ACTION_S,
    OF_WHOLE_TRIAL,
    Phase,
    Phases,
    RiskyEvent,
    TruthFile,
    events_of,
    read_truth,
    scripted,
)
from holdfast.data.windows import (
    Choice,
    TimedTrial,
    classes_of,
    labelled_rows,
    sample_counts,
    undersample,
    windows_of,
)
from holdfast.edge_runtime.preparation import Preparation
from holdfast.step.spec import bands_for

WEIGHT_CAVEAT = (
    "Light and heavy differ only by object: windows without contact keep the light/heavy label of "
    "their trial although no signal carries it."
)
"""Of sets whose objects all have a mass."""
CAVEAT = (
    "Where a trial has no truth file its labels follow "
    "the script (action from {at_s:g} s), not a measurement."
)
SLIP_CAVEAT = (
    "When the object slipped is not known in {n} of {of} trials: the slip is taken to be about "
    "the largest change of the readings, and an alarm anywhere in these trials counts as right."
)
LOST_CAVEAT = (
    "{n} of {of} risky events begin while samples are lost, or within half a second after that: "
    "they count as missed."
)
"""Of sets with gaps."""
BY_SCRIPT = "script"
"""How the source of labels begins that follow the script (timeline.labels_by)."""
SLIPPING = ("pull", "fall")
"""Actions of the script in which the object slips."""
OPEN_HAND = "open hand"
"""What the labels come from where the trial is that of the hand alone."""


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


def is_ours(root: Path) -> bool:
    """Whether there are trials in the thesis' layout."""
    return has_thesis_layout(root)


def about(root: Path) -> SetMeta:
    """Name, kind and origin of a folder's trials, by its meta.json. Raises LabelError."""
    name = {"name": root.resolve().name}
    return checked(name | read_json(root / META), SetMeta, root / META, LabelError)


def readers(
    root: Path, fault: Fault = refuse, rate_hz: float | None = None
) -> list[TrialReader]:
    """All trials of a folder, to be read one by one; rate_hz as `datasets.load` has it.

    fault: receives the DataError of each folder that is at no trial's place. Raises one for the
    set's meta.json.
    """
    meta = about(root)
    hand = hand_beside(root, fault)
    return [
        TrialReader(
            place, partial(timed, place, root, meta, rate_hz=rate_hz, hand=hand)
        )
        for place in places(root, fault)
    ]


def assembled(
    meta: SetMeta,
    readers: Sequence[TrialReader],
    windows: Choice,
    seed: int,
) -> DataSet:
    """A data set of trials. Raises RateError, ChannelError, .., which name the trial.

    People are the groups; without at least two, every trial is its own. `notes` has the counts of
    samples, and of windows before undersampling.
    """
    trials = [reader.read() for reader in readers]
    rate_hz = common_rate([trial.recording for trial in trials])
    data = of_trials(trials, meta, rate_hz, windows, seed)
    warn_of(doubts_of(trials))
    return data


def of_trials(
    trials: list[TimedTrial],
    meta: SetMeta,
    rate_hz: float,
    windows: Choice,
    seed: int,
) -> DataSet:
    """The data set of trials that are read. meta: name, kind, origin."""
    bands_for(rate_hz)  # raises RateError where the rate carries none
    tasks: dict[str, LabelledRows] = {}
    notes: Json = {}
    if windows != "none":
        tasks, notes = _windows(trials, windows, seed)

    unit = trials[0].recording.unit
    recordings, group_kind = grouped([trial.recording for trial in trials])
    return DataSet(
        name=meta.name,
        recordings=recordings,
        tasks=tasks,
        rate_hz=rate_hz,
        unit=unit,
        preparation=preparation(unit),
        kind=meta.kind,
        redistributable=meta.redistributable,
        caveat=_caveat(trials, meta),
        group_kind=group_kind,
        notes={"samples": sample_counts(trials), **notes},
    )


def _caveat(trials: Sequence[TimedTrial], meta: SetMeta) -> str:
    """The sentences that stand with every figure of these trials."""
    sources = Counter(trial.labels_by for trial in trials)
    guessed = sources[OF_WHOLE_TRIAL["slip"]]
    sentences = [meta.caveat] if meta.caveat else []
    if not sentences and classes_of(trials) == CLASSES:
        sentences.append(WEIGHT_CAVEAT)
    # Trials with phases, and those that only say slip or hold, follow no script.
    if any(source.startswith(BY_SCRIPT) for source in sources):
        sentences.append(CAVEAT.format(at_s=meta.action_at_s))
    if guessed:
        sentences.append(SLIP_CAVEAT.format(n=guessed, of=len(trials)))
    events = [event for trial in trials for event in trial.recording.events]
    if n_lost := sum(event.lost for event in events):
        sentences.append(LOST_CAVEAT.format(n=n_lost, of=len(events)))
    for n in sorted({trial.averaged for trial in trials} - {1}):
        of_n = [trial.recording.rate_hz for trial in trials if trial.averaged == n]
        words = averaged_in_words(n * float(np.median(of_n)), n)
        sentences.append(f"{count_of(len(of_n), 'trial')}: {words}.")
    return " ".join(sentences)


def _windows(
    trials: list[TimedTrial], choice: Choice, seed: int
) -> tuple[dict[str, LabelledRows], Json]:
    """The task on the chosen windows, "classes" or "situations", and notes of it."""
    notes: Json = {}
    classes = classes_of(trials)
    task = "classes" if classes == CLASSES else "situations"
    chosen = windows_of(trials, choice)
    if choice == "thesis":
        notes["windows_natural"] = labelled_rows(chosen, classes).class_counts()
        chosen = undersample(chosen, seed)
    return {task: labelled_rows(chosen, classes)}, notes


class SetMeta(msgspec.Struct, frozen=True):
    """The meta.json of a set, with what is assumed for a key that it lacks; others are ignored."""

    unit: Unit = "N"
    kind: str = "recorded"
    name: str = ""
    redistributable: bool = False
    caveat: str = ""
    masses_g: dict[str, Any] = {}
    action_at_s: Annotated[float, msgspec.Meta(gt=0.0, lt=LONGEST_S)] = ACTION_S


def timed(
    place: TrialPlace,
    root: Path,
    meta: SetMeta,
    recorded: int | None = None,
    rate_hz: float | None = None,
    hand: HandCard | None = None,
) -> TimedTrial:
    """Read and prepare a trial. Its phases are those of its truth, else of the script.

    recorded: how many samples the recorder counted, None where that is not known. hand: of the set.
    """
    trial, folder = read_trial(place.path, hand), place.object_folder

    truth = read_truth(truth_path(trial.path))
    require_whole(trial, truth.end_s, recorded)
    # another rate is refused where the set is used, with what to do about it
    averaged = max(1, averaged_by(trial.rate_hz, rate_hz or trial.rate_hz))
    if averaged > 1:
        trial = trial.averaged(averaged)
    trial_id = place.path.relative_to(root).with_suffix("").as_posix()
    recording = prepared(trial, meta.unit, trial_id)
    require_possible(recording, trial.path)
    whole = require_history(recording, trial.path)
    recording = replace(
        recording,
        object_name=object_name(folder.name) if folder else None,
        action=place.action,
        person=place.person,
    )

    # A trial's own time goes before that of the set.
    starts_s = truth.action_at_s or meta.action_at_s
    action = place.action
    # A pull that ends before the script's action is a slip.
    if action in SLIPPING and truth.phases is None and trial.t_s[-1] < starts_s:
        action = "slip"
    phases = _phases(trial, recording, truth, action, starts_s)
    events = events_of(phases, len(trial.t_s), trial.rate_hz, action)
    if truth.phases is not None:
        events = truth.events()
    mass = mass_of(folder, meta.masses_g) if folder else None
    by_contact = folder is not None and is_by_contact(truth, action)
    labels_by = truth.labels_by(meta.action_at_s, action) if folder else OPEN_HAND
    if by_contact:
        labels_by = OF_WHOLE_TRIAL[LIFT]
    return TimedTrial(
        replace(
            recording,
            phases=phases,
            events=tuple(_lost_or_not(one, whole, trial.t_s) for one in events),
        ),
        heavy=mass.heavy if mass else None,
        timed=truth.phases is not None or action in LABELLED_ACTIONS,
        mass=mass,
        averaged=averaged,
        labels_by=labels_by,
        denied=trial.denied,
        contact_on=_contact_on(recording) if by_contact else None,
    )


def _phases(
    trial: Trial,
    recording: Recording,
    truth: TruthFile,
    action: str | None,
    starts_s: float,
) -> Phases:
    """The phases of a trial: the open hand, else its truth, else the script."""
    name = recording.object_name
    if name is None or action is None:
        return (Phase(0, len(trial.t_s), NOTHING),)
    if is_by_contact(truth, action):
        values, rate_hz = recording.samples, trial.rate_hz
        where = trial.path
        return lift_phases(values, recording.valid, rate_hz, recording.unit, where)
    if truth.phases is not None:
        return truth.phases_on(trial.t_s, truth_path(trial.path))
    return scripted(trial, recording.samples, action, name, starts_s)


def is_by_contact(truth: TruthFile, action: str | None) -> bool:
    """Whether the phases of a trial are found by contact: of lifts that nothing else labels.

    The recorder's rule takes many lifts for one, from the first contact to the end of the last.
    """
    by_rule = {phase.provenance for phase in truth.phases or []} <= {"rule"}
    return action == LIFT and (truth.phases is None or (bool(truth.phases) and by_rule))


def _contact_on(recording: Recording) -> float | None:
    """The reading above which a lift's hand touches something; None in N, where all have one."""
    if recording.unit == "N":
        return None
    values, valid = recording.samples, recording.valid
    return contact_rule(values, valid, recording.rate_hz, recording.unit).on


def _lost_or_not(event: RiskyEvent, whole: BoolArray, t_s: FloatArray) -> RiskyEvent:
    """The event, and whether it begins where the history of samples is not whole."""
    row = min(int(np.searchsorted(t_s, event.onset_s)), len(whole) - 1)
    # an event without times lies anywhere in its trial
    return replace(event, lost=event.timed and not whole[row])


def prepared(trial: Trial, unit: Unit, trial_id: str) -> Recording:
    """A trial's samples as a model sees them; every trial is a group until people are known."""
    samples = trial.raw
    if trial.zero is None:
        samples = preparation(unit).apply(trial.raw, trial.valid)
    return Recording(
        trial_id=trial_id,
        group=trial_id,
        samples=samples,
        valid=trial.valid & finite_sensors(trial.raw),
        rate_hz=trial.rate_hz,
        unit=unit,
    )


def common_rate(recordings: Sequence[Recording], fault: Fault = refuse) -> float:
    """Median sampling rate, Hz, to three digits.

    fault: receives a RateError or ChannelError for each recording that differs from the others, or
    whose rate no hand has, such as milliseconds taken for seconds.
    """
    # Three digits: a clock that is a microsecond off must not change the rows of a window.
    rate_hz = float(f"{np.median([recording.rate_hz for recording in recordings]):.3g}")

    first = recordings[0]
    apart = "move it to a set of its own"
    for one in recordings:
        impossible = implausible_rate(one.rate_hz)
        if impossible:
            step = "write Time in seconds: holdfast import takes other units of time"
            fault(RateError(impossible, where=one.trial_id, next_step=step))
        elif abs(one.rate_hz / rate_hz - 1.0) > RATE_TOLERANCE:
            what = f"runs at {one.rate_hz:.4g} Hz, the set at {rate_hz:g} Hz"
            fault(RateError(what, where=one.trial_id, next_step=apart))
        if one.n_sensors != first.n_sensors:
            what = f"{one.n_sensors} sensors, but {first.n_sensors} in {first.trial_id}"
            fault(ChannelError(what, where=one.trial_id, next_step=apart))
    return rate_hz
