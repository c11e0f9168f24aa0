"""Recordings that points are fitted and evaluated on: simulated once, read at every rate."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.cost.hands import on_hand
from benchmarks.cost.point import Set
from holdfast.core.errors import DataError, UsageError
from holdfast.core.writing import write_whole
from holdfast.export.pooled import side_matrix
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.featurise import spec_for
from holdfast.training.recording import DataSet

Parts = Mapping[str, tuple[str, int, int]]
"""Part -> card, grasps, seed."""
PARTS: Parts = {
    "ask": ("daily", 400, 2),
    "train": ("thesis", 400, 0),
    "choose": ("daily", 150, 1),
}
"""Streams to evaluate on, trials to fit on, and streams to choose the threshold on."""
FASTEST_HZ = 300.0
HUMAN = "human_slip_uskin"


def require_parts(folder: Path, parts: Parts) -> None:
    """Raise DataError where the folder keeps what was measured on other parts."""
    path = folder / "parts.json"
    text = json.dumps(parts)
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, text)
    if path.read_text("utf-8") != text:
        raise DataError(
            "points of other recordings",
            where=folder,
            next_step="remove the folder and begin anew",
        )


def simulate(folder: Path, part: str, rates_hz: Sequence[float], parts: Parts) -> None:
    """A part at every rate, if missing: one hand at 300 Hz, and every n-th sample of it."""
    card, grasps, seed = parts[part]
    fastest = _place(folder, FASTEST_HZ, part)
    if not fastest.is_dir():
        half = _emptied(fastest)
        write_set(Scene(read_scene_file(card, rate_hz=FASTEST_HZ), seed), half, grasps)
        half.replace(fastest)
    for rate_hz in rates_hz:
        slower = _place(folder, rate_hz, part)
        if not slower.is_dir():
            half = _emptied(slower)
            read_slower(fastest, half, FASTEST_HZ / rate_hz)
            half.replace(slower)


def read_slower(there: Path, here: Path, ratio: float) -> None:
    """A simulated set with every n-th sample: equals a slower reader, as the noise is white."""
    if ratio != round(ratio):
        raise UsageError(
            f"no reading of {FASTEST_HZ:g} Hz over {ratio:g}",
            next_step="a rate that divides it",
        )
    for path in sorted(there.rglob("*.csv")):
        if not path.name.endswith(".motion.csv"):
            lines = path.read_bytes().splitlines(keepends=True)
            write_whole(
                here / path.relative_to(there),
                b"".join([lines[0], *lines[1 :: round(ratio)]]),
            )
    for path in sorted(there.rglob("*.json")):
        meta = json.loads(path.read_text("utf-8"))
        changed = (
            meta | {"rate_hz": meta["rate_hz"] / ratio} if "rate_hz" in meta else meta
        )
        write_whole(here / path.relative_to(there), json.dumps(changed))


@cache
def read(folder: Path, of: Set, rate_hz: float, part: str) -> DataSet:
    """A part: of scenes balanced (dense) to train on; human_slip_uskin is one part.

    part: "ask, turned" is the part "ask" on another hand (hands.py).
    """
    part, _, hand = part.partition(", ")
    if hand:
        data = read(folder, of, rate_hz, part)
        thumb = side_matrix(spec_for(data, ("now",)))[:, 0] > 0.0
        return on_hand(data, hand, thumb)
    if of == "human":
        data = load(HUMAN)
        return replace(data, tasks={"situations": data.tasks["situations"]})
    return load(
        _place(folder, rate_hz, part),
        windows="balanced" if part == "train" else "natural",
    )


def per_recording(data: DataSet, rows: Any) -> list[Any]:
    """Rows of all recordings -> those of each."""
    return np.split(rows, starts(data)[1:])


def starts(data: DataSet) -> Any:
    """The row at which each recording begins in rows of them all."""
    return np.concatenate(
        [[0], np.cumsum([len(one.samples) for one in data.recordings])[:-1]]
    )


def _place(folder: Path, rate_hz: float, part: str) -> Path:
    return folder / f"{rate_hz:g}hz-{part}"


def _emptied(place: Path) -> Path:
    """Where a set is made, so that a run that is stopped leaves no half of it."""
    half = place.with_name(f"{place.name}.half")
    shutil.rmtree(half, ignore_errors=True)
    return half
