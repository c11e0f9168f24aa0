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
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.core.contract import SITUATIONS, Json, channel_names
from holdfast.core.errors import EmptyRecording, NotANumber, needs_extra
from holdfast.core.schema import json_of, read
from holdfast.core.writing import write_whole
from holdfast.interop.parquet import (
    read_columns,
    write_columns,
    write_rows,
)
from holdfast.interop.payload import NO_LABEL, UNLABELLED, TrialPayload
from holdfast.interop.streams import Columns, ForeignLog, Stream
from holdfast.training.datasets.thesis import common_rate

with needs_extra("lerobot"):
    import pandas as pd

if TYPE_CHECKING:
    import numpy.typing as npt

VERSION = "v3.0"
"""Of the format, as meta/info.json names it."""
CHUNK_FILES, DATA_MB, VIDEO_MB = 1000, 100, 200
"""lerobot's own defaults; a set of ours stays in one file."""
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""Statistics that lerobot keeps of each feature, by its names."""
INFO = "meta/info.json"
TACTILE = "observation.tactile"
VALID = "observation.tactile_valid"
TIME = "observation.time_s"
SITUATION = "situation"
"""Columns of a frame: the names that start with `observation.` are lerobot's convention."""


def write_trials(trials: Sequence[TrialPayload], folder: Path) -> None:
    """The whole set. Raises RateError or ChannelError where trials differ."""
    rate_hz = common_rate([trial.recording for trial in trials])
    tasks = list(dict.fromkeys(map(_task, trials)))
    parts = []
    episodes = []
    first = 0
    for number, trial in enumerate(trials):
        columns = _frames(trial, number, first, round(rate_hz))
        columns["task_index"] = np.full(len(trial.t_s), tasks.index(_task(trial)))
        parts.append(columns)
        episodes.append(_episode(trial, number, first, columns))
        first += len(trial.t_s)

    # a set of ours stays below the size at which lerobot starts a new file
    joined = {key: np.concatenate([one[key] for one in parts]) for key in parts[0]}
    path = DATA_PATH.format(chunk_index=0, file_index=0)
    write_columns(folder / path, joined)
    write_rows(folder / path.replace("data/", "meta/episodes/", 1), episodes)
    # the texts are the index, as lerobot looks them up
    numbers = {"task_index": np.arange(len(tasks))}
    table = pd.DataFrame(numbers, index=pd.Index(tasks, name="task"))
    table.to_parquet(folder / "meta/tasks.parquet", compression="zstd")
    stats = {key: _stats(values) for key, values in joined.items()}
    _write_json(folder / "meta/stats.json", stats)
    _write_json(folder / INFO, _info(trials, rate_hz, joined, len(tasks)))


def _task(trial: TrialPayload) -> str:
    """The task of an episode, such as `pull soft-ball`; the empty hand has no object."""
    return f"{trial.about['action']} {trial.about['object'] or ''}".strip()


def _frames(trial: TrialPayload, number: int, first: int, fps: int) -> Columns:
    """The frames of an episode by column. first: the number of its first frame in the set."""
    rows = np.arange(len(trial.t_s))
    return {
        TACTILE: trial.values.astype(np.float32),
        VALID: trial.valid,
        TIME: trial.t_s,
        SITUATION: trial.label.astype(np.int64),
        # lerobot checks that stamps are exactly frame / fps; TIME has the true ones
        "timestamp": (rows / fps).astype(np.float32),
        "frame_index": rows,
        "episode_index": np.full(len(rows), number),
        "index": first + rows,
    }


def _episode(trial: TrialPayload, number: int, first: int, columns: Columns) -> Json:
    """A row of meta/episodes: where its frames are, their statistics, and what the trial was."""
    length = len(trial.t_s)
    episode: Json = {
        "episode_index": number,
        "tasks": [_task(trial)],
        "length": length,
        "dataset_from_index": first,
        "dataset_to_index": first + length,
        "holdfast": json.dumps(trial.about),
    }
    for place in ("data", "meta/episodes"):
        episode[f"{place}/chunk_index"] = 0
        episode[f"{place}/file_index"] = 0

    # an episode carries its own statistics, so that sets are joined without reading the data
    for key, values in columns.items():
        for name, figures in _stats(values).items():
            episode[f"stats/{key}/{name}"] = figures

    return episode


def _stats(values: npt.NDArray[Any]) -> dict[str, list[float]]:
    """Statistics over axis 0 without nan, by lerobot's names; 0 where nothing is left."""
    table = pd.DataFrame(values.reshape(len(values), -1).astype(np.float64))
    figures = {
        "min": table.min(),
        "max": table.max(),
        "mean": table.mean(),
        "std": table.std(ddof=0),
    }
    for name, share in QUANTILES.items():
        figures[name] = table.quantile(share)
    # JSON has no nan
    stats = {name: row.fillna(0.0).tolist() for name, row in figures.items()}
    stats["count"] = [len(table)]
    return stats


def _info(
    trials: Sequence[TrialPayload], rate_hz: float, frames: Columns, n_tasks: int
) -> Json:
    """The content of meta/info.json; what stands under `holdfast` is ours."""
    n_sensors = trials[0].n_sensors
    names = {
        TACTILE: list(channel_names(n_sensors)),
        VALID: [f"valid{sensor + 1}" for sensor in range(n_sensors)],
    }
    features: Json = {}
    for key, column in frames.items():
        # the format has no scalars: a single number has shape [1]
        shape = list(column.shape[1:]) or [1]
        features[key] = {
            "dtype": column.dtype.name,
            "shape": shape,
            "names": names.get(key),
        }

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
            "unit": trials[0].unit,
            "rate_hz": rate_hz,
            "situations": list(SITUATIONS),
            "no_label": NO_LABEL,
        },
    }


def _write_json(path: Path, value: Json) -> None:
    write_whole(path, json.dumps(value, indent=4, allow_nan=False) + "\n")


EPISODE, TASK_INDEX = "episode_index", "task_index"


def read_log(folder: Path, name: str) -> ForeignLog:
    """A set of any robot as a log of one table, its episodes in their order.

    Features of several numbers have the names that info.json gives them. `task` is the text of the
    task; of a set of `holdfast convert` there are also `person`, `object` and `action`, and
    `situation` by name. Raises DataError.
    """
    info: Json = {"features": {}, **read(folder / INFO, Json, NotANumber)}
    parts = [read_columns(path)[0] for path in sorted(folder.glob("data/**/*.parquet"))]
    if not parts:
        raise EmptyRecording("no data of an episode", where=folder / "data")
    columns: Columns = {}
    for key in parts[0]:
        if all(key in part for part in parts):
            columns[key] = np.concatenate([part[key] for part in parts])

    columns = _with_names(columns, info)
    _add_texts(columns, folder, info)
    # the stamps of the format are those of a camera; the true ones are beside them
    if TIME in columns:
        columns.pop("timestamp", None)
    return ForeignLog(folder, name, (Stream(columns),), info.get("holdfast", {}))


def _with_names(columns: Columns, info: Json) -> Columns:
    """`observation.state.0` by its name in info.json, where that names each number."""
    renamed = {}
    for feature, about in info["features"].items():
        names = about.get("names") if isinstance(about, dict) else None
        for k, label in enumerate(names if isinstance(names, list) else ()):
            renamed[f"{feature}.{k}"] = f"{feature}.{label}"

    return {renamed.get(key, key): column for key, column in columns.items()}


def _add_texts(columns: Columns, folder: Path, info: Json) -> None:
    """The columns of texts that the numbers of a frame stand for."""
    tasks = _texts(folder.glob("meta/tasks*.parquet"), TASK_INDEX, "task")
    _look_up(columns, TASK_INDEX, "task", tasks)
    if "holdfast" not in info:
        return
    rows = _texts(folder.glob("meta/episodes/**/*.parquet"), EPISODE, "holdfast")
    episodes = {number: json_of(text) for number, text in rows.items()}
    for key in ("person", "object", "action"):
        known = {number: str(about[key] or "") for number, about in episodes.items()}
        _look_up(columns, EPISODE, key, known)

    names = dict(enumerate(SITUATIONS)) | {NO_LABEL: UNLABELLED}
    _look_up(columns, SITUATION, SITUATION, names)


def _texts(paths: Iterable[Path], number: str, text: str) -> dict[int, str]:
    """Number -> text, of tables; the index of pandas may hold the text."""
    found: dict[int, str] = {}
    for path in sorted(paths):
        table, _ = read_columns(path)
        if number in table and text in table:
            found |= zip(table[number].tolist(), table[text].tolist(), strict=True)

    return found


def _look_up(columns: Columns, number: str, name: str, texts: dict[int, str]) -> None:
    """Add a column of the texts that a column of numbers stands for, where there are any."""
    if number in columns and any(texts.values()):
        cells = [texts.get(one, "") for one in columns[number].tolist()]
        columns[name] = np.array(cells, dtype=object)
