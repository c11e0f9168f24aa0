"""Features of the recordings, made once and kept on disk; every point takes its columns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from benchmarks.cost.kept_rows import digest_of, kept_rows
from benchmarks.cost.point import EVERY_POOLED, GROUPS, WINDOWS_S, Point, Set
from benchmarks.cost.recordings import read
from holdfast.core.contract import FloatArray
from holdfast.core.errors import DataError
from holdfast.export.features import LAGS_S, SCALED_LAGS, SPANS_S, feature_count
from holdfast.export.spec import BANDS_HZ, WINDOW_S, StepSpec
from holdfast.training.crossval import main_task
from holdfast.training.featurise import FloatRows, features_everywhere, features_of


def windows(folder: Path, point: Point) -> FloatRows:
    """Features [M, F] of the labelled windows to train on."""
    data = read(folder, point.of, point.rate_hz, "train")
    labelled = data.tasks[main_task(data)]
    spec = point.spec(data)
    kept = _whole(
        folder,
        point.of,
        spec,
        "train-windows",
        lambda whole: features_of(data, whole)[main_task(data)],
    )
    if len(kept) != len(labelled):
        raise DataError(
            "features of other windows",
            where=folder,
            next_step="remove the folder and begin anew",
        )
    return _seen(_taken(kept, spec), spec, point.look_back_s)


def everywhere(folder: Path, point: Point, part: str) -> FloatRows:
    """Features [sum of T, F] at every sample of a part, recording after recording."""
    spec = point.spec(read(folder, point.of, point.rate_hz, part))
    rows = _taken(whole_rows(folder, point, part), spec)
    return _seen(rows, spec, point.look_back_s)


def some(folder: Path, point: Point, part: str, count: int) -> FloatRows:
    """So many rows of a part, evenly spaced."""
    spec = point.spec(read(folder, point.of, point.rate_hz, part))
    rows = whole_rows(folder, point, part)
    return _seen(
        np.array(rows[:: max(1, len(rows) // count)][:count][:, columns(spec)]),
        spec,
        point.look_back_s,
    )


def whole_rows(folder: Path, point: Point, part: str) -> FloatRows:
    """Every feature any point takes [sum of T, F], on disk, made once."""
    data = read(folder, point.of, point.rate_hz, part)
    spec = point.spec(data)
    return _whole(
        folder,
        point.of,
        spec,
        part,
        lambda whole: np.concatenate(features_everywhere(data, whole)),
    )


def _whole(
    folder: Path,
    of: Set,
    spec: StepSpec,
    name: str,
    computed: Callable[[StepSpec], FloatRows],
) -> FloatRows:
    """The features of a whole spec, from disk. Bands come last, so files without them may exist."""
    whole = whole_of(spec)
    path = _kept(folder, of, whole, name)

    def from_bands_or_computed() -> FloatRows:
        with_bands = _kept(
            folder,
            of,
            msgspec.structs.replace(whole, groups=GROUPS["default and bands"]),
            name,
        )
        has_none = "window" in whole.groups or whole.is_pooled
        if has_none or not with_bands.is_file():
            return computed(whole)
        rows: FloatRows = np.load(with_bands, mmap_mode="r")[:, : feature_count(whole)]
        return rows

    return kept_rows(path, from_bands_or_computed)


def whole_of(spec: StepSpec) -> StepSpec:
    """The spec whose features include those of every point, so that they are computed once."""
    if spec.is_pooled:
        groups = GROUPS[EVERY_POOLED]
        return msgspec.structs.replace(spec, groups=groups, min_valid_sensors=0)
    if "window" in spec.groups:
        return msgspec.structs.replace(
            spec,
            groups=GROUPS["raw window"],
            window_s=max(WINDOWS_S),
            bands_hz=BANDS_HZ,
        )
    groups = GROUPS["default and bands" if "bands" in spec.groups else "default"]
    return msgspec.structs.replace(
        spec, groups=groups, window_s=WINDOW_S, bands_hz=BANDS_HZ
    )


def _taken(whole: FloatRows, spec: StepSpec) -> FloatRows:
    """A spec's columns of its whole, which is not copied where they are all."""
    chosen = columns(spec)
    return whole if len(chosen) == whole.shape[1] else whole[:, chosen]


def columns(spec: StepSpec) -> npt.NDArray[np.int64]:
    """[F] columns of a spec's features in its whole; bands are matched by their Hz."""
    whole = whole_of(spec)
    widths = [
        feature_count(msgspec.structs.replace(whole, groups=(name,)))
        for name in whole.groups
    ]
    start = dict(zip(whole.groups, np.cumsum([0, *widths[:-1]]), strict=True))
    parts = []
    for name in spec.groups:
        own = start[name] + np.arange(
            feature_count(msgspec.structs.replace(whole, groups=(name,)))
        )
        if name == "window":
            own = own.reshape(spec.n_sensors, whole.window_samples, 3)[
                :, -spec.window_samples :
            ].ravel()
        if name == "bands":
            kept = [hz in spec.usable_bands() for hz in whole.usable_bands()]
            own = own.reshape(-1, len(kept))[:, kept].ravel()
        parts.append(own)
    return np.concatenate(parts)


def _kept(folder: Path, of: Set, spec: StepSpec, part: str) -> Path:
    name = f"{of}-{digest_of(spec.to_json())}-{part.replace(', ', '-')}.npy"
    return folder / "features" / name.replace(" ", "-")


def _seen(rows: FloatRows, spec: StepSpec, look_back_s: float) -> FloatRows:
    """The rows, features that look further back made constant, so that no tree uses them."""
    beyond = look_backs_s(spec) > look_back_s + 1e-9
    return np.where(beyond, np.float32(0.0), rows) if beyond.any() else rows


def look_backs_s(spec: StepSpec) -> FloatArray:
    """[F]: how far back each of the default groups' features looks; 0 for the others."""
    lags = np.array(LAGS_S)
    spans = np.array(SPANS_S)
    chosen = np.array(LAGS_S)[list(SCALED_LAGS)]
    known = {
        "differences": np.tile(np.repeat(lags, 3), spec.n_sensors),
        "scaled_differences": np.tile(np.repeat(chosen, 3), spec.n_sensors),
        "scaled_sums": np.repeat(lags, 3),
        "activity": np.repeat(spans, 3),
    }
    parts = []
    for name in spec.groups:
        width = feature_count(
            StepSpec(
                spec.n_sensors,
                spec.rate_hz,
                spec.unit,
                (name,),
                bands_hz=spec.bands_hz,
                window_s=spec.window_s,
            )
        )
        parts.append(known.get(name, np.zeros(width)))
    return np.concatenate(parts)
