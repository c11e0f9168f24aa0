"""What our scenes lack: forces of people's lifts beside those of scenes felt by two pads.

Two functions: `force_rows` for a table (rates, order of load and grip, grip over load, duration,
tremor; by person and by scene), and `told_apart`: how well a learner tells lifts from scenes by the
quiet hold, and by which features. Neither decides anything; they say where to widen a scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier
from sklearn.metrics import roc_auc_score

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, FloatArray, IntArray
from holdfast.data.recording import (
    DataSet,
    Recording,
    StringArray,
    assign_groups,
    folds_of,
)
from holdfast.simulation.actions import EMPTY_HANDED
from holdfast.step.pooled import FAMILIES, PooledFeature
from holdfast.training.crossval import features_at, spec_for
from holdfast.training.plan import POOLED_GROUPS

SMOOTH_S = 0.05
"""Forces are means over this time before a rate is taken: a rate of the noise is below 1 N/s."""
ENDS_S = 1.5
"""A pick-up is over, and a put-down has not begun, so long from the contact's ends at most."""
AROUND_S = 0.1
"""A pick-up begins so long before the contact, a put-down ends so long after it."""
HOLD_AT = 0.6
"""The hold is looked at around this share of the grasp."""
HOLD_S = 0.3
"""Over so long a time: three quarters of the lifts last 0.7 s and more."""
TREMOR_HZ = (4.0, 12.0)
"""Physiological to essential tremor (Elble & Koller, "Tremor", 1990)."""
SETTLED_S = 0.7
"""So long after the contact a window's history of 0.5 s has no pick-up of a person in it."""
BEFORE_END_S = 0.2
"""A window of the quiet hold ends so long before the grasp does."""
WINDOWS = 3
"""Of a quiet hold."""
FOLDS = 5
TREES, DEPTH, LEAF = 60, 12, 8
STRONGEST = 5


@dataclass(frozen=True)
class ContactForces:
    """One contact in which nothing slips; nan where it does not show a measure.

    grip is the mean of both normal forces, load the sum of both loads as measured. *_up, *_down:
    the largest rate at the pick-up and at the put-down. grip_after_load_up_ms: from half of the
    hold's load to half of its grip as both rise; _down: as both fall, above 0 where the load falls
    first. tremor_mn: rms of the load from 4 to 12 Hz in the hold.
    """

    duration_s: float
    grip_n: float
    load_n: float
    grip_over_load: float
    grip_up_n_s: float
    load_up_n_s: float
    grip_down_n_s: float
    load_down_n_s: float
    grip_after_load_up_ms: float
    grip_after_load_down_ms: float
    tremor_mn: float


@dataclass(frozen=True)
class Quartiles:
    """25, 50 and 75 % of some values."""

    low: float
    median: float
    high: float


@dataclass(frozen=True)
class ForceRow:
    """A person, all people, a scene, or an action of a scene; kind says which.

    measures: name of a field of ContactForces -> its quartiles; empty without a contact.
    """

    name: str
    kind: str
    contacts: int
    measures: dict[str, Quartiles]


@dataclass(frozen=True)
class ToldApart:
    """How well a learner distinguishes lifts from scenes by a window of the quiet hold, people left
    out.

    auc: 0.5 where they are alike. strongest: (feature, importance), the first ones.
    """

    auc: float
    strongest: tuple[tuple[str, float], ...]
    lift_windows: int
    scene_windows: int


def force_rows(lifts: DataSet, scenes: Sequence[DataSet]) -> list[ForceRow]:
    """A row for each person, one for all of them, one for each scene of two pads and its actions.

    Actions without a contact that holds have no row.
    """
    rows = []
    for person in lifts.people():
        of_person = [one for one in lifts.recordings if one.person == person]
        rows.append(_row(person, "person", of_person))
    rows.append(_row("all people", "people", lifts.recordings))
    for scene in scenes:
        rows.append(_row(scene.name, "scene", scene.recordings))
        for action in sorted({one.action or "" for one in scene.recordings}):
            of_action = [one for one in scene.recordings if one.action == action]
            row = _row(f"{scene.name}: {action}", "action", of_action)
            if row.contacts:
                rows.append(row)
    return rows


def told_apart(lifts: DataSet, scenes: Sequence[DataSet], seed: int = 0) -> ToldApart:
    """Tell lifts from scenes of the same hand and rate by pooled features of the quiet hold.

    People and trials are held out in folds. Raises TooFewGroups.
    """
    features = []
    groups: list[StringArray] = []
    of_lifts = []
    for data in (lifts, *scenes):
        found, of_windows = _quiet_features(data)
        features.append(found)
        # names of two sets may be equal: a set's name makes its people and trials its own
        groups.append(np.char.add(f"{data.name}/", of_windows))
        of_lifts.append(np.full(len(found), data is lifts))

    values = np.concatenate(features)
    group = np.concatenate(groups)
    is_lift = np.concatenate(of_lifts)
    # Dealt apart, so that every fold has people and trials.
    fewest = min(len(set(group[of])) for of in (is_lift, ~is_lift))
    folds = min(FOLDS, fewest)
    dealt = assign_groups(group[is_lift], folds, seed=seed)
    dealt |= assign_groups(group[~is_lift], folds, seed=seed)

    score = np.zeros(len(values))
    importance = np.zeros(values.shape[1])
    for train, test in folds_of(group, dealt):
        forest = ExtraTreesClassifier(
            TREES,
            max_depth=DEPTH,
            min_samples_leaf=LEAF,
            class_weight="balanced",
            random_state=seed,
        )
        forest.fit(values[train], is_lift[train])
        score[test] = forest.predict_proba(values[test])[:, 1]
        importance += forest.feature_importances_ / FOLDS

    names = pooled_names()
    first = np.argsort(-importance)[:STRONGEST].tolist()
    return ToldApart(
        auc=float(roc_auc_score(is_lift, score)),
        strongest=tuple((names[k], float(importance[k])) for k in first),
        lift_windows=int(is_lift.sum()),
        scene_windows=int((~is_lift).sum()),
    )


def pooled_names() -> list[str]:
    """Names of the pooled features in their order, each with the time that it spans."""
    return [
        _spanned(one) for group in POOLED_GROUPS for one in FAMILIES[group].features
    ]


def contacts_of(recording: Recording) -> Iterator[tuple[int, int, int]]:
    """(first row, end of the grasp, end of the contact) of contacts in which nothing slips."""
    if recording.action in EMPTY_HANDED:
        return
    found: list[tuple[int, int, int]] = []
    slips = False
    last_stop = -1
    for phase in recording.phases:
        if phase.situation == NOTHING:
            continue
        if phase.situation == RISKY_SLIP:
            slips = True
        if found and last_stop == phase.first:
            first, grasped, _ = found[-1]
            found[-1] = (first, grasped, phase.stop)
        elif phase.situation == GRASP:
            found.append((phase.first, phase.stop, phase.stop))
        last_stop = phase.stop
    # a trial in which anything slips against the will shows no plain hold
    if not slips:
        yield from found


def forces_of(
    recording: Recording, first: int, grasped: int, stop: int
) -> ContactForces | None:
    """The measures of one contact; None where it is too short for a hold."""
    rate_hz = recording.rate_hz
    middle = first + int(HOLD_AT * (grasped - first))
    half = round(0.5 * HOLD_S * rate_hz)
    if middle - half <= first or middle + half >= stop:
        return None

    pads = recording.samples.reshape(len(recording.samples), 2, 3)
    # smoothed before the size is taken, so that noise is no load
    loads_n = np.abs(_smoothed(pads[:, :, 1], rate_hz)).sum(axis=1)
    grips_n = _smoothed(pads[:, :, 2], rate_hz).mean(axis=1)
    hold = slice(middle - half, middle + half)
    load_n = float(loads_n[hold].mean())
    grip_n = float(grips_n[hold].mean())

    around = round(AROUND_S * rate_hz)
    ends = round(ENDS_S * rate_hz)
    up = slice(max(0, first - around), min(middle, first + ends))
    down = slice(max(middle, stop - ends), stop + around)
    load_n_s = np.gradient(loads_n) * rate_hz
    grip_n_s = np.gradient(grips_n) * rate_hz
    row_ms = 1e3 / rate_hz

    load_rises = np.argmax(loads_n[up] >= 0.5 * load_n)
    grip_rises = np.argmax(grips_n[up] >= 0.5 * grip_n)
    load_falls = _last_above(loads_n[down], 0.5 * load_n)
    grip_falls = _last_above(grips_n[down], 0.5 * grip_n)
    raw_load_n = (np.sign(pads[hold, :, 1].mean(axis=0)) * pads[hold, :, 1]).sum(axis=1)
    return ContactForces(
        duration_s=(stop - first) / rate_hz,
        grip_n=grip_n,
        load_n=load_n,
        grip_over_load=grip_n / max(load_n, 1e-3),
        grip_up_n_s=float(grip_n_s[up].max()),
        load_up_n_s=float(load_n_s[up].max()),
        grip_down_n_s=float(-grip_n_s[down].min()),
        load_down_n_s=float(-load_n_s[down].min()),
        grip_after_load_up_ms=float(grip_rises - load_rises) * row_ms,
        grip_after_load_down_ms=float(grip_falls - load_falls) * row_ms,
        tremor_mn=1e3 * _band_rms(raw_load_n, rate_hz),
    )


def _row(name: str, kind: str, recordings: Sequence[Recording]) -> ForceRow:
    contacts = []
    for recording in recordings:
        for first, grasped, stop in contacts_of(recording):
            forces = forces_of(recording, first, grasped, stop)
            if forces is not None:
                contacts.append(forces)

    measures = {}
    for field in fields(ContactForces):
        values = [getattr(one, field.name) for one in contacts]
        if values:
            low, median, high = np.percentile(values, (25, 50, 75)).tolist()
            measures[field.name] = Quartiles(low, median, high)
    return ForceRow(name, kind, len(contacts), measures)


def _smoothed(values: FloatArray, rate_hz: float) -> FloatArray:
    """[T, C] centred means over SMOOTH_S."""
    width = max(1, 2 * round(0.5 * SMOOTH_S * rate_hz) + 1)
    kernel = np.full(width, 1.0 / width)
    columns = [np.convolve(column, kernel, mode="same") for column in values.T]
    return np.stack(columns, axis=1)


def _last_above(values: FloatArray, least: float) -> int:
    """The row after the last one that is at least so large; 0 where none is."""
    above = np.flatnonzero(values >= least)
    return int(above[-1]) + 1 if above.size else 0


def _band_rms(values: FloatArray, rate_hz: float) -> float:
    """Rms of values [T] in the tremor band, without their trend."""
    t = np.arange(len(values))
    left = values - np.polyval(np.polyfit(t, values, 1), t)
    spectrum = np.abs(np.fft.rfft(left)) / len(left)
    hz = np.fft.rfftfreq(len(left), 1.0 / rate_hz)
    inside = (hz >= TREMOR_HZ[0]) & (hz <= TREMOR_HZ[1])
    return float(np.sqrt(2.0 * (spectrum[inside] ** 2).sum()))


def _quiet_features(data: DataSet) -> tuple[FloatArray, StringArray]:
    """([M, F] pooled features at the windows of quiet holds, [M] their groups)."""
    wanted = [_quiet_rows(one) for one in data.recordings]
    found = features_at(data, spec_for(data, POOLED_GROUPS), wanted)
    groups = [one.group for one in data.recordings]
    counts = [len(rows) for rows in wanted]
    return np.concatenate(found).astype(np.float64), np.repeat(groups, counts)


def _quiet_rows(recording: Recording) -> IntArray:
    """Rows in the second half of each grasp that is long enough."""
    settled = round(SETTLED_S * recording.rate_hz)
    before_end = round(BEFORE_END_S * recording.rate_hz)
    rows: list[int] = []
    for first, grasped, _ in contacts_of(recording):
        start = max(first + settled, (first + grasped) // 2)
        stop = grasped - before_end
        if stop - start >= WINDOWS:
            rows += np.linspace(start, stop - 1, WINDOWS).astype(int).tolist()
    return np.array(sorted(rows), dtype=np.int64)


def _spanned(feature: PooledFeature) -> str:
    """A feature's name with the time that it spans, which families share a name over."""
    row = feature.ratios[0].row
    if row.kind in ("change", "mean") and row.span_s:
        return f"{feature.name} over {1e3 * row.span_s:.0f} ms"
    return feature.name
