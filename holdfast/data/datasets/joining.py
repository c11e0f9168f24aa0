"""One training set of several: of one hand, or where features are pooled of several hands.

Sets of several hands become one set with a part for those that are alike: features are computed
part by part, because each hand has a step of its own, and learned together, because pooled features
are the same numbers for any hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from holdfast.core.contract import CLASSES, RATE_TOLERANCE, SITUATIONS
from holdfast.core.errors import (
    ChannelError,
    DataError,
    LabelError,
    RateError,
    UnitError,
)
from holdfast.core.hand_card import hand_or_usual
from holdfast.data.recording import (
    DataSet,
    LabelledRows,
    Recording,
    SetOrigin,
    with_learned_weight,
)

MUST_AGREE: tuple[tuple[type[DataError], str], ...] = (
    (RateError, "rate in Hz"),
    (UnitError, "unit"),
    (ChannelError, "sensors"),
    (ChannelError, "sides"),
    (ChannelError, "axes that are not measured"),
    (LabelError, "tasks"),
    (DataError, "preparation"),
)
"""What one model's sets have in common, and the error where they do not."""
OF_A_PART = ("sensors", "sides", "axes that are not measured", "tasks", "preparation")
"""What the parts of a set of several hands differ in."""


def join(sets: Sequence[DataSet], *, several_hands: bool = False) -> DataSet:
    """One set of several, each with the windows it has, at the rate of the first.

    several_hands: sets of another hand, of another preparation or without weights are parts of it;
    the first set's hand and preparation are the model's. Else, where one set has no weights, none
    are learned. Trials and groups get their set's name before theirs, so that people of two sets
    stay two groups. Redistributable only if all are. Raises RateError, UnitError, ChannelError,
    LabelError or DataError.
    """
    first, *others = sets
    if not others:
        return first

    alike = _those_alike(sets) if several_hands else [list(sets)]
    for of_part in alike:
        _require_alike(of_part[0], first, but=OF_A_PART)
    origins = tuple(SetOrigin.of(data) for data in sets)
    parts = [_of_one_hand([_named(data) for data in of_part]) for of_part in alike]
    # The same trials twice would be on both sides of a split, as two groups.
    names = [data.name for data in sets]
    if len(set(names)) < len(names):
        raise DataError(
            f"the same set twice ({', '.join(names)})", next_step="give every set once"
        )
    if len(parts) == 1:
        return replace(parts[0], origins=origins)
    return replace(of_several_hands(parts), origins=origins)


def of_several_hands(parts: Sequence[DataSet]) -> DataSet:
    """One set of these parts; its hand, unit and preparation are those of the first.

    A part without weights takes part in the eight classes with light and heavy windows in turn, so
    that it says nothing of the weight. Where no part has weights, the four situations are learned.
    """
    with_weight = [part for part in parts if "classes" in part.tasks]
    if with_weight:
        # Where the windows with a weight cannot teach it, it is not learned.
        known = with_learned_weight(_concatenated(with_weight))
        if "classes" not in known.tasks:
            parts = [part.without_weight() for part in parts]
    whole = parts
    if any("classes" in part.tasks for part in parts):
        whole = [_of_either_weight(part) for part in parts]
    return replace(_concatenated(whole), parts=tuple(parts))


def _of_either_weight(part: DataSet) -> DataSet:
    """The part with eight classes: where it knows no weight, light and heavy in turn."""
    if "classes" in part.tasks:
        return part
    tasks = dict(part.tasks)
    rows = tasks.pop("situations")
    heavy = np.zeros(len(rows), dtype=np.int64)
    for situation in range(len(SITUATIONS)):
        of_situation = np.flatnonzero(rows.label == situation)
        heavy[of_situation[1::2]] = 1
    tasks["classes"] = replace(rows, label=2 * rows.label + heavy, classes=CLASSES)
    return replace(part, tasks=tasks)


def _those_alike(sets: Sequence[DataSet]) -> list[list[DataSet]]:
    """The sets that can be one part together, the first set's part first."""
    parts: dict[object, list[DataSet]] = {}
    for data in sets:
        hand = hand_or_usual(data.hand, data.n_sensors)
        of_hand = hand and (hand.sensor_sides, hand.unmeasured_names)
        alike = (data.n_sensors, of_hand, tuple(sorted(data.tasks)), data.preparation)
        parts.setdefault(alike, []).append(data)
    return list(parts.values())


def _named(data: DataSet) -> DataSet:
    """The set with its name before the names of trials and groups."""
    recordings = []
    for recording in data.recordings:
        named = replace(
            recording,
            trial_id=f"{data.name}/{recording.trial_id}",
            group=f"{data.name}/{recording.group}",
            set_name=data.name,
        )
        recordings.append(named)
    return replace(data, recordings=recordings)


def _of_one_hand(sets: Sequence[DataSet]) -> DataSet:
    """One set of several of one hand."""
    # Sets that differ in the weight alone have the situations in common.
    if any("situations" in data.tasks for data in sets):
        sets = [data.without_weight() for data in sets]
    first, *others = sets
    for other in others:
        _require_alike(other, first)
    # A set without a card fits any hand, so those with one are compared with each other.
    with_card = [data for data in sets if data.hand is not None]
    for other in with_card[1:]:
        _require_alike(other, with_card[0])
    return replace(_concatenated(sets), hand=with_card[0].hand if with_card else None)


def _concatenated(sets: Sequence[DataSet]) -> DataSet:
    """Recordings and windows of all sets, one after another; all else as the first set has it."""
    first = sets[0]
    recordings: list[Recording] = []
    parts: dict[str, list[LabelledRows]] = {task: [] for task in first.tasks}
    for data in sets:
        # Trials are numbered on where those of the sets before end.
        for task, rows in data.tasks.items():
            parts.setdefault(task, []).append(
                replace(rows, trial=rows.trial + len(recordings))
            )
        recordings += data.recordings
    return replace(
        first,
        name=" + ".join(data.name for data in sets),
        recordings=recordings,
        tasks={task: LabelledRows.concatenated(rows) for task, rows in parts.items()},
        kind=_each_once(" + ", sets, "kind"),
        redistributable=all(data.redistributable for data in sets),
        caveat=_each_once(" ", sets, "caveat"),
        notes={},
        group_kind=_each_once(" and by ", sets, "group_kind"),
        forces_verified=all(data.forces_verified for data in sets),
    )


def _require_alike(other: DataSet, first: DataSet, but: Sequence[str] = ()) -> None:
    """Check that one model fits both sets. but: what they may differ in.

    Raises RateError, UnitError, ChannelError, LabelError or DataError.
    """
    # A rate that is near enough counts as the same, and a set without a card fits any hand.
    is_near = abs(other.rate_hz / first.rate_hz - 1.0) <= RATE_TOLERANCE
    rate_hz = first.rate_hz if is_near else other.rate_hz
    ours, theirs = other.hand or first.hand, first.hand or other.hand
    pairs: dict[str, tuple[object, object]] = {
        "rate in Hz": (rate_hz, first.rate_hz),
        "unit": (other.unit, first.unit),
        "sensors": (other.n_sensors, first.n_sensors),
        "sides": (ours and ours.sensor_sides, theirs and theirs.sensor_sides),
        "axes that are not measured": (
            ours and ours.unmeasured_names,
            theirs and theirs.unmeasured_names,
        ),
        "tasks": (sorted(other.tasks), sorted(first.tasks)),
        "preparation": (other.preparation, first.preparation),
    }
    for error, name in MUST_AGREE:
        one, reference = pairs[name]
        if name in but or one == reference:
            continue
        next_step = "use sets that were recorded alike, or one of them alone"
        if name in OF_A_PART:
            next_step += "; sets of several hands: --features pooled"
        raise error(
            f"{other.name} differs in {name}: {one}, not {reference}",
            where=other.name,
            cause=f"recorded with other settings than {first.name}",
            next_step=next_step,
        )


def _each_once(separator: str, sets: Sequence[DataSet], name: str) -> str:
    """The texts of this name, each of them once, in order of the sets."""
    return separator.join(dict.fromkeys(getattr(data, name) for data in sets))
