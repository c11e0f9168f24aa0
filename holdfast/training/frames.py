"""Recordings from pandas: a data frame a trial, named `[<person>/]<object>/<action>/trial_<n>`."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from holdfast.core.contract import Json, Unit
from holdfast.core.errors import DataNotFound, LabelError
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.core.trial_layout import MASSES_KEY, META, truth_path
from holdfast.training.datasets import thesis
from holdfast.training.datasets.trials import FOLDERS
from holdfast.training.recording import DataSet
from holdfast.training.timeline import ACTION_KEY, ACTION_S
from holdfast.training.windows import Choice

if TYPE_CHECKING:
    import pandas as pd

LABEL = "label"
"""The column of situations, where a frame has one."""
NAME = re.compile(r"([^/.][^/]*/){1,3}trial_\d+")
ACTIONS = ", ".join(FOLDERS)


def recordings_from_frames(
    frames: Mapping[str, pd.DataFrame],
    *,
    unit: Unit = "N",
    masses_g: Mapping[str, float] | None = None,
    action_at_s: float | Mapping[str, float] = ACTION_S,
    name: str = "frames",
    windows: Choice = "balanced",
    seed: int = 0,
) -> DataSet:
    """A data set of data frames, one a trial: they are written as a folder of trials and read.

    frames: `[<person>/]<object>/<action>/trial_<n>` (or `[<person>/]nothing/trial_<n>`) -> columns
    Time (s), X1, Y1, Z1, .. in `unit`, and where it is known `label`: the situation of each row,
    empty for none. masses_g: of objects that are not in the table; where one has none, no weight is
    known of the set. action_at_s: where the action starts without a column of labels, for all
    trials or by name. windows, seed: as `load` takes them. Frames are not changed. Raises a
    DataError that names the frame.
    """
    if not frames:
        raise DataNotFound("no data frame", where=name, next_step="give a trial")
    starts_s = action_at_s if isinstance(action_at_s, Mapping) else {}
    of_all_s = ACTION_S if isinstance(action_at_s, Mapping) else action_at_s
    about = {"unit": unit, "name": name, ACTION_KEY: of_all_s}
    with TemporaryDirectory() as folder:
        root = Path(folder)
        meta = {**about, MASSES_KEY: dict(masses_g or {})}
        (root / META).write_text(json.dumps(meta), "utf-8")
        for key, frame in frames.items():
            if not NAME.fullmatch(key):
                raise _not_a_name(key)
            path = root / f"{key}.csv"
            path.parent.mkdir(parents=True, exist_ok=True)
            signals = frame.drop(columns=LABEL, errors="ignore")
            signals.to_csv(path, index=False, na_rep="nan")
            truth: Json = {}
            if LABEL in frame:
                truth = {"phases": _phases(frame)}
            elif key in starts_s:
                truth = {ACTION_KEY: starts_s[key]}
            if truth:
                truth_path(path).write_text(json.dumps(truth), "utf-8")
        found = {reader.place.path for reader in thesis.readers(root)}
        for key in frames:
            if root / f"{key}.csv" not in found:
                raise _not_a_name(key)
        return thesis.load(root, seed=seed, windows=windows)


def _not_a_name(key: str) -> LabelError:
    step = f"name the frame <person>/<object>/<action>/trial_<n>, the action one of {ACTIONS}"
    return LabelError("not the name of a trial", where=key, next_step=step)


def _phases(frame: pd.DataFrame) -> list[Json]:
    """Runs of equal labels, as a truth file has them; a row whose label is no text has none."""
    time_s = (frame[TIME_COLUMN] - frame[TIME_COLUMN].iloc[0]).tolist()
    phases: list[Json] = []
    last: object = None
    for at_s, label in zip(time_s, frame[LABEL].tolist(), strict=True):
        # A phase ends where the next row has another label.
        if last == label:
            continue
        if phases and "t1_s" not in phases[-1]:
            phases[-1]["t1_s"] = at_s
        if isinstance(label, str) and label:
            of = {"label": label, "provenance": "label column"}
            phases.append({"t0_s": at_s, **of})
        last = label
    if phases:
        phases[-1].setdefault("t1_s", 2 * time_s[-1] + 1.0)
    return phases
