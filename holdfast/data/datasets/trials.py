"""The trials of a folder: where they are, and reading them one by one.

A trial is `[<person>/]<object>/<action>/trial_<n>.csv`. Folders of people are optional. The hand
alone is `nothing/trial_<n>.csv` or `nothing.csv`, in the root or, where there are people, in a
person's folder. Finding and reading are two steps, so that a check can go on after a fault.

What cannot be right is refused where a trial is read, by every verb. What can hardly be right is a
doubt: `check` lists it, and `train` and `evaluate` warn of it.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NoReturn, TypeVar

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    NORMAL_FLOOR,
    NOTHING,
    RISKY_SLIP,
    SITUATIONS,
    BoolArray,
    FloatArray,
    channel_names,
)
from holdfast.core.errors import (
    ChannelError,
    DataError,
    EmptyRecording,
    LabelError,
    UnitError,
    count_of,
)
from holdfast.core.hand_card import HandCard, hand_or_usual, read_hand_card
from holdfast.core.trial_file import Trial
from holdfast.core.trial_layout import (
    HAND_FILE,
    META,
    SITUATION_OF_ACTION,
    UNSCRIPTED,
    plain_word,
    read_json,
    truth_path,
)
from holdfast.data.recording import DataSet, Recording, whole_history
from holdfast.data.windows import TimedTrial
from holdfast.step.spec import HISTORY_S

EMPTY_HAND = "nothing"
"""The name of the folder or file of the hand alone."""
FOLDERS = tuple(dict.fromkeys((*SITUATION_OF_ACTION, *UNSCRIPTED)))
"""The actions that a folder can be named after."""
_ACTION_OF = {plain_word(action): action for action in FOLDERS}
TRIAL_NAME = re.compile(r"trial_(\d+)\.csv")
"""The file of a trial, and its number."""
KEYS_OF_A_SET = {"unit", "kind"}
"""A meta.json with one of these describes a set of its own."""
HARDEST_SIDE_N = 200.0
"""No hand presses harder, N of either side."""
AFTER_S = 0.5
"""Labels may reach so far beyond the last row."""
OPEN_HAND_N = 1.0
"""A hand that holds nothing presses with less a side."""
FAR_S = 1.0
"""A label may begin so far from any change of load."""
PRESSED_FLOORS, PRESSED_S = 2.0, 0.1
"""A sensor is pressed where its normal reading exceeds so many touches for so long."""
MOSTLY = 9
"""A sensor reads below zero on a press where so many of its rows do for one that does not."""
DEEP = 0.5
"""Of its largest reading: a sensor that reads so far below zero was tared in a press."""
TORN = "the file was cut off, or rows were removed from it"
One = TypeVar("One")
Fault = Callable[[DataError], None]
"""What a reader does with a trial or folder that it cannot use."""


def refuse(error: DataError) -> NoReturn:
    """The first fault ends the reading."""
    raise error


def hand_beside(root: Path, fault: Fault = refuse) -> HandCard | None:
    """The hand card in the folder of a set, None without one. fault: of a card that is wrong."""
    path = root / HAND_FILE
    try:
        return read_hand_card(path) if path.is_file() else None
    except DataError as error:
        fault(error)
        return None


def require_offered(root: Path, channels: int, offered: Iterable[int]) -> None:
    """Raise ChannelError where a set does not offer that number of channels."""
    numbers = sorted(offered)
    if channels not in numbers:
        raise ChannelError(
            f"recordings of {' or '.join(map(str, numbers))} channels, not {channels}",
            where=root,
            cause="a model made for other sensors",
            next_step="holdfast export MODEL --hand CARD --out FILE, where MODEL has pooled "
            "features, as the shipped one has (CARD: these sensors, docs/your-data.md); or "
            f"holdfast train --data {root} --out DIR",
        )


@dataclass(frozen=True)
class TrialPlace:
    """Where a trial is; `object_folder` and `action` are None for the hand alone.

    person: None where the set has no folders of people.
    """

    path: Path
    object_folder: Path | None = None
    action: str | None = None
    person: str | None = None


@dataclass(frozen=True)
class TrialReader:
    """A trial's place, and the function that reads, prepares and labels it."""

    place: TrialPlace
    read: Callable[[], TimedTrial]


def has_thesis_layout(root: Path) -> bool:
    """Whether a folder, or that of a person in it, holds an `<object>/<action>/trial_<n>.csv`."""
    return _has_actions(_trials(root, 2)) or bool(people_of(root))


def people_of(root: Path) -> list[Path]:
    """The folders of people, by name; none where no folder holds objects with known actions.

    A folder that is a set itself is no person's.
    """
    trials = {}
    for folder in sorted(root.glob("*/")):
        if not KEYS_OF_A_SET & read_json(folder / META).keys():
            trials[folder] = _trials(folder, 2)

    # Only names of actions show that a level of folders is people and not objects.
    if not any(map(_has_actions, trials.values())):
        return []
    return [folder for folder, paths in trials.items() if paths]


def places(root: Path, fault: Fault = refuse) -> Iterator[TrialPlace]:
    """Every trial of the folder: people, objects and actions by name, trials by number.

    fault: receives a LabelError for each folder that is no action, or has no person.
    """
    people = people_of(root)
    for person in people:
        yield from _of_one_hand(person, person.name, fault)
    for place in _of_one_hand(root, None, fault):
        if not people:
            yield place
        elif place.object_folder is None or place.action != EMPTY_HAND:
            within = place.path.relative_to(root).as_posix()
            error = LabelError(
                "a trial without a person, in a set with folders of people",
                where=place.path,
                cause="trials of the hand alone belong to a person too",
                next_step=f"move it to {root.name}/<person>/{within}",
            )
            fault(error)
        elif place.object_folder not in people:
            # `p03/nothing/trial_1.csv` of a person without any other trial
            yield TrialPlace(place.path, person=place.object_folder.name)


def _of_one_hand(home: Path, person: str | None, fault: Fault) -> Iterator[TrialPlace]:
    """The trials of one person, or of a folder without people, by object and action."""
    for path in sorted(_trials(home, 1) + _trials(home, 2), key=_order):
        folder = path.parent
        if folder.parent == home:
            if plain_word(folder.name) == EMPTY_HAND:
                yield TrialPlace(path, person=person)
        elif plain_word(folder.parent.name) != EMPTY_HAND:
            action = action_of(folder.name)
            if action is not None:
                yield TrialPlace(path, folder.parent, action, person)
                continue
            known = ", ".join(FOLDERS)
            error = LabelError(
                f"{folder.name!r} is not an action",
                where=folder,
                next_step=f"name the folder one of {known}, or move it out of the set",
            )
            fault(error)

    if (home / f"{EMPTY_HAND}.csv").is_file():
        yield TrialPlace(home / f"{EMPTY_HAND}.csv", person=person)


def action_of(name: str) -> str | None:
    """The action that a folder is named after, in any spelling; None for another name."""
    return _ACTION_OF.get(plain_word(name))


def _has_actions(trials: Iterable[Path]) -> bool:
    return any(action_of(path.parent.name) for path in trials)


def _trials(home: Path, depth: int) -> list[Path]:
    """Files so many folders below that are named as trials are, whatever the folders are called."""
    paths = home.glob("*/" * depth + "trial_*.csv")
    return [path for path in paths if TRIAL_NAME.fullmatch(path.name)]


def _order(path: Path) -> tuple[Path, int, Path]:
    # By number and not by name, where trial_10 would come before trial_2.
    return path.parent, int(path.stem.removeprefix("trial_")), path


class DoubtfulData(UserWarning):
    """Recordings that can be read, and whose figures are probably wrong."""


@dataclass(frozen=True)
class Missing:
    """Something that is missing or wrong: where, and what to write or record there.

    level: an error keeps the folder from being read, or the trial; doubt: its figures are probably
    wrong; training: it can be evaluated on, but not trained on; advice: it works as it is, and more
    data would bring something.
    """

    level: Literal["error", "doubt", "training", "advice"]
    where: str
    what: str
    next_step: str


# -- what is refused


def require_whole(trial: Trial, labels_end_s: float, recorded: int | None) -> None:
    """Raise LabelError for labels after the last row, and EmptyRecording for rows that are missing.

    recorded: how many samples the recorder counted, None where that is not known.
    """
    rows = len(trial.t_s) if trial.rows is None else len(trial.rows)
    if recorded is not None and rows < recorded:
        raise EmptyRecording(
            f"{rows} rows, and meta.json says {recorded}",
            where=trial.path,
            cause=TORN,
            next_step="copy the trial again, or move it out of the set",
        )
    if labels_end_s > trial.t_s[-1] + AFTER_S:
        raise LabelError(
            f"labels reach {labels_end_s:.2f} s, and the last row is at {trial.t_s[-1]:.2f} s",
            where=trial.path,
            cause=TORN,
            next_step=f"copy the trial again, or correct {truth_path(trial.path).name}",
        )


def require_possible(recording: Recording, path: Path) -> None:
    """Raise UnitError for forces that no hand has."""
    side_n = _of_a_side(recording)
    if recording.unit == "N" and side_n > HARDEST_SIDE_N:
        raise UnitError(
            f"presses with {side_n:.4g} N a side, and no hand with more than {HARDEST_SIDE_N:g} N",
            where=path,
            cause="millinewtons or counts that are called N",
            next_step="holdfast import --unit takes other units; or write the unit to meta.json",
        )


def _of_a_side(recording: Recording) -> float:
    """The normal force of a side, but for the highest hundredth of the rows."""
    # both sides press alike, so that half of all is a side's
    return 0.5 * float(np.quantile(_load(recording), 0.99))


def _load(recording: Recording) -> FloatArray:
    """[T] the sum of what the sensors read along their normals; a lost one reads nothing."""
    normal = np.abs(recording.samples[:, NORMAL_AXIS::3])
    load: FloatArray = np.where(recording.valid, normal, 0.0).sum(axis=1)
    return load


def require_history(recording: Recording, path: Path) -> BoolArray:
    """[T] where the history of samples is whole. Raises EmptyRecording where nothing is left."""
    whole = whole_history(recording)
    # the first rows of a trial are no history either
    settled = round(HISTORY_S * recording.rate_hz)
    if not whole.all() and not whole[settled:].any():
        raise EmptyRecording(
            f"nothing is left: no {HISTORY_S:g} s without lost samples",
            where=path,
            cause="the machine is too slow for this rate, or it was suspended",
            next_step="record again, at a lower rate",
        )
    return whole


# -- what is doubtful


def doubts_of(
    trials: Sequence[TimedTrial], most_n: float | None = None
) -> Iterator[Missing]:
    """The doubts about trials of one set. most_n: the largest grip of the hand, where given."""
    yield from _turned(trials)
    for trial in trials:
        for name in trial.denied:
            what = f"column {name} has numbers, and {HAND_FILE} says that it is not measured: "
            what += "0.0 is read in its place"
            step = f"correct measures in {HAND_FILE}, or leave the column out"
            yield Missing("doubt", trial.recording.trial_id, what, step)
        yield from _far_labels(trial)
        recording = trial.recording
        first = min(recording.phases, key=lambda phase: phase.first, default=None)
        if first and first.first == 0 and first.situation != NOTHING:
            # of what was held from the first row on, the grip is the bias
            grip = recording.samples[: first.stop, NORMAL_AXIS::3].sum(axis=1)
            if recording.unit == "N" and np.median(np.nan_to_num(grip)) > OPEN_HAND_N:
                what = (
                    f"is called {SITUATIONS[first.situation]} from its first row on, "
                )
                what += "and presses only later"
                yield Missing("doubt", recording.trial_id, what, "label the open hand")
        side_n = _of_a_side(recording)
        is_open = {phase.situation for phase in recording.phases} == {NOTHING}
        is_open &= recording.action in (None, EMPTY_HAND)
        if is_open and recording.unit == "N" and side_n > OPEN_HAND_N:
            what = f"an open hand that presses with {side_n:.3g} N a side"
            step = "name what happens in it, or correct its unit"
            yield Missing("doubt", recording.trial_id, what, step)
        if most_n is not None and recording.unit == "N" and side_n > most_n:
            what = (
                f"presses with {side_n:.4g} N a side, more than ceiling_n = {most_n:g}"
            )
            step = "correct the unit of the trial, or ceiling_n in holdfast.toml"
            yield Missing("doubt", recording.trial_id, what, step)


def sides_unknown(data: DataSet, root: Path) -> Iterator[Missing]:
    """A doubt where no card says on which side of the hand the sensors of a set are."""
    if hand_or_usual(data.hand, data.n_sensors) is None:
        what = f"{count_of(data.n_sensors, 'sensor')} and no hand card: pooled features take each "
        what += "to be on the side of the fingers"
        step = "write which are on the thumb's side (docs/scenes.md, hands)"
        yield Missing("doubt", str(root / HAND_FILE), what, step)


def silent_axes(data: DataSet, root: Path) -> Iterator[Missing]:
    """A doubt for each axis that stays 0.0 throughout, of a sensor that the card says has it."""
    if data.hand is None:
        return
    moves = np.zeros(3 * data.n_sensors, dtype=np.bool_)
    for recording in data.recordings:
        moves |= (np.nan_to_num(recording.samples) != 0.0).any(axis=0)
    # of a sensor that nothing touched all three axes are silent
    touched = np.repeat(moves.reshape(-1, 3).any(axis=1), 3)
    silent = data.hand.measured & touched & ~moves
    for name in np.array(channel_names(data.n_sensors))[silent].tolist():
        what = f"column {name} stays 0.0 throughout, and {HAND_FILE} says that it is measured"
        step = f'write measures = "yz" (or "xz") for its sensor in {HAND_FILE}'
        yield Missing("doubt", str(root), what, step)


def warn_of(doubts: Iterable[Missing]) -> None:
    """A warning for each kind of doubt, with the first that was met."""
    for first, *others in by_kind(doubts, lambda one: one.next_step).values():
        more = f" (and {len(others)} more like it)" if others else ""
        warnings.warn(
            f"{first.where}: {first.what}{more}; next: {first.next_step}",
            DoubtfulData,
            stacklevel=4,
        )


def by_kind(found: Iterable[One], kind: Callable[[One], str]) -> dict[str, list[One]]:
    """Those of a kind together, in order of first sight."""
    kinds: dict[str, list[One]] = {}
    for one in found:
        kinds.setdefault(kind(one), []).append(one)
    return kinds


def _turned(trials: Sequence[TimedTrial]) -> Iterator[Missing]:
    """Sensors whose normal reading is negative on every press, in every trial."""
    n_sensors = trials[0].recording.n_sensors
    tared: list[Missing] = []
    # trials in which a sensor is pressed, and those in which it then reads below zero
    pressed, negative = np.zeros((2, n_sensors), dtype=np.int64)
    for trial in trials:
        recording = trial.recording
        least = PRESSED_FLOORS * NORMAL_FLOOR[recording.unit]
        normal = np.where(recording.valid, recording.samples[:, NORMAL_AXIS::3], 0.0)
        enough = max(1, round(PRESSED_S * recording.rate_hz))
        above = (normal > least).sum(axis=0)
        below = (normal < -least).sum(axis=0)
        if recording.n_sensors == n_sensors:
            pressed += above + below >= enough
            negative += below >= np.maximum(enough, MOSTLY * above)
        deep = (normal < -DEEP * np.abs(normal).max(axis=0)).sum(axis=0)
        is_tared = (recording.unit == "N") & (np.minimum(above, deep) >= enough)
        for sensor in np.flatnonzero(is_tared).tolist():
            what = f"sensor {sensor + 1} reads as far below zero as a press is above it"
            step = (
                "record it again where it was tared in a press, or leave the trial out"
            )
            tared.append(Missing("doubt", recording.trial_id, what, step))

    for sensor in np.flatnonzero((pressed > 0) & (negative == pressed)).tolist():
        trial_count = count_of(int(pressed[sensor]), "trial")
        what = f"sensor {sensor + 1} reads below zero on every press, in {trial_count}"
        step = f"multiply Z{sensor + 1} by -1, or take the zero of an open hand"
        yield Missing("doubt", trials[0].recording.trial_id, what, step)
    yield from tared


def _far_labels(trial: TimedTrial) -> Iterator[Missing]:
    """Labels that begin far from any change of load: most graspings, or a slip of nothing."""
    recording = trial.recording
    rows = max(1, round(FAR_S * recording.rate_hz))
    load = _load(recording)
    # of a hand whose zero was taken in a grasp shear alone may be left
    by_sensor = recording.samples.reshape(len(load), -1, 3)
    size = np.where(recording.valid, np.linalg.norm(by_sensor, axis=2), 0.0).sum(axis=1)

    closings, far, slips_of_nothing = 0, [], []
    was_empty = False
    for phase in recording.phases:
        row = phase.first
        around = slice(max(0, row - rows), row + rows)
        is_empty = phase.situation == NOTHING
        if was_empty and not is_empty:
            closings += 1
            # a hand that closes feels at least twice what it felt before
            if load[around.start : row + 1].min() > 0.5 * load[row : around.stop].max():
                far.append(row)
        within = size[phase.first : phase.stop]
        nothing_felt = within.max(initial=0.0) < NORMAL_FLOOR[recording.unit]
        if phase.situation == RISKY_SLIP and nothing_felt:
            slips_of_nothing.append(row)
        was_empty = is_empty
    # a hand that regrips may feel little of one
    if 2 * len(far) < closings:
        far = []
    far += slips_of_nothing
    if far and trial.timed:
        at_s = far[0] / recording.rate_hz
        far_s = (
            f"{FAR_S:g} s and more from any change of load, or no load is felt in it"
        )
        what = f"a label begins at {at_s:.2f} s, {far_s}"
        step = "correct the times of its truth file, or move the trial out of the set"
        yield Missing("doubt", recording.trial_id, what, step)
