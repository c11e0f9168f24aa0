"""The files of a trial, and the meaning of its names: file names, actions, objects, events.

Recording, simulation, training and evaluation share this module::

    <object>/<action>/trial_<n>.csv     samples; beside it trial_<n>.truth.json, .onset.json,
                                        .frames.npz and .intent.csv
    <object>/<action>/trial_<n>/        of the recorder: tactile.csv, events.jsonl, meta.json,
                                        tactile.truth.json and tactile.intent.csv

Folders of people may stand above the objects: `<person>/<object>/<action>/`.
It imports no numpy, so that the command line can list actions at once.
"""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType

from holdfast.core.errors import LabelError
from holdfast.core.reading import Json, json_of, text_of

META, EVENTS, TACTILE = "meta.json", "events.jsonl", "tactile.csv"
TRUTH_SUFFIX, ONSET_SUFFIX, FRAMES_SUFFIX = ".truth.json", ".onset.json", ".frames.npz"
INTENT_SUFFIX = ".intent.csv"
TRUTH = "tactile" + TRUTH_SUFFIX
DISCARDED = "discarded"
"""A person's folder of trials that were done again: kept on the disk, read by nothing."""

SITUATION_OF_ACTION = MappingProxyType(
    {
        "pass": "safe_slip",
        "put-down": "safe_slip",
        "pull": "risky_slip",
        "fall": "risky_slip",
        "hold": "grasp",
        "nothing": "nothing",
    }
)
"""The situation of an action from load onset to the empty hand: one of contract.SITUATIONS."""
VOLUNTARY_ACTIONS = tuple(
    name for name, situation in SITUATION_OF_ACTION.items() if situation == "safe_slip"
)
RISKY_ACTIONS = tuple(
    name for name, situation in SITUATION_OF_ACTION.items() if situation == "risky_slip"
)

MASSES_G = MappingProxyType(
    {
        "soft-ball": 15.1,
        "empty-bottle": 21.2,
        "basket-ball": 83.1,
        "hard-ball": 197.9,
        "full-bottle": 517.3,
        "apple": 20.3,
    }
)
"""The objects of the thesis (docs/glossary.md) and its test object, g."""


def truth_path(trial: Path) -> Path:
    """`trial_3.csv` -> `trial_3.truth.json`."""
    return trial.with_suffix(TRUTH_SUFFIX)


def intent_path(trial: Path) -> Path:
    """`trial_3.csv` -> `trial_3.intent.csv`."""
    return trial.with_suffix(INTENT_SUFFIX)


def read_events(path: Path) -> list[Json]:
    """The lines of an events.jsonl without a torn last one; none without a file.

    Raises LabelError.
    """
    try:
        *lines, last = text_of(path).split("\n") if path.exists() else [""]
        events = [json_of(line) for line in [*lines, *_if_whole(last)] if line.strip()]
        if not all(isinstance(event, dict) for event in events):
            raise ValueError("not an object")
        return events
    except (OSError, ValueError) as error:
        raise LabelError(
            f"a line is not a JSON object ({type(error).__name__})",
            where=path,
            next_step="correct it",
        ) from None


def _if_whole(line: str) -> list[str]:
    """The last line if it is whole. No part of a JSON object is a JSON object itself."""
    try:
        json_of(line)
    except ValueError:
        return []
    return [line]
