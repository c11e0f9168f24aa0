"""Data sets by name or folder: `load` finds the folder, recognises its format and reads it.

A format is recognised by the files in the folder, whatever the folder is called. Each reader has
`recognises(root)` and `load(root, ..)` and is imported when it is needed.
"""

from __future__ import annotations

import os
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.errors import DataNotFound, TooFewGroups, UsageError
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import DataSet
from holdfast.training.splits import HoldOut, regrouped
from holdfast.training.windows import Choice

PUBLIC_SETS = ("human_slip_uskin", "eflesh_slip", "proactive_slip_uskin")
LAYOUTS = ("recorded", "thesis")
FOLDER_VARIABLE = "HOLDFAST_DATA"
BESIDE_THE_CHECKOUT = Path(__file__).resolve().parents[4] / "shared" / "data"


def load(
    name_or_path: str | Path,
    *,
    channels: int | None = None,
    groups: int | None = None,
    seed: int = 0,
    windows: Choice = "balanced",
    hold_out: HoldOut | None = None,
    part: Part = ignored,
) -> DataSet:
    """A data set by its name (a folder in HOLDFAST_DATA) or by its path.

    channels: one of the channel counts a set offers, None for its usual 18. groups: keep so many
    people (or blocks), chosen by `seed`; a small real slice. seed: of every random choice. windows:
    in the thesis' layout those to train on (balanced), the thesis' undersampled ones, every one
    that is natural, to score on (training/windows.py), or none: recordings alone, which are read
    sooner. hold_out: what a group is; None for people where there are two.

    Raises DataNotFound, ChannelsNotOffered, TooFewGroups, UsageError, or what the reader says about
    its files.
    """
    root = find(name_or_path)
    data = _read(root, channels, seed, windows, part)
    if hold_out is not None:
        data = regrouped(data, hold_out)
    return data if groups is None else keep_groups(data, groups, seed=seed)


def data_folder() -> Path:
    """Where public sets are looked up by name."""
    return Path(os.environ.get(FOLDER_VARIABLE) or BESIDE_THE_CHECKOUT)


def find(name_or_path: str | Path) -> Path:
    """Folder of a set. Raises DataNotFound with the likely cause."""
    named = str(name_or_path) in PUBLIC_SETS
    places = ([data_folder() / name_or_path] if named else []) + [Path(name_or_path)]
    for place in places:
        if place.is_dir() and place.resolve() == Path(place.resolve().anchor):
            raise DataNotFound(
                "the root of the file system is not a data set",
                where=place,
                cause="a path that was cut short",
                next_step="give the folder of the set",
            )
        if place.is_dir():
            return place
    if named:
        is_set = os.environ.get(FOLDER_VARIABLE)
        raise DataNotFound(
            f"data set {name_or_path} not found",
            where=places[0],
            cause=f"{FOLDER_VARIABLE} points elsewhere"
            if is_set
            else f"{FOLDER_VARIABLE} is not set",
            next_step=f"set {FOLDER_VARIABLE} to the folder that holds {name_or_path}/",
        )
    raise DataNotFound(
        "a file, not a folder" if places[0].exists() else "no such data set or folder",
        where=places[0],
        cause="a name misspelt, or a path from another folder",
        next_step=f"give a folder, or one of {', '.join(PUBLIC_SETS)}",
    )


def keep_groups(data: DataSet, n_groups: int, *, seed: int = 0) -> DataSet:
    """The part of a set that n_groups people (or blocks), chosen by seed, recorded.

    Raises UsageError for less than one, TooFewGroups for more than there are.
    """
    names = data.groups()
    if n_groups < 1:
        raise UsageError(
            f"groups={n_groups} keeps no group", next_step=f"keep 1 to {len(names)}"
        )
    if n_groups > len(names):
        raise TooFewGroups(
            f"{n_groups} groups (people, blocks) requested, {len(names)} exist",
            next_step=f"keep 1 to {len(names)}",
        )
    kept = set(np.random.default_rng(seed).permutation(names)[:n_groups].tolist())
    part = data.of_groups(kept)
    return replace(part, notes={**data.notes, "kept_groups": sorted(kept)})


def layout_of(root: Path) -> str | None:
    """The name of the reader that recognises a folder: one of PUBLIC_SETS or LAYOUTS, or None."""
    names = (*PUBLIC_SETS, *LAYOUTS)
    return next((name for name in names if _reader(name).recognises(root)), None)


def _reader(name: str) -> Any:
    return import_module(f"holdfast.training.datasets.{name}")


def _read(
    root: Path, channels: int | None, seed: int, windows: Choice, part: Part
) -> DataSet:
    layout = layout_of(root)
    if layout is None:
        raise DataNotFound(
            "no known data set in this folder",
            where=root,
            cause="a level too high or too low, or an empty copy",
            next_step="give a public set, a folder of `holdfast record`, or a folder with "
            "<object>/<action>/trial_<n>.csv; holdfast check says what was found",
        )
    choice: dict[str, Any] = {} if channels is None else {"channels": channels}
    if layout in LAYOUTS:
        choice |= {"seed": seed, "windows": windows, "part": part}
    data: DataSet = _reader(layout).load(root, **choice)
    return data
