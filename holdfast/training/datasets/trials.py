"""The trials of a folder: where they are, and reading them one by one.

A trial is `[<person>/]<object>/<action>/trial_<n>.csv`. Folders of people are optional. The hand
alone is `nothing/trial_<n>.csv` or `nothing.csv`, in the root or, where there are people, in a
person's folder. Finding and reading are two steps, so that a check can go on after a fault.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from holdfast.core.errors import ChannelError, DataError, LabelError
from holdfast.core.trial_layout import (
    META,
    SITUATION_OF_ACTION,
    UNSCRIPTED,
    plain_word,
    read_json,
)
from holdfast.training.progress import Part, ignored
from holdfast.training.windows import TimedTrial

EMPTY_HAND = "nothing"
"""The name of the folder or file of the hand alone."""
FOLDERS = tuple(dict.fromkeys((*SITUATION_OF_ACTION, *UNSCRIPTED)))
"""The actions that a folder can be named after."""
TRIAL_NAME = re.compile(r"trial_(\d+)\.csv")
"""The file of a trial, and its number."""
KEYS_OF_A_SET = {"unit", "kind"}
"""A meta.json with one of these describes a set of its own."""
Fault = Callable[[DataError], None]
"""What a reader does with a trial or folder that it cannot use."""


def refuse(error: DataError) -> NoReturn:
    """The first fault ends the reading."""
    raise error


class ChannelsNotOffered(ChannelError):
    """A set cannot be read with that number of channels; numbers: those that it has."""

    def __init__(self, set_name: str, channels: int, numbers: Iterable[int]) -> None:
        self.channels = channels
        self.numbers = sorted(numbers)
        offered = " or ".join(map(str, self.numbers))
        super().__init__(
            f"recordings of {offered} channels, not {channels}",
            where=set_name,
            cause="a model made for other sensors",
            next_step="holdfast export MODEL --hand CARD --out FILE, where MODEL has pooled "
            "features, as the shipped one has (CARD: these sensors, docs/your-data.md); or "
            f"holdfast train --data {set_name} --out DIR",
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


def read_all(
    readers: Sequence[TrialReader], fault: Fault = refuse, part: Part = ignored
) -> list[TimedTrial | None]:
    """The trials in their order, None for one that cannot be used.

    fault: receives its DataError. part: receives the share of the trials that is read.
    """
    trials: list[TimedTrial | None] = []
    for reader in readers:
        try:
            trials.append(reader.read())
        except DataError as error:
            fault(error)
            trials.append(None)
        part(len(trials) / len(readers))
    return trials


def has_thesis_layout(root: Path) -> bool:
    """Whether a folder, or that of a person in it, holds an `<object>/<action>/trial_<n>.csv`."""
    return _has_trials(root) or bool(people_of(root))


def people_of(root: Path) -> list[Path]:
    """The folders of people, by name; none where no folder holds objects with known actions.

    A folder that is a set itself is no person's.
    """
    folders = []
    for folder in _folders(root):
        if not KEYS_OF_A_SET & read_json(folder / META).keys():
            folders.append(folder)

    # Only names of actions show that a level of folders is people and not objects.
    if not any(map(_has_trials, folders)):
        return []
    return [folder for folder in folders if _trials_in(folder)]


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
            fault(_without_a_person(place, root))
        elif place.object_folder not in people:
            # `p03/nothing/trial_1.csv` of a person without any other trial
            yield TrialPlace(place.path, person=place.object_folder.name)


def _of_one_hand(root: Path, person: str | None, fault: Fault) -> Iterator[TrialPlace]:
    """The trials of one person, or of a folder without people, by object and action."""
    for folder in _folders(root):
        if plain_word(folder.name) == EMPTY_HAND:
            for path in _numbered(folder):
                yield TrialPlace(path, person=person)
            continue

        for action_folder in _folders(folder):
            action = action_of(action_folder.name)
            trials = _numbered(action_folder)
            if action is None and trials:
                fault(_not_an_action(action_folder))
            if action is not None:
                for path in trials:
                    yield TrialPlace(path, folder, action, person)

    if (root / f"{EMPTY_HAND}.csv").is_file():
        yield TrialPlace(root / f"{EMPTY_HAND}.csv", person=person)


def action_of(name: str) -> str | None:
    """The action that a folder is named after, in any spelling; None for another name."""
    known = {plain_word(action): action for action in FOLDERS}
    return known.get(plain_word(name))


def _has_trials(root: Path) -> bool:
    """Whether a folder holds `<object>/<action>/trial_<n>.csv` with a known action."""
    return any(action_of(path.parent.name) for path in _trials_in(root))


def _trials_in(root: Path) -> list[Path]:
    """Files two folders below that are named as trials are, whatever the folders are called."""
    paths = root.glob("*/*/trial_*.csv")
    return [path for path in paths if TRIAL_NAME.fullmatch(path.name)]


def _folders(root: Path) -> list[Path]:
    """The folders in a folder, by name; none where it is no folder."""
    if not root.is_dir():
        return []
    return sorted(path for path in root.iterdir() if path.is_dir())


def _numbered(folder: Path) -> list[Path]:
    """The trials in a folder, by number."""
    # By number and not by name, where trial_10 would come before trial_2.
    numbers = {}
    for path in folder.iterdir():
        match = TRIAL_NAME.fullmatch(path.name)
        if match:
            numbers[path] = int(match[1])

    return sorted(numbers, key=lambda path: (numbers[path], path))


def _not_an_action(folder: Path) -> LabelError:
    """The error for a folder with trials in it that is named after no action."""
    return LabelError(
        f"{folder.name!r} is not an action",
        where=folder,
        next_step=f"name the folder one of {', '.join(FOLDERS)}, or move it out of the set",
    )


def _without_a_person(place: TrialPlace, root: Path) -> LabelError:
    """The error for a trial outside all folders of people, where there are such folders."""
    return LabelError(
        "a trial without a person, in a set with folders of people",
        where=place.path,
        cause="trials of the hand alone belong to a person too",
        next_step=f"move it to {root.name}/<person>/{place.path.relative_to(root).as_posix()}",
    )
