"""Recordings that points are fitted and evaluated on: simulated once, read at every rate."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.cost.point import Point
from holdfast.core.errors import UsageError
from holdfast.core.writing import write_whole
from holdfast.data.datasets import load
from holdfast.data.recording import DataSet
from holdfast.data.windows import Choice
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

Parts = Mapping[str, tuple[str, int, int]]
"""Part -> scene, grasps, seed."""
PARTS: Parts = {
    "ask": ("daily", 400, 2),
    "train": ("thesis", 400, 0),
    "choose": ("daily", 150, 1),
}
"""Streams to evaluate on, trials to fit on, and streams to choose the threshold on."""
FASTEST_HZ = 300.0
HUMAN = "human_slip_uskin"


def simulate(folder: Path, part: str, rates_hz: Sequence[float], parts: Parts) -> None:
    """A part at every rate, if missing: one hand at 300 Hz, and every n-th sample of it."""
    name, grasps, seed = parts[part]
    fastest = _place(folder, FASTEST_HZ, part)
    if not fastest.is_dir():
        half = _emptied(fastest)
        write_set(Scene(read_scene_file(name, rate_hz=FASTEST_HZ), seed), half, grasps)
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
        if path.name.endswith(".motion.csv"):
            continue
        head, *lines = path.read_bytes().splitlines(keepends=True)
        kept = [head, *lines[:: round(ratio)]]
        write_whole(here / path.relative_to(there), b"".join(kept))
    for path in sorted(there.rglob("*.json")):
        meta = json.loads(path.read_text("utf-8"))
        if "rate_hz" in meta:
            meta["rate_hz"] /= ratio
        write_whole(here / path.relative_to(there), json.dumps(meta))


def read(folder: Path, point: Point, part: str) -> DataSet:
    """A part at a point's rate: windows to train on are balanced. People are one part."""
    if point.of == "human":
        data = load(HUMAN)
        return replace(data, tasks={"situations": data.tasks["situations"]})
    windows: Choice = "balanced" if part == "train" else "natural"
    return load(_place(folder, point.rate_hz, part), windows=windows)


def evaluated_part(point: Point) -> str:
    """The part that a point is evaluated on."""
    return "train" if point.of == "human" else "ask"


def _place(folder: Path, rate_hz: float, part: str) -> Path:
    return folder / f"{rate_hz:g}hz-{part}"


def _emptied(place: Path) -> Path:
    """Where a set is made, so that a run that is stopped leaves no half of it."""
    half = place.with_name(f"{place.name}.half")
    shutil.rmtree(half, ignore_errors=True)
    return half
