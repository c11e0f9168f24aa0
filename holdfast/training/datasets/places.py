"""Where the trials of a set are: `[<person>/]<object>/<action>/trial_<n>.csv`.

Folders of people are optional. The hand alone is `nothing/trial_<n>.csv` or `nothing.csv`, in the
root or, where there are people, in a person's folder.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from holdfast.core.errors import DataError, LabelError
from holdfast.core.objects import plain_word, read_json
from holdfast.core.trial_layout import META, SITUATION_OF_ACTION
from holdfast.training.timeline import UNSCRIPTED

EMPTY_HAND = "nothing"
FOLDERS = tuple(dict.fromkeys((*SITUATION_OF_ACTION, *UNSCRIPTED)))
TRIAL_NAME = re.compile(r"trial_(\d+)\.csv")
KEYS_OF_A_SET = {"unit", "kind"}
Fault = Callable[[DataError], None]
"""What a reader does with a trial or folder that it cannot use."""


def refuse(error: DataError) -> NoReturn:
    """The first fault ends the reading."""
    raise error


@dataclass(frozen=True)
class TrialPlace:
    """Where a trial is; `object_folder` and `action` are None for the hand alone.

    person: None where the set has no folders of people.
    """

    path: Path
    object_folder: Path | None = None
    action: str | None = None
    person: str | None = None


def recognises(root: Path) -> bool:
    """Whether a folder, or that of a person in it, holds an `<object>/<action>/trial_<n>.csv`."""
    return _has_trials(root) or bool(people_of(root))


def people_of(root: Path) -> list[Path]:
    """The folders of people, by name; none where no folder holds objects with known actions.

    A folder that is a set of its own is none.
    """
    folders = [
        path
        for path in _folders(root)
        if not KEYS_OF_A_SET & read_json(path / META).keys()
    ]
    return (
        [one for one in folders if _trials_in(one)]
        if any(map(_has_trials, folders))
        else []
    )


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
        elif place.object_folder and place.action == EMPTY_HAND:
            if place.object_folder not in people:
                yield TrialPlace(place.path, person=place.object_folder.name)
        else:
            fault(_without_a_person(place, root))


def _of_one_hand(root: Path, person: str | None, fault: Fault) -> Iterator[TrialPlace]:
    for folder in _folders(root):
        if plain_word(folder.name) == EMPTY_HAND:
            yield from (TrialPlace(path, person=person) for path in _numbered(folder))
            continue
        for actions in _folders(folder):
            trials, action = _numbered(actions), action_of(actions)
            if trials and action is None:
                fault(_not_an_action(actions))
            elif action:
                yield from (TrialPlace(path, folder, action, person) for path in trials)
    if (root / f"{EMPTY_HAND}.csv").is_file():
        yield TrialPlace(root / f"{EMPTY_HAND}.csv", person=person)


def action_of(folder: Path) -> str | None:
    """The action that a folder is named after, in any spelling; None for another name."""
    return next(
        (action for action in FOLDERS if plain_word(action) == plain_word(folder.name)),
        None,
    )


def _has_trials(root: Path) -> bool:
    return any(action_of(path.parent) for path in _trials_in(root))


def _trials_in(root: Path) -> list[Path]:
    """Files two folders below that are named as trials are, whatever the folders are called."""
    return [
        path for path in root.glob("*/*/trial_*.csv") if TRIAL_NAME.fullmatch(path.name)
    ]


def _folders(root: Path) -> list[Path]:
    return (
        sorted(path for path in root.iterdir() if path.is_dir())
        if root.is_dir()
        else []
    )


def _numbered(folder: Path) -> list[Path]:
    matches = ((TRIAL_NAME.fullmatch(path.name), path) for path in folder.iterdir())
    return [
        path
        for _, path in sorted((int(match[1]), path) for match, path in matches if match)
    ]


def _not_an_action(folder: Path) -> LabelError:
    return LabelError(
        f"{folder.name!r} is not an action",
        where=folder,
        next_step=f"name the folder one of {', '.join(FOLDERS)}, or move it out of the set",
    )


def _without_a_person(place: TrialPlace, root: Path) -> LabelError:
    return LabelError(
        "a trial without a person, in a set with folders of people",
        where=place.path,
        cause="trials of the hand alone belong to a person too",
        next_step=f"move it to {root.name}/<person>/{place.path.relative_to(root).as_posix()}",
    )
