"""Trials as one LeRobot data set of format v3.0, an episode each: meta/, data/ (Parquet).

A frame is a sample: `observation.tactile` [C] in the unit of the set, nan where it was lost;
`observation.tactile_valid` [S]; `observation.time_s`, its true time; and `situation`, the index of
SITUATIONS or -1. The format counts `timestamp` as frame / fps, with a whole fps, and nothing is
resampled for that: `observation.time_s` is what to trust. The task of an episode names its action
and object. There is no `action`: a recording of a hand commands nothing.

The layout is that of lerobot 0.4 (lerobot/datasets/utils.py and lerobot_dataset.py); statistics are
over the values that are there. parquet.py writes and reads the Parquet. `read_log` reads any set:
the episodes of all files, one after the other.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.core.contract import SITUATIONS, Json, channel_names, valid_names
from holdfast.core.errors import NotANumber, needs_extra
from holdfast.core.schema import json_of, read
from holdfast.core.writing import write_whole
from holdfast.data.datasets.thesis import common_rate
from holdfast.interop.formats.parquet import read_columns, write_columns, write_rows
from holdfast.interop.formats.payload import LABEL_OF, NO_LABEL, TrialPayload
from holdfast.interop.formats.streams import Columns, ForeignLog, Stream

with needs_extra("lerobot"):
    import pandas as pd

if TYPE_CHECKING:
    import numpy.typing as npt

VERSION = "v3.0"
"""Of the format, as meta/info.json names it."""
CHUNK_FILES, DATA_MB, VIDEO_MB = 1000, 100, 200
"""lerobot's own defaults; a set of ours stays in one file."""
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
QUANTILES = {
    "min": 0, "q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99, "max": 1,
}  # fmt: skip
"""Statistics that lerobot keeps of each feature, by its names; beside mean, std and count."""
INFO = "meta/info.json"
TACTILE = "observation.tactile"
VALID = "observation.tactile_valid"
TIME = "observation.time_s"
SITUATION, EPISODE = "situation", "episode_index"
"""Columns of a frame: the names that start with `observation.` are lerobot's convention."""
PLACE = (
    "data/chunk_index",
    "data/file_index",
    "meta/episodes/chunk_index",
    "meta/episodes/file_index",
)
"""Where an episode is: all are in the first file."""


def write_trials(trials: Sequence[TrialPayload], folder: Path) -> None:
    """The whole set. Raises RateError or ChannelError where trials differ."""
    rate_hz = common_rate([trial.recording for trial in trials])
    frames: list[Columns] = []
    episodes: list[Json] = []
    tasks: dict[str, int] = {}
    begins = 0
    for number, trial in enumerate(trials):
        # such as `pull soft-ball`; the empty hand has no object
        text = f"{trial.about['action']} {trial.about['object'] or ''}".strip()
        task = tasks.setdefault(text, len(tasks))
        frame = _frame(trial, round(rate_hz))
        rows = frame["frame_index"]
        frame[EPISODE] = np.full_like(rows, number)
        frame["index"] = begins + rows
        frame["task_index"] = np.full_like(rows, task)
        episode: Json = {
            EPISODE: number,
            "tasks": [text],
            "length": len(rows),
            "dataset_from_index": begins,
            "dataset_to_index": begins + len(rows),
            "holdfast": json.dumps(trial.about),
            **dict.fromkeys(PLACE, 0),
        }
        # an episode carries its own statistics, so that sets are joined without reading the data
        for key, values in frame.items():
            for name, figures in _stats(values).items():
                episode[f"stats/{key}/{name}"] = figures
        frames.append(frame)
        episodes.append(episode)
        begins += len(rows)

    whole = {key: np.concatenate([one[key] for one in frames]) for key in frames[0]}
    # a set of ours stays below the size at which lerobot starts a new file
    path = DATA_PATH.format(chunk_index=0, file_index=0)
    write_columns(folder / path, whole)
    write_rows(folder / path.replace("data/", "meta/episodes/", 1), episodes)
    # the texts are the index, as lerobot looks them up
    index = pd.Index([*tasks], name="task")
    table = pd.DataFrame({"task_index": tasks.values()}, index=index)
    table.to_parquet(folder / "meta/tasks.parquet", compression="zstd")
    stats = {key: _stats(values) for key, values in whole.items()}
    info = _info(trials, rate_hz, whole, len(tasks))
    for file, value in (("meta/stats.json", stats), (INFO, info)):
        text = json.dumps(value, indent=4, allow_nan=False)
        write_whole(folder / file, text + "\n")


def _frame(trial: TrialPayload, fps: int) -> Columns:
    """What the frames of an episode have of its trial, by column."""
    rows = np.arange(len(trial.t_s))
    return {
        TACTILE: trial.values.astype(np.float32),
        VALID: trial.valid,
        TIME: trial.t_s,
        SITUATION: trial.label.astype(np.int64),
        # lerobot checks that stamps are exactly frame / fps; TIME has the true ones
        "timestamp": (rows / fps).astype(np.float32),
        "frame_index": rows,
    }


def _stats(values: npt.NDArray[Any]) -> dict[str, list[float]]:
    """Statistics over axis 0 without nan, by lerobot's names; 0 where nothing is left."""
    table = pd.DataFrame(values.reshape(len(values), -1).astype(np.float64))
    figures = table.quantile([*QUANTILES.values()]).set_axis([*QUANTILES])
    figures.loc["mean"], figures.loc["std"] = table.mean(), table.std(ddof=0)
    # JSON has no nan
    stats: dict[str, list[float]] = figures.fillna(0.0).T.to_dict("list")
    return {**stats, "count": [len(table)]}


def _info(
    trials: Sequence[TrialPayload], rate_hz: float, frames: Columns, n_tasks: int
) -> Json:
    """The content of meta/info.json; what stands under `holdfast` is ours."""
    recording = trials[0].recording
    names = {
        TACTILE: list(channel_names(recording.n_sensors)),
        VALID: list(valid_names(recording.n_sensors)),
    }
    features: Json = {}
    for key, column in frames.items():
        # the format has no scalars: a single number has shape [1]
        shape = list(column.shape[1:]) or [1]
        about = {"dtype": column.dtype.name, "shape": shape, "names": names.get(key)}
        features[key] = about

    return {
        "codebase_version": VERSION,
        "robot_type": "holdfast",
        "total_episodes": len(trials),
        "total_frames": len(frames[TIME]),
        "total_tasks": n_tasks,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": DATA_MB,
        "video_files_size_in_mb": VIDEO_MB,
        "fps": round(rate_hz),
        "splits": {"train": f"0:{len(trials)}"},
        "data_path": DATA_PATH,
        "video_path": None,
        "features": features,
        "holdfast": {
            "unit": recording.unit,
            "rate_hz": rate_hz,
            "situations": list(SITUATIONS),
            "no_label": NO_LABEL,
        },
    }


def read_log(folder: Path, name: str) -> ForeignLog:
    """A set of any robot as a log of one table, its episodes in their order.

    Features of several numbers have the names that info.json gives them. `task` is the text of the
    task; of a set of `holdfast convert` there are also `person`, `object` and `action`, and
    `situation` by name. Raises DataError.
    """
    info: Json = {"features": {}, **read(folder / INFO, Json, NotANumber)}
    table = _table(folder, "data/**/*.parquet").rename(columns=_names(info["features"]))
    tasks = _table(folder, "meta/tasks*.parquet")
    if "task" in tasks:
        texts = tasks.set_index("task_index")["task"]
        table["task"] = table["task_index"].map(texts).fillna("")
    if "holdfast" in info:
        episodes = _table(folder, "meta/episodes/**/*.parquet").set_index(EPISODE)
        about = pd.DataFrame(map(json_of, episodes["holdfast"]), episodes.index)
        for key in ("person", "object", "action"):
            table[key] = table[EPISODE].map(about[key]).fillna("")
        table[SITUATION] = table[SITUATION].map(LABEL_OF)
    # the stamps of the format are those of a camera; the true ones are beside them
    if TIME in table:
        table = table.drop(columns="timestamp")
    columns = {str(key): column.to_numpy() for key, column in table.items()}
    return ForeignLog(folder, name, (Stream(columns),), info.get("holdfast", {}))


def _table(folder: Path, pattern: str) -> pd.DataFrame:
    """The tables of some files, one after the other, with the columns that all of them have."""
    paths = sorted(folder.glob(pattern))
    parts = [pd.DataFrame(read_columns(path)[0]) for path in paths]
    empty = pd.DataFrame()
    return pd.concat(parts, join="inner", ignore_index=True) if parts else empty


def _names(features: Json) -> dict[str, str]:
    """`observation.state.0` -> its name in info.json, where that names each number."""
    names = {}
    for feature, about in features.items():
        labels = about.get("names")
        for k, label in enumerate(labels if isinstance(labels, list) else ()):
            names[f"{feature}.{k}"] = f"{feature}.{label}"

    return names
