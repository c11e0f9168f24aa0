"""Recordings, their labelled windows, and a data set of both: what every reader returns.

Training and test sets: a group is never on both sides of a split.

A group is what is held out together: all trials of a person, of an object (or a block), or one
trial at a time. Intervals resample groups. Folds are dealt here and not by scikit-learn's splitters
(GroupKFold, StratifiedGroupKFold): theirs differ, and the published figures rest on these.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    NOTHING,
    SITUATIONS,
    BoolArray,
    FloatArray,
    IntArray,
    Json,
    Unit,
)
from holdfast.core.errors import ClassMissing, TooFewGroups, count_of
from holdfast.data.timeline import Phase, RiskyEvent
from holdfast.edge_runtime.preparation import Preparation
from holdfast.step.spec import GAP_S, HISTORY_S

if TYPE_CHECKING:
    from holdfast.core.hand_card import HandCard

StringArray = npt.NDArray[np.str_]


@dataclass(frozen=True)
class Recording:
    """One trial, as it was recorded, unit and rate known.

    trial_id: unique in its set. group: the person (or block, object, trial) that must not be split.
    samples: [T, C] float64, *prepared* (bias removed, magnets turned the right way round).
    valid: [T, C/3]. rate_hz: from the time stamps where there are any.
    object_name, action: None where the set has no such notion. phases: what happens when, in rows;
    those in no phase have no label. events: grips that fail. person: None where none is named.
    left_out: [first, stop) rows that no figure counts, because a sensor was broken there.
    set_name: the set it is of, where sets were joined.
    """

    trial_id: str
    group: str
    samples: FloatArray
    valid: BoolArray
    rate_hz: float
    unit: Unit
    object_name: str | None = None
    action: str | None = None
    phases: tuple[Phase, ...] = ()
    events: tuple[RiskyEvent, ...] = ()
    person: str | None = None
    left_out: tuple[tuple[int, int], ...] = ()
    set_name: str = ""

    @property
    def n_sensors(self) -> int:
        return self.samples.shape[1] // 3

    def counted(self, n_rows: int) -> BoolArray:
        """[n_rows] which rows figures count; evaluation keeps recordings without samples."""
        counted = np.ones(n_rows, dtype=np.bool_)
        for first, stop in self.left_out:
            counted[first:stop] = False
        return counted

    def counted_s(self, n_rows: int) -> float:
        """How long the rows last that figures count, in s. n_rows: all rows."""
        return int(self.counted(n_rows).sum()) / self.rate_hz


def finite_sensors(raw: FloatArray) -> BoolArray:
    """[T, C] -> [T, C/3]: True where all three channels of a sensor are finite."""
    # A reading is of three axes, so one bad axis makes the whole reading unusable.
    by_sensor = np.isfinite(raw).reshape(len(raw), -1, 3)
    return np.logical_and.reduce(by_sensor, axis=2)


def whole_history(recording: Recording) -> BoolArray:
    """[T] False while the whole hand is lost for more than a short gap, and HISTORY_S after it."""
    whole = np.ones(len(recording.valid), dtype=np.bool_)
    for first, stop in lost_spans(recording.valid):
        if (stop - first) / recording.rate_hz > GAP_S + 1e-9:
            settled = math.floor(HISTORY_S * recording.rate_hz + 1e-9)
            whole[first : stop + settled] = False
    return whole


def lost_spans(valid: BoolArray) -> list[tuple[int, int]]:
    """[first, stop) rows of every run in which no sensor [T, S] is valid."""
    firsts, stops = runs_of(np.asarray(~valid.any(axis=1)))
    return list(zip(firsts.tolist(), stops.tolist(), strict=True))


def runs_of(flags: BoolArray) -> tuple[IntArray, IntArray]:
    """First rows of the runs of flags [T], and the rows after their last."""
    # A zero on both sides makes a run at either end begin and stop like any other.
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return edges[::2], edges[1::2]


@dataclass(frozen=True)
class LabelledRows:
    """Windows of one task: the last row of each, and its label.

    trial: [M] index into the set's recordings. row: [M] last row of the window. label: [M].
    classes: name of each label value (label k means classes[k]).
    """

    trial: IntArray
    row: IntArray
    label: IntArray
    classes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.label)

    def class_counts(self) -> dict[str, int]:
        """Windows of each class, by name, zeros included."""
        counts = np.bincount(self.label, minlength=len(self.classes))
        return dict(zip(self.classes, counts.tolist(), strict=True))

    def take(self, keep: npt.NDArray[Any]) -> LabelledRows:
        """The same task on a subset of the windows (boolean mask or indices)."""
        return LabelledRows(
            self.trial[keep], self.row[keep], self.label[keep], self.classes
        )

    @staticmethod
    def concatenated(parts: Sequence[LabelledRows]) -> LabelledRows:
        """The windows of all parts, one after the other, with the classes of the first."""
        joined = {}
        for name in ("trial", "row", "label"):
            values = np.concatenate([getattr(part, name) for part in parts])
            joined[name] = values.astype(np.int64)
        return LabelledRows(**joined, classes=parts[0].classes)

    def of_situations(self) -> LabelledRows:
        """The same windows labelled with the four situations, from these or the eight classes."""
        # Classes are in order of their situation: situation 0 light, 0 heavy, 1 light, and so on.
        per_situation = len(self.classes) // len(SITUATIONS)
        return replace(self, label=self.label // per_situation, classes=SITUATIONS)

    def of_trials(self, index: list[int]) -> LabelledRows:
        """The windows of the recordings at these ascending places, numbered anew."""
        kept = self.take(np.isin(self.trial, index))
        return replace(kept, trial=np.searchsorted(index, kept.trial).astype(np.int64))


def counts_in_words(counts: Mapping[str, int]) -> str:
    """Windows by class or situation: "30 windows (grasp 10, nothing 20)"."""
    cells = ", ".join(f"{name} {count:,}" for name, count in counts.items())
    return f"{sum(counts.values()):,} windows ({cells})"


@dataclass(frozen=True)
class SetOrigin:
    """What a model's card says of one of several sets that it learned from.

    hand: name of its card, "" where it has none. people: of its recordings, sorted. licence,
    source: of a public set.
    """

    name: str
    kind: str
    hand: str
    sensors: int
    rate_hz: float
    recordings: int
    minutes: float
    people: tuple[str, ...]
    redistributable: bool
    licence: str
    source: str

    @classmethod
    def of(cls, data: DataSet) -> SetOrigin:
        """What an artifact remembers of a set."""
        seconds = sum(one.counted_s(len(one.samples)) for one in data.recordings)
        return cls(
            name=data.name,
            kind=data.kind,
            hand=data.hand.name if data.hand else "",
            sensors=data.n_sensors,
            rate_hz=data.rate_hz,
            recordings=len(data.recordings),
            minutes=seconds / 60.0,
            people=tuple(data.people()),
            redistributable=data.redistributable,
            licence=data.licence,
            source=data.source,
        )


@dataclass(frozen=True)
class DataSet:
    """Recordings and the tasks that can be learned from them.

    tasks: "situations" (labels 0..3) or "classes" (labels 0..7), and further heads such as
    "predict_250ms" (labels 0/1). rate_hz: the median over the recordings.
    redistributable: False for sets without a licence; what is made from them stays in build/.
    caveat: the sentence that must stand with every number from this set.
    notes: what a reader reports of the set, such as counts of windows, by name.
    group_kind: what a group is: person, object, trial or block.
    hand: its hand card, None where the set has none.
    forces_verified: thresholds in N mean what they say; False where the calibration is unknown.
    licence, source: of a public set, for the card of a model. origins: of a set that joins several.
    parts: where it joins several hands, the sets that are alike together; their recordings and
    windows are its own, in this order.
    """

    name: str
    recordings: list[Recording]
    tasks: dict[str, LabelledRows]
    rate_hz: float
    unit: Unit
    preparation: Preparation
    kind: str
    redistributable: bool
    caveat: str
    notes: Json = field(default_factory=dict)
    group_kind: str = "trial"
    hand: HandCard | None = None
    forces_verified: bool = True
    licence: str = ""
    source: str = ""
    origins: tuple[SetOrigin, ...] = ()
    parts: tuple[DataSet, ...] = ()

    @property
    def n_sensors(self) -> int:
        return self.recordings[0].n_sensors

    def groups(self) -> list[str]:
        """The distinct groups (people, blocks), sorted."""
        return sorted({recording.group for recording in self.recordings})

    def people(self) -> list[str]:
        """The people who are named, sorted."""
        return sorted({one.person for one in self.recordings if one.person})

    def with_situations(self) -> DataSet:
        """The same set with a task "situations", made from the eight classes where it has none."""
        if "situations" in self.tasks:
            return self
        return replace(self, tasks=self.without_weight().tasks | self.tasks)

    def without_weight(self) -> DataSet:
        """The same set with the four situations in place of the eight classes, if it has these."""
        tasks = dict(self.tasks)
        if "classes" in tasks:
            tasks["situations"] = tasks.pop("classes").of_situations()
        parts = tuple(part.without_weight() for part in self.parts)
        return replace(self, tasks=tasks, parts=parts)

    def group_of(self, task: str) -> StringArray:
        """[M] group of every window of a task."""
        names = np.array([recording.group for recording in self.recordings])
        return names[self.tasks[task].trial]

    def set_of(self, task: str) -> StringArray:
        """[M] name of the set that every window of a task is of; "" where none were joined."""
        names = np.array([recording.set_name for recording in self.recordings])
        return names[self.tasks[task].trial]

    def of_groups(self, names: Collection[str]) -> DataSet:
        """The part of the set that these people (or blocks) recorded; the set's rate stays."""
        index = [k for k, one in enumerate(self.recordings) if one.group in names]
        kept = [self.recordings[k] for k in index]
        tasks = {task: rows.of_trials(index) for task, rows in self.tasks.items()}
        parts = tuple(part.of_groups(names) for part in self.parts)
        return replace(self, recordings=kept, tasks=tasks, parts=parts)


WEIGHT = "weight"
"""Light or heavy, among what a model cannot tell."""
NOT_SHOWN = {
    "nothing": "no empty hand",
    "grasp": "no object that is held",
    "safe_slip": "no voluntary release",
    "risky_slip": "no object that slips against the will",
}
"""What data without a situation do not show."""


def learnable(data: DataSet) -> DataSet:
    """The set as a model learns it, whatever situations and weights it has.

    Without weights where a situation has only light or only heavy objects: a model of those would
    take the situation for the weight. Raises ClassMissing where there is nothing to tell apart.
    """
    data = with_learned_weight(data)
    for task, rows in data.tasks.items():
        # Light and heavy of one situation are nothing to tell apart.
        if task == "classes":
            rows = rows.of_situations()
        present = [name for name, count in rows.class_counts().items() if count]
        if len(present) < 2:
            raise ClassMissing(
                f"task {task}: windows of {' and '.join(present) or 'no class'} alone, "
                "which leaves nothing to tell apart",
                where=data.name,
                cause="recordings of one kind, or too few were chosen",
                next_step="add trials in which the object slips, and trials in which it is held "
                "(holdfast check says what is there)",
            )
    return data


def with_learned_weight(data: DataSet) -> DataSet:
    """The set without weights where a situation has only light or only heavy objects."""
    rows = data.tasks.get("classes")
    return data.without_weight() if rows and _of_one_weight(rows) else data


def cannot_tell(data: DataSet, *, by_force: bool) -> dict[str, str]:
    """What a model of this set cannot tell: situations and WEIGHT, with the reason of each.

    by_force: the model's contact rule tells "nothing", also where no window shows it.
    """
    not_learned = {}
    situations = data.with_situations().tasks["situations"]
    for name, count in situations.class_counts().items():
        by_rule = by_force and name == SITUATIONS[NOTHING]
        if not count and not by_rule:
            not_learned[name] = f"{NOT_SHOWN[name]} in the training data"
    if "classes" not in data.tasks:
        not_learned[WEIGHT] = "the training data lack masses, or light or heavy objects"
    return not_learned


def _of_one_weight(rows: LabelledRows) -> bool:
    """Whether a situation with contact occurs with light objects or with heavy ones alone."""
    # rows: situations; columns: light, heavy
    counts = np.reshape(list(rows.class_counts().values()), (-1, 2))
    held = counts[NOTHING + 1 :] > 0
    return bool(np.any(held[:, 0] != held[:, 1]))


Fold = tuple[IntArray, IntArray]
"""Training rows and test rows, both ascending."""


def assign_groups(
    groups: npt.ArrayLike, n_folds: int, *, seed: int = 0
) -> dict[str, int]:
    """Fold of every group, from the group names [M] of all windows.

    Groups are dealt largest first, one to each fold a round, in seeded random order within a round:
    folds get equally many groups (+-1), and their windows differ by at most the largest group's.
    Raises TooFewGroups where there are fewer groups than folds, or fewer than two folds.

    >>> sorted(assign_groups(["a", "a", "b", "c", "d"], 2).values())
    [0, 0, 1, 1]
    """
    names, sizes = np.unique(np.asarray(groups, dtype=str), return_counts=True)
    if n_folds < 2 or len(names) < n_folds:
        fewer = f"use {len(names)} folds"
        raise TooFewGroups(
            f"{count_of(len(names), 'group')} (people, blocks) cannot make {n_folds} folds",
            cause="the set holds too few people",
            next_step=fewer if len(names) > 1 else "add recordings of other people",
        )
    rng = np.random.default_rng(seed)
    # Largest first, so that every round deals groups of like size.
    by_size = names[np.argsort(-sizes, kind="stable")]

    assignment: dict[str, int] = {}
    for k in range(0, len(names), n_folds):
        dealt = by_size[k : k + n_folds].tolist()
        folds = rng.permutation(n_folds).tolist()
        # The last round may have fewer groups than folds.
        assignment.update(zip(dealt, folds, strict=False))
    return assignment


def folds_of(groups: npt.ArrayLike, assignment: dict[str, int]) -> list[Fold]:
    """Training and test rows of every fold, for windows of these groups [M]."""
    names = np.asarray(groups, dtype=str).tolist()
    fold = np.array([assignment[name] for name in names], dtype=np.int64)
    numbers = sorted(set(assignment.values()))
    return [(np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in numbers]


HoldOut = Literal["person", "object", "trial"]
NO_OBJECT = "-"
"""The object of a recording of the hand alone, where a name is needed."""


def grouped(recordings: Sequence[Recording]) -> tuple[list[Recording], HoldOut]:
    """The recordings with their groups, and the kind of these.

    People are the groups where there are two or more; else every trial is its own.
    """
    people = {recording.person for recording in recordings} - {None}
    kind: HoldOut = "person" if len(people) > 1 else "trial"
    return _grouped_by(recordings, kind), kind


def regrouped(data: DataSet, by: HoldOut) -> DataSet:
    """The same set held out by something else. Raises TooFewGroups with less than two groups."""
    recordings = _grouped_by(data.recordings, by)
    regrouped_set = replace(data, recordings=recordings, group_kind=by)
    why_not = f"one {by} alone" if len(regrouped_set.groups()) < 2 else ""
    # A recording without a person could be of one on the other side of a split.
    people = [one.person for one in data.recordings]
    if by == "person" and not all(people):
        why_not = "some trials name no person"
        if not any(people):
            why_not = "the set names no people"
    if why_not:
        raise TooFewGroups(
            f"the recordings cannot be held out by {by}",
            where=data.name,
            cause=why_not,
            next_step=_NEXT[by],
        )
    return regrouped_set


_NEXT = {
    "person": "sort trials into <person>/<object>/<action>/, or hold out by trial",
    "object": "record another object, or hold out by trial",
    "trial": "record more trials",
}


def _grouped_by(recordings: Sequence[Recording], by: HoldOut) -> list[Recording]:
    """The recordings in groups; one without a person is a group of its own, by its trial."""
    result = []
    for recording in recordings:
        # A trial without a person is held out alone, since it may be of any of them.
        group = recording.trial_id
        if by == "person" and recording.person:
            group = recording.person
        elif by == "object":
            group = recording.object_name or NO_OBJECT
        result.append(replace(recording, group=group))
    return result
