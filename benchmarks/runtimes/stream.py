"""The stream that every runtime answers, and what onnxruntime answers to it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.data.datasets import load
from holdfast.edge_runtime.graph import run_recording
from holdfast.edge_runtime.model import Model
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

TRIALS = 9
LOST_EVERY = 400
LOST_ROWS = 3
"""Trials, and how often a finger is lost for how many rows."""


@dataclass(frozen=True)
class Stream:
    """values [T, C], valid [T, S]; labels [T]: the situation that onnxruntime gives, -1 unknown."""

    values: FloatArray
    valid: BoolArray
    labels: npt.NDArray[np.int64]

    def written(self, path: Path, real: npt.DTypeLike = np.float64) -> Path:
        """The rows as the C programs read them; real: their type of a number."""
        lanes = self.values.shape[1]
        sensors = self.valid.shape[1]
        rows = np.zeros(
            len(self.values), [("sample", real, lanes), ("valid", "u1", sensors)]
        )
        rows["sample"] = self.values
        rows["valid"] = self.valid
        path.write_bytes(rows.tobytes())
        return path


def stream_of(model: Model) -> Stream:
    """Trials of `thesis` (simulated) end to end, with lost fingers."""
    with tempfile.TemporaryDirectory() as work:
        scene = Scene(read_scene_file("thesis", rate_hz=model.card.rate_hz), 0)
        write_set(scene, Path(work) / "set", TRIALS)
        recordings = load(Path(work) / "set", windows="thesis").recordings
    values = np.concatenate([one.samples for one in recordings])
    valid = np.concatenate([one.valid for one in recordings])
    for k, row in enumerate(range(LOST_EVERY, len(valid), LOST_EVERY)):
        valid[row : row + LOST_ROWS, k % valid.shape[1]] = False
    out = run_recording(model.session, values, valid, ["situation", "unknown"])
    return Stream(
        values, valid, np.where(out["unknown"], -1, out["situation"]).astype(np.int64)
    )
