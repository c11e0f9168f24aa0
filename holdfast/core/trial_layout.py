"""The files of a trial, and the meaning of its names: file names, actions, objects, contact.

Recording, simulation, training and evaluation share this module::

    <object>/<action>/trial_<n>.csv     samples; next to it trial_<n>.truth.json and .intent.csv
    <object>/<action>/trial_<n>/        of the recorder: tactile.csv, events.jsonl, meta.json,
                                        tactile.truth.json and tactile.intent.csv

Folders of people may stand above the objects: `<person>/<object>/<action>/`. numpy is imported
late, so that the command line can list actions at once.

The mass of an object comes from `meta.json` next to the recordings, else from "masses_g" of the
set's meta.json, else from MASSES_G. Where none has it, the weight is not known and not guessed: a
guess would put wrong labels on all windows of the object.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import LabelError, UsageError, command, one_line
from holdfast.core.schema import json_of, text_of

if TYPE_CHECKING:
    from holdfast.core.contract import FloatArray, Json

META, EVENTS, TACTILE = "meta.json", "events.jsonl", "tactile.csv"
TRUTH_SUFFIX, INTENT_SUFFIX = ".truth.json", ".intent.csv"
HAND_FILE = "hand.toml"
"""The hand card of a set, next to the set's meta.json (core/hand_card.py)."""
TRUTH = "tactile" + TRUTH_SUFFIX
LOG_SUFFIXES = (
    ".csv", ".tsv", ".txt", ".dat", ".log", ".xlsx", ".xlsm", ".parquet", ".mcap", ".xdf", ".xdfz"
)  # fmt: skip
"""Endings of logs of other programs, which `holdfast import` reads."""
LOG_MARKS = ("metadata.yaml", "meta/info.json")
"""Files in the folder of a log: a bag of ROS 2, a LeRobot set."""
DISCARDED = "discarded"
"""A person's folder of trials that were done again: kept on the disk, read by nothing."""

NAME = re.compile(r"[A-Za-z0-9]+(-[A-Za-z0-9]+)*")
"""Words joined by dashes: safe as a folder on every system, and no address."""
LONGEST_NAME = 24

SITUATION_OF_ACTION = MappingProxyType(
    {
        "pass": "safe_slip",
        "put-down": "safe_slip",
        "pull": "risky_slip",
        "fall": "risky_slip",
        "hold": "grasp",
        "slip": "risky_slip",
        "nothing": "nothing",
        "tug": "risky_slip",
        "stack": "risky_slip",
        "relax": "risky_slip",
        "lift": "grasp",
        "carry": "grasp",
        "turn": "grasp",
        "pour": "grasp",
        "regrip": "grasp",
        "touch-table": "grasp",
        "stroke": "grasp",
        "tap": "grasp",
    }
)
"""The situation of an action from load onset to the empty hand: one of contract.SITUATIONS.

Of a tug, a weight that is added and a grip that relaxes: where the object slips, else a grasp.
"""


def _actions_of(situation: str) -> tuple[str, ...]:
    """The actions of a situation."""
    return tuple(one for one, its in SITUATION_OF_ACTION.items() if its == situation)


VOLUNTARY_ACTIONS = _actions_of("safe_slip")
THESIS_ACTIONS = ("pass", "put-down", "pull", "fall", "nothing")
"""Actions of the thesis' script."""
OTHER_ACTIONS = tuple(
    name for name in SITUATION_OF_ACTION if name not in THESIS_ACTIONS
)
"""Actions without a script: a trial's truth tells what happens when."""
UNSCRIPTED = (*OTHER_ACTIONS, "daily")
"""Actions whose labels come only from the truth file of a trial."""
LABELLED_ACTIONS = ("hold", "slip", "lift")
"""Actions that need no truth: whether the object slipped is all that is known of a trial.

Of lifts, one after the other, the forces tell when the hand holds something (data/lifts.py).
"""
HELD_ACTIONS = _actions_of("grasp")
"""Actions in which the object should stay in the hand."""
RISKY_ACTIONS = _actions_of("risky_slip")


def truth_path(trial: Path) -> Path:
    """`trial_3.csv` -> `trial_3.truth.json`."""
    return trial.with_suffix(TRUTH_SUFFIX)


def intent_path(trial: Path) -> Path:
    """`trial_3.csv` -> `trial_3.intent.csv`."""
    return trial.with_suffix(INTENT_SUFFIX)


def has_logs(path: Path) -> bool:
    """Whether a file or folder may be, or hold, logs of other programs."""
    inside = (path, *path.rglob("*"))
    names = {mark.rpartition("/")[2] for mark in LOG_MARKS}
    return any(
        one.is_file() and (one.suffix.lower() in LOG_SUFFIXES or one.name in names)
        for one in inside
    )


def import_command(path: Path) -> str:
    """The command that imports a log or a folder of logs."""
    return command("import", path, "--out", f"{path.with_suffix('')}-trials")


def read_events(path: Path) -> list[Json]:
    """The lines of an events.jsonl without a torn last one; none without a file.

    Raises LabelError.
    """
    try:
        if not path.exists():
            return []
        # a kill leaves a part of the last line; every other line must be whole
        *lines, last = text_of(path).split("\n")
        events = [json_of(line) for line in lines if line.strip()]
        # no part of a JSON object is a JSON object itself
        with suppress(ValueError):
            events.append(json_of(last))
        if not all(isinstance(event, dict) for event in events):
            raise ValueError("not an object")
        return events
    except (OSError, ValueError) as error:
        raise LabelError(
            f"a line is not a JSON object: {one_line(str(error)):.120}",
            where=path,
            next_step="correct it",
        ) from None


def read_json(path: Path) -> Json:
    """A JSON object next to the recordings; empty without the file. Raises LabelError."""
    try:
        value = json_of(text_of(path))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise LabelError(
            f"cannot be read as JSON: {one_line(str(error)):.120}",
            where=path,
            next_step="correct or remove it",
        ) from None
    if not isinstance(value, dict):
        raise LabelError(
            "holds no JSON object",
            where=path,
            next_step="write {..} with the keys by name",
        )
    return value


# -- objects and their masses

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
MASSES_KEY, TABLE = "masses_g", "table"
ALIASES = {"colabottle": "full-bottle"}


def object_name(folder_name: str) -> str:
    """The table's name of a folder: `softball`, `Soft_Ball` and `soft-ball` are one object."""
    plain = plain_word(folder_name)
    # folders spell one object in many ways
    known = {plain_word(name): name for name in MASSES_G} | ALIASES
    return known.get(plain, folder_name)


def plain_word(name: str) -> str:
    """Lower case, letters and digits only."""
    return "".join(letter for letter in name.lower() if letter.isalnum())


def is_heavy(mass_g: float) -> bool:
    """Heavy is 150 g and more."""
    from holdfast.core.contract import LIGHT_BELOW_G  # late, because it imports numpy

    return mass_g >= LIGHT_BELOW_G


@dataclass(frozen=True)
class Mass:
    """Mass of an object, and the file that gives it ("table" for MASSES_G)."""

    mass_g: float
    source: str

    @property
    def heavy(self) -> bool:
        return is_heavy(self.mass_g)


def mass_g(folder: Path) -> float:
    """Mass of the object a folder is named after, g. Raises LabelError where none is known."""
    known = mass_of(folder)
    if known is None:
        raise LabelError(
            f"no mass given for object {folder.name!r}",
            where=folder,
            cause="an object whose mass Holdfast does not know",
            next_step=weigh_it(folder),
        )
    return known.mass_g


def weigh_it(folder: Path) -> str:
    """What to do for the mass of the object a folder is named after."""
    return f'weigh it and add "mass_g" to {folder / META}: {{"mass_g": 120.0}}'


def mass_of(folder: Path, masses_g: Json | None = None) -> Mass | None:
    """Mass of the object a folder is named after: its `meta.json`, the set's, or the table.

    masses_g: "masses_g" of the set's meta.json. None where none has it. Raises LabelError where it
    is no positive number.
    """
    meta = folder / META
    mass = read_json(meta).get("mass_g")
    if mass is not None:
        return _checked(mass, str(meta), folder.name)
    return named_mass(folder.name, masses_g)


def named_mass(name: str, masses_g: Mapping[str, Any] | None = None) -> Mass | None:
    """The mass of an object by the set's masses_g, else by the table; None where neither knows it.

    Raises LabelError for a mass that is no positive number.
    """
    # the set names objects as its folders do, so both sides are brought to one spelling
    of_set = {object_name(other): mass for other, mass in (masses_g or {}).items()}
    table = object_name(name)
    if table in of_set:
        return _checked(of_set[table], MASSES_KEY, name)
    return Mass(MASSES_G[table], TABLE) if table in MASSES_G else None


def _checked(mass: Any, source: str, name: str) -> Mass:
    """A mass that is a positive number; source: the file that gives it."""
    is_number = isinstance(mass, int | float) and not isinstance(mass, bool)
    if not is_number or not 0.0 < mass < math.inf:
        raise LabelError(
            f"the mass of {name!r} is {mass!r}",
            where=source,
            next_step="write the mass in gram",
        )
    return Mass(float(mass), source)


def checked_name(text: str, what: str) -> str:
    """A pseudonym or a name that may become a folder. Raises UsageError."""
    # Folders of these names have a meaning of their own among a person's.
    reserved = text.lower() in ("nothing", DISCARDED)
    if reserved or not NAME.fullmatch(text) or len(text) > LONGEST_NAME:
        raise UsageError(
            f"{what} {text[:40]!r} is not allowed",
            cause="an address, a path, or a reserved word",
            next_step=f"up to {LONGEST_NAME} letters, digits and dashes, such as p01; no real name",
        )
    return text


# -- the contact rule

CONTACT_SHARE, CONTACT_SMOOTH_S = 0.1, 0.1
"""A hand is closed on something while its normal force exceeds this share of its 95 % quantile."""


def contact_rows(
    load: FloatArray, rate_hz: float, least: float = 0.0
) -> tuple[int, int] | None:
    """First row with the hand closed on something, and first row after the last such; None without.

    load [T]: sum of the fingers' normal forces without bias; it is averaged over 0.1 s. least: a
    hand whose load never exceeds it has touched nothing.
    """
    import numpy as np

    rows = max(1, round(CONTACT_SMOOTH_S * rate_hz))
    # mirrored ends: the average has no edge where the recording begins
    padded = np.pad(load, (rows // 2, (rows - 1) // 2), mode="symmetric")
    smooth = np.convolve(padded, np.full(rows, 1.0 / rows), mode="valid")
    # a quantile, so that one knock is not the measure of the whole trial
    high = float(np.quantile(smooth, 0.95))
    if high < least:
        return None
    closed = np.flatnonzero(smooth >= CONTACT_SHARE * high)
    return int(closed[0]), int(closed[-1]) + 1
