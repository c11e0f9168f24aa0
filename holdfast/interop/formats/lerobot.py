"""Trials as one LeRobot data set of format v3.0, an episode each: meta/, data/ (Parquet).

A frame is a sample: `observation.tactile` [C] in the unit of the set, nan where it was lost;
`observation.tactile_valid` [S]; `observation.time_s`, its true time; and `situation`, the index of
SITUATIONS or -1. The format counts `timestamp` as frame / fps, with a whole fps, and nothing is
resampled for that: `observation.time_s` is what to trust. The task of an episode names its action
and object. There is no `action`: a recording of a hand commands nothing.

The layout is that of lerobot 0.4 (lerobot/datasets/utils.py and lerobot_dataset.py); statistics are
over the values that are there. `read_log` reads any set: the episodes of all files, one after the
other.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from holdfast.core.contract import SITUATIONS, Json, channel_names, valid_names
from holdfast.core.errors import NotANumber, needs_extra
from holdfast.core.schema import json_of, read
from holdfast.core.writing import write_whole
from holdfast.data.datasets.thesis import common_rate
from holdfast.interop.formats import parquet
from holdfast.interop.formats.payload import LABELS, TrialPayload
from holdfast.interop.formats.streams import ForeignLog, Stream

with needs_extra("lerobot"):
    import pandas as pd

QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
STATISTICS = ("count", "mean", "std", "min", "q01", "q10", "q50", "q90", "q99", "max")
"""Of each feature, by lerobot's names in the order of pandas' describe."""
FIRST_FILE = {"chunk_index": 0, "file_index": 0}
INFO, TASKS, EPISODES = "meta/info.json", "meta/tasks.parquet", "meta/episodes"
TACTILE = "observation.tactile"
VALID = "observation.tactile_valid"
SITUATION, EPISODE = "situation", "episode_index"
"""Columns of a frame: the names that start with `observation.` are lerobot's convention."""


def write_trials(trials: Sequence[TrialPayload], folder: Path) -> None:
    """The whole set. Raises RateError or ChannelError where trials differ."""
    fps = round(common_rate([trial.recording for trial in trials]))
    frames = []
    episodes = []
    tasks: dict[str, int] = {}
    begins = 0
    for number, trial in enumerate(trials):
        # such as `pull soft-ball`; the empty hand has no object
        text = f"{trial.about['action']} {trial.about['object'] or ''}".strip()
        rows = np.arange(len(trial.t_s))
        frame = pd.DataFrame(
            {
                TACTILE: [*trial.values.astype(np.float32)],
                VALID: [*trial.recording.valid],
                "observation.time_s": trial.t_s,
                SITUATION: trial.label,
                # lerobot checks that stamps are exactly frame / fps
                "timestamp": (rows / fps).astype(np.float32),
                "frame_index": rows,
                EPISODE: number,
                "index": begins + rows,
                "task_index": tasks.setdefault(text, len(tasks)),
            }
        )
        frames.append(frame)
        episodes.append(
            {
                EPISODE: number,
                "tasks": [text],
                "length": len(rows),
                "dataset_from_index": begins,
                "dataset_to_index": begins + len(rows),
                "holdfast": json.dumps(trial.about),
                # a set of ours stays in the first file: it is smaller than lerobot's files
                "data": FIRST_FILE,
                "meta": {"episodes": FIRST_FILE},
                # so that sets are joined and cut without reading the data
                "stats": _stats(frame),
            }
        )
        begins += len(rows)

    whole = pd.concat(frames)
    # what is nested becomes columns such as `stats/index/min`
    flat = pd.json_normalize(episodes, sep="/")
    for part, table in (("data", whole), (EPISODES, flat)):
        path = folder / part / "chunk-000/file-000.parquet"
        path.parent.mkdir(parents=True)
        table.to_parquet(path, index=False)
    # the texts are the index, as lerobot looks them up
    numbers = pd.DataFrame({"task_index": tasks}).rename_axis("task")
    numbers.to_parquet(folder / TASKS)
    info = _info(trials, fps, whole, len(tasks))
    for file, value in (("meta/stats.json", _stats(whole)), (INFO, info)):
        write_whole(folder / file, json.dumps(value, indent=4))


def _stats(frames: pd.DataFrame) -> Json:
    """Statistics of each column without nan, by lerobot's names; 0 where nothing is left."""
    stats = {}
    for key, column in frames.items():
        table = pd.DataFrame(column.tolist(), dtype=np.float64)
        figures = table.describe(QUANTILES).set_axis(STATISTICS)
        # as lerobot has it
        figures.loc["std"] = table.std(ddof=0)
        # JSON has no nan, and lerobot one count of all rows
        stats[key] = figures.fillna(0.0).T.to_dict("list") | {"count": [len(table)]}
    return stats


def _info(
    trials: Sequence[TrialPayload], fps: int, frames: pd.DataFrame, n_tasks: int
) -> Json:
    """The content of meta/info.json; what stands under `holdfast` is ours."""
    recording = trials[0].recording
    names = {
        TACTILE: channel_names(recording.n_sensors),
        VALID: valid_names(recording.n_sensors),
    }
    features: Json = {}
    for key, column in frames.items():
        cell = np.asarray(column.iloc[0])
        # the format has no scalars: a single number has shape [1]
        features[key] = {
            "dtype": cell.dtype.name,
            "shape": cell.shape or [1],
            "names": names.get(key),
        }

    return {
        "codebase_version": "v3.0",
        "robot_type": "holdfast",
        "total_episodes": len(trials),
        "total_frames": len(frames),
        "total_tasks": n_tasks,
        # lerobot's own defaults
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(trials)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
        "holdfast": {"unit": recording.unit, "situations": SITUATIONS},
    }


def read_log(folder: Path, name: str) -> ForeignLog:
    """A set of any robot as a log of one table, its episodes in their order.

    Features of several numbers have the names that info.json gives them. `task` is the text of the
    task; of a set of `holdfast convert` there are also `person`, `object` and `action`, and
    `situation` by name. Raises DataError.
    """
    info = read(folder / INFO, Json, NotANumber)
    about = info.get("holdfast", {})
    (frames,) = parquet.read_log(folder / "data", name).streams
    table = pd.DataFrame(frames.columns)
    for feature, facts in info["features"].items():
        names = facts.get("names")
        if isinstance(names, list):
            # `observation.state.0` has its name there
            table = table.rename(
                columns={
                    f"{feature}.{k}": f"{feature}.{one}" for k, one in enumerate(names)
                }
            )
    # before v3.0 the texts are in no table
    if (folder / TASKS).exists():
        tasks = pd.read_parquet(folder / TASKS)
        texts = pd.Series(tasks.index, tasks["task_index"])
        table["task"] = table["task_index"].map(texts)
    if about:
        texts = pd.read_parquet(folder / EPISODES)["holdfast"]
        known = pd.DataFrame(map(json_of, texts))
        of_trial = known[["person", "object", "action"]].fillna("")
        table = table.join(of_trial, on=EPISODE)
        table[SITUATION] = table[SITUATION].map(LABELS.__getitem__)
        # the stamps of the format are those of a camera; the true ones are beside them
        table = table.drop(columns="timestamp")
    columns = {key: column.to_numpy() for key, column in table.items()}
    return ForeignLog(folder, name, (Stream(columns),), about)
