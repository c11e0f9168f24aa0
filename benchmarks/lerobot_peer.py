"""lerobot's own loader reads a set of `holdfast convert --to lerobot`: `make lerobot`.

Runs in lerobot's environment and imports no room. The Parquet of the same trials, which
pandas reads, says what every frame must hold. Prints one JSON object; fails on any difference.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

SITUATIONS = ("nothing", "grasp", "safe_slip", "risky_slip")


def main(folder: str, parquet: str) -> None:
    """Load the set, compare every frame, aggregate its statistics, and load a window."""
    from lerobot.datasets.compute_stats import aggregate_stats
    from lerobot.datasets.lerobot_dataset import CODEBASE_VERSION, LeRobotDataset

    data = LeRobotDataset("local/holdfast", root=folder)
    channels = data.meta.features["observation.tactile"]["names"]
    frames = [data[k] for k in range(data.num_frames)]
    for episode, rows in enumerate(_expected(Path(parquet), channels)):
        own = [one for one in frames if int(one["episode_index"]) == episode]
        _require_equal(own, rows)
    aggregate_stats([data.meta.stats])  # checks keys, types and shapes
    window = {"observation.tactile": [-0.02, -0.01, 0.0]}
    shape = LeRobotDataset("local/holdfast", root=folder, delta_timestamps=window)[5]
    figures = {
        "lerobot_format": CODEBASE_VERSION,
        "episodes": data.num_episodes,
        "frames": len(frames),
        "fps": data.fps,
        "window_shape": list(shape["observation.tactile"].shape),
    }
    print(json.dumps(figures))


def _expected(folder: Path, channels: list[str]) -> list[dict[str, Any]]:
    """The trials' columns, in the order of the names of the files."""
    import pandas as pd

    tables = [pd.read_parquet(path) for path in sorted(folder.rglob("*.parquet"))]
    valid = [f"valid{k + 1}" for k in range(len(channels) // 3)]
    return [
        {
            "values": np.column_stack([table[name].to_numpy() for name in channels]),
            "valid": np.column_stack([table[name].to_numpy() for name in valid]),
            "time_s": table["Time"].to_numpy(),
            "label": table["label"].astype(object).tolist(),
        }
        for table in tables
    ]


def _require_equal(own: list[dict[str, Any]], rows: dict[str, Any]) -> None:
    tactile = np.stack([one["observation.tactile"].numpy() for one in own])
    np.testing.assert_array_equal(tactile, rows["values"].astype(np.float32))
    valid = np.stack([one["observation.tactile_valid"].numpy() for one in own])
    np.testing.assert_array_equal(valid, rows["valid"])
    time_s = [
        one["observation.time_s"].numpy() for one in own
    ]  # torch makes it float32
    np.testing.assert_array_equal(time_s, rows["time_s"].astype(np.float32))
    labels = [int(one["situation"]) for one in own]
    expected = [
        SITUATIONS.index(name) if isinstance(name, str) else -1
        for name in rows["label"]
    ]
    np.testing.assert_array_equal(labels, expected)


if __name__ == "__main__":
    main(*sys.argv[1:])
