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
from holdfast.training.datasets.trials import FOLDERS, action_of
from holdfast.training.recording import DataSet
from holdfast.training.timeline import ACTION_KEY, ACTION_S
from holdfast.training.windows import Choice

if TYPE_CHECKING:
    import pandas as pd

LABEL = "label"
"""The column of situations, where a frame has one."""
LAST_S = 0.1
"""How long the last row of a trial counts."""
NAME = re.compile(r"([^/.][^/]*/){1,3}trial_\d+")
ACTIONS = ", ".join(FOLDERS)


def recordings_from_frames(
    frames: Mapping[str, pd.DataFrame],
    *,
    unit: Unit = "N",
    masses_g: Mapping[str, float] | None = None,
    action_at_s: float = ACTION_S,
    name: str = "frames",
    windows: Choice = "balanced",
    seed: int = 0,
) -> DataSet:
    """A data set of data frames, one a trial: they are written as a folder of trials and read.

    frames: `[<person>/]<object>/<action>/trial_<n>` (or `[<person>/]nothing/trial_<n>`) -> columns
    Time (s), X1, Y1, Z1, .. in `unit`, and where it is known `label`: the situation of each row,
    empty for none. masses_g: of objects that are not in the table; where one has none, no weight is
    known of the set. action_at_s: where the action starts without a column of labels. windows,
    seed: as `load` takes them. Frames are not changed. Raises a DataError that names the frame.
    """
    if not frames:
        raise DataNotFound("no data frame", where=name, next_step="give a trial")
    about = {
        "unit": unit,
        "name": name,
        ACTION_KEY: action_at_s,
        MASSES_KEY: dict(masses_g or {}),
    }
    with TemporaryDirectory() as folder:
        root = Path(folder)
        (root / META).write_text(json.dumps(about), "utf-8")
        for key, frame in frames.items():
            _write(root, key, frame)
        return thesis.load(root, seed=seed, windows=windows)


def _write(root: Path, key: str, frame: pd.DataFrame) -> None:
    """A frame as a trial of a folder, with its labels as the truth. Raises LabelError."""
    if not NAME.fullmatch(key) or action_of(key.split("/")[-2]) is None:
        step = f"name the frame <person>/<object>/<action>/trial_<n>, the action one of {ACTIONS}"
        raise LabelError("not the name of a trial", where=key, next_step=step)
    path = root / f"{key}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    signals = frame.drop(columns=LABEL, errors="ignore")
    signals.to_csv(path, index=False, na_rep="nan")
    if LABEL in frame:
        truth = {"phases": _phases(frame)}
        truth_path(path).write_text(json.dumps(truth), "utf-8")


def _phases(frame: pd.DataFrame) -> list[Json]:
    """Runs of equal labels, as a truth file has them; a row whose label is no text has none."""
    time_s = frame[TIME_COLUMN] - frame[TIME_COLUMN].iloc[0]
    begins = frame[LABEL].ne(frame[LABEL].shift())
    # the last row belongs to the last phase
    edges_s = [*time_s[begins].tolist(), time_s.iloc[-1] + LAST_S]
    phases: list[Json] = []
    for label, t0_s, t1_s in zip(
        frame[LABEL][begins], edges_s[:-1], edges_s[1:], strict=True
    ):
        if isinstance(label, str) and label:
            of = {"t0_s": t0_s, "t1_s": t1_s, "label": label}
            phases.append(of | {"provenance": "label column"})
    return phases
