"""The recordings that points are fitted on and asked about, and their features, made once and kept on disk."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.cost.point import GROUPS, WINDOWS_S, Point, Set
from edge_runtime.contract import FloatArray
from edge_runtime.errors import DataError, UsageError
from edge_runtime.writing import write_whole
from export.bank import BANDS_HZ, STATES_PER_BAND, step_matrix
from export.features import LAGS_S, SCALED_LAGS, SPANS_S, feature_count
from export.spec import WINDOW_S, StepSpec
from simulation.card import read_card
from simulation.folder import write_set
from simulation.scene import Scene
from training.datasets import load
from training.featurise import FloatRows, features_everywhere, features_of
from training.recording import DataSet

Parts = Mapping[str, tuple[str, int, int]]
"""Part -> card, grasps, seed."""
PARTS: Parts = {"ask": ("daily", 600, 2), "train": ("thesis", 400, 0), "choose": ("daily", 150, 1)}
"""What a forest is asked about, was fitted on, and its threshold chosen on."""
FASTEST_HZ = 300.0
HUMAN = "human_slip_uskin"


def require_parts(folder: Path, parts: Parts) -> None:
    """Raise DataError where the folder keeps what was measured on other parts."""
    path, told = folder / "parts.json", json.dumps(parts)
    if not path.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, told)
    if path.read_text("utf-8") != told:
        raise DataError("points of other recordings", where=folder, next_step="remove the folder and begin anew")


def simulate(folder: Path, part: str, rates_hz: Sequence[float], parts: Parts) -> None:
    """A part at every rate, unless it is there: one hand, read at 300 Hz, of which a slower reader gets every nth."""
    card, grasps, seed = parts[part]
    fastest = _place(folder, FASTEST_HZ, part)
    if not fastest.is_dir():
        half = _emptied(fastest)
        write_set(Scene(read_card(card, rate_hz=FASTEST_HZ), seed), half, grasps)
        half.replace(fastest)
    for rate_hz in rates_hz:
        slower = _place(folder, rate_hz, part)
        if not slower.is_dir():
            half = _emptied(slower)
            read_slower(fastest, half, FASTEST_HZ / rate_hz)
            half.replace(slower)


def read_slower(there: Path, here: Path, ratio: float) -> None:
    """A simulated set with every nth sample: the same as read so slowly, since its sensors' noise is white."""
    if ratio != round(ratio):
        raise UsageError(f"no reading of {FASTEST_HZ:g} Hz over {ratio:g}", next_step="a rate that divides it")
    for path in sorted(there.rglob("*.csv")):
        if not path.name.endswith(".motion.csv"):
            lines = path.read_bytes().splitlines(keepends=True)
            write_whole(here / path.relative_to(there), b"".join([lines[0], *lines[1 :: round(ratio)]]))
    for path in sorted(there.rglob("*.json")):
        told = json.loads(path.read_text("utf-8"))
        changed = told | {"rate_hz": told["rate_hz"] / ratio} if "rate_hz" in told else told
        write_whole(here / path.relative_to(there), json.dumps(changed))


@cache
def read(folder: Path, of: Set, rate_hz: float, part: str) -> DataSet:
    """A part: of scenes dense to train on; human_slip_uskin is one part."""
    if of == "human":
        data = load(HUMAN)
        return replace(data, tasks={"situations": data.tasks["situations"]})
    return load(_place(folder, rate_hz, part), windows="dense" if part == "train" else "natural")


def windows(folder: Path, point: Point) -> dict[str, FloatRows]:
    """Task -> features [M, F] of the labelled windows to train on."""
    data = read(folder, point.of, point.rate_hz, "train")
    if point.bank == "float32":
        rows = everywhere(folder, point, "train")
        return {task: rows[_starts(data)[one.trial] + one.row] for task, one in data.tasks.items()}
    spec = point.spec(data)
    whole = whole_of(spec)
    paths = {task: _kept(folder, point.of, whole, f"train-{task}") for task in data.tasks}
    if not all(path.is_file() for path in paths.values()):
        for task, rows in features_of(data, whole).items():
            _save(paths[task], rows)
    kept = {task: np.load(path) for task, path in paths.items()}
    stale = [paths[task] for task, rows in kept.items() if len(rows) != len(data.tasks[task])]
    if stale:
        raise DataError("features of other windows", where=stale[0], next_step="remove the folder and begin anew")
    return {task: _seen(_taken(rows, spec), spec, point.look_back_s) for task, rows in kept.items()}


def everywhere(folder: Path, point: Point, part: str) -> FloatRows:
    """Features [sum of T, F] at every sample of a part, recording after recording."""
    data = read(folder, point.of, point.rate_hz, part)
    spec = point.spec(data)
    rows = _taken(whole_rows(folder, point, part), spec)
    if point.bank == "float32":
        bank = _bank_in_float32(data, spec)
        rows = np.hstack([rows[:, : rows.shape[1] - bank.shape[1]], bank])
    return _seen(rows, spec, point.look_back_s)


def some(folder: Path, point: Point, part: str, count: int) -> FloatRows:
    """So many rows of a part, evenly spaced; of a bank in float64 whatever the point has."""
    spec, rows = point.spec(read(folder, point.of, point.rate_hz, part)), whole_rows(folder, point, part)
    return _seen(np.array(rows[:: max(1, len(rows) // count)][:count][:, columns(spec)]), spec, point.look_back_s)


def whole_rows(folder: Path, point: Point, part: str) -> FloatRows:
    """Every feature any point takes [sum of T, F], on disk, made once."""
    data = read(folder, point.of, point.rate_hz, part)
    whole = whole_of(point.spec(data))
    path = _kept(folder, point.of, whole, part)
    if not path.is_file():
        _save(path, np.concatenate(features_everywhere(data, whole)))
    rows: FloatRows = np.load(path, mmap_mode="r")
    return rows


def whole_of(spec: StepSpec) -> StepSpec:
    """The spec whose features hold those of every point: they are computed once, each point takes its columns."""
    if "window" in spec.groups:
        return replace(spec, groups=GROUPS["raw window"], window_s=max(WINDOWS_S), bands_hz=BANDS_HZ)
    groups = GROUPS["default and bands" if "bands" in spec.groups else "default"]
    return replace(spec, groups=groups, window_s=WINDOW_S, bands_hz=BANDS_HZ)


def _taken(whole: FloatRows, spec: StepSpec) -> FloatRows:
    """A spec's columns of its whole, which is not copied where it is the same."""
    return whole if spec.groups == whole_of(spec).groups and whole.shape[1] == feature_count(spec) else (
        whole[:, columns(spec)]
    )  # fmt: skip


def columns(spec: StepSpec) -> npt.NDArray[np.int64]:
    """[F] where each feature of a spec stands in its whole; windows end together, and bands are told by their Hz."""
    whole = whole_of(spec)
    widths = [feature_count(replace(whole, groups=(name,))) for name in whole.groups]
    start = dict(zip(whole.groups, np.cumsum([0, *widths[:-1]]), strict=True))
    parts = []
    for name in spec.groups:
        own = start[name] + np.arange(feature_count(replace(whole, groups=(name,))))
        if name == "window":
            own = own.reshape(spec.n_sensors, whole.window_samples, 3)[:, -spec.window_samples :].ravel()
        if name == "bands":
            kept = [hz in spec.carried_bands() for hz in whole.carried_bands()]
            own = own.reshape(-1, len(kept))[:, kept].ravel()
        parts.append(own)
    return np.concatenate(parts)


def per_recording(data: DataSet, rows: Any) -> list[Any]:
    """Rows of all recordings -> those of each."""
    return np.split(rows, _starts(data)[1:])


def _starts(data: DataSet) -> Any:
    return np.concatenate([[0], np.cumsum([len(one.samples) for one in data.recordings])[:-1]])


def _place(folder: Path, rate_hz: float, part: str) -> Path:
    return folder / f"{rate_hz:g}hz-{part}"


def _emptied(place: Path) -> Path:
    """Where a set is made, so that a run that is stopped leaves no half of it."""
    half = place.with_name(f"{place.name}.half")
    shutil.rmtree(half, ignore_errors=True)
    return half


def _kept(folder: Path, of: Set, spec: StepSpec, part: str) -> Path:
    told = json.dumps(spec.to_json(), sort_keys=True)
    return folder / "features" / f"{of}-{hashlib.sha256(told.encode()).hexdigest()[:12]}-{part}.npy"


def _save(path: Path, rows: FloatRows) -> None:
    """In one piece or not at all: a run that is stopped leaves no half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    half = path.with_suffix(".half.npy")
    np.save(half, rows)
    half.replace(path)


def _seen(rows: FloatRows, spec: StepSpec, look_back_s: float) -> FloatRows:
    """The rows with everything that looks further back made constant, so that no tree can use it."""
    beyond = look_backs_s(spec) > look_back_s + 1e-9
    return np.where(beyond, np.float32(0.0), rows) if beyond.any() else rows


def look_backs_s(spec: StepSpec) -> FloatArray:
    """[F]: how far back each of the default groups' features looks; 0 for the others."""
    lags, spans, chosen = np.array(LAGS_S), np.array(SPANS_S), np.array(LAGS_S)[list(SCALED_LAGS)]
    known = {
        "differences": np.tile(np.repeat(lags, 3), spec.n_sensors),
        "scaled_differences": np.tile(np.repeat(chosen, 3), spec.n_sensors),
        "scaled_sums": np.repeat(lags, 3),
        "activity": np.repeat(spans, 3),
    }
    parts = []
    for name in spec.groups:
        width = feature_count(StepSpec(spec.n_sensors, spec.rate_hz, spec.unit, (name,), bands_hz=spec.bands_hz,
                                       window_s=spec.window_s))  # fmt: skip
        parts.append(known.get(name, np.zeros(width)))
    return np.concatenate(parts)


def _bank_in_float32(data: DataSet, spec: StepSpec) -> FloatRows:
    """|outputs| [sum of T, n x 2 x bands] of a bank whose state and coefficients are float32; samples are taken to be
    good, as they are in these scenes."""
    bands = spec.carried_bands()
    matrix, size = step_matrix(spec.rate_hz, bands).astype(np.float32), 1 + STATES_PER_BAND * len(bands)
    parts = []
    for recording in data.recordings:
        shear = recording.samples.reshape(len(recording.samples), -1, 3)[:, :, :2].reshape(len(recording.samples), -1)
        difference = np.diff(shear.astype(np.float32), axis=0, prepend=shear[:1].astype(np.float32))
        joined = np.zeros((shear.shape[1], 1 + size), dtype=np.float32)
        out = np.empty((len(shear), shear.shape[1], len(bands)), dtype=np.float32)
        for t, change in enumerate(difference):
            joined[:, 0] = change
            stepped = joined @ matrix
            joined[:, 1:], out[t] = stepped[:, :size], np.abs(stepped[:, size:])
        parts.append(out.reshape(len(shear), -1))
    return np.concatenate(parts)
