"""A CSV file with loads beside the fields: columns Time, X1..Zn (uT) and Fx, Fy, Fz (N)."""

from __future__ import annotations

import csv
import re
import warnings
from pathlib import Path

import numpy as np

from holdfast.calibration.study import Probing, Study
from holdfast.edge_runtime.contact import NORMAL_FLOOR
from holdfast.edge_runtime.contract import NORMAL_AXIS, BoolArray, FloatArray, channel_names
from holdfast.edge_runtime.errors import (
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
)
from holdfast.edge_runtime.reading import require_lines
from holdfast.edge_runtime.visible import listed

MOST = 1e12
"""No field, force or time is larger."""
FORCES = ("Fx", "Fy", "Fz")
CHANNEL = re.compile(r"[XYZ]([1-9][0-9]{0,2})")
UNLOADED_N, LOADED_N = 0.3, 1.0
MIN_UNLOADED = 5
"""Rows below UNLOADED_N that end a probing once LOADED_N was passed."""


def csv_study(path: Path) -> Study:
    """The study of a CSV file. Raises a DataError."""
    values, force = _read_csv(path)
    lost = ~(np.isfinite(values).all(axis=1) & np.isfinite(force).all(axis=1))
    field, force = values[~lost].reshape(int((~lost).sum()), -1, 3), force[~lost]
    starts = probing_starts(np.linalg.norm(force, axis=1))
    if len(starts) < 2:
        raise TooFewGroups(
            f"{len(starts)} probings",
            where=path,
            cause=f"the load must exceed {LOADED_N:g} N, "
            f"then stay below {UNLOADED_N:g} N for {MIN_UNLOADED} rows",
            next_step="press every fingertip at least twice, with a pause",
        )
    bounds = zip(starts, [*starts[1:], len(force)], strict=True)
    pieces = [_tared(field[a:b], force[a:b]) for a, b in bounds]
    probings = tuple(
        Probing(f"probing {k + 1}", moved, force) for k, (moved, force, _) in enumerate(pieces)
    )
    rest_ut = np.median([rest for _, _, rest in pieces], axis=0)
    reversed_ = rest_ut[:, NORMAL_AXIS] < -NORMAL_FLOOR["uT"]
    names = ", ".join(str(k + 1) for k in np.flatnonzero(reversed_)) or "none"
    rows = f"{int(lost.sum())} rows with a lost value left out"
    evidence = f"{rows}; sensors with a reversed magnet: {names}"
    return Study(path.stem, probings, "N", 1.0, rest_ut, reversed_, (evidence,))


def _tared(field: FloatArray, force: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(field less its rest, force, rest [S, 3]); rest: median of the first, unloaded rows."""
    loaded = np.flatnonzero(np.linalg.norm(force, axis=1) >= UNLOADED_N)
    rest = np.median(field[: loaded[0]], axis=0)
    return field - rest, force, rest


def probing_starts(load_n: FloatArray) -> list[int]:
    """First row of each probing: of a pause (MIN_UNLOADED rows below UNLOADED_N) before a press.

    >>> probing_starts(np.array([0.0] * 6 + [2.0] * 3 + [0.0] * 6 + [2.0] + [0.0] * 7))
    [0, 9]
    """
    pauses = [(a, b) for a, b in _runs(load_n < UNLOADED_N) if b - a >= MIN_UNLOADED]
    ends = [a for a, _ in pauses[1:]] + [len(load_n)]
    return [
        a
        for (a, b), end in zip(pauses, ends[: len(pauses)], strict=True)
        if (load_n[b:end] > LOADED_N).any()
    ]


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """(first, one past the last) of every run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _read_csv(path: Path) -> tuple[FloatArray, FloatArray]:
    """(values [T, C] uT, force [T, 3] N)."""
    header = _header(path)
    n_sensors = _require_columns(header, path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows: raised below
            table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8-sig")
    except ValueError as error:
        raise NotANumber(
            str(error), where=path, next_step="write nan for a value that was lost"
        ) from None
    if not table.size:
        raise EmptyRecording("no rows", where=path, next_step="record it again")
    if table.shape[1] != len(header):
        raise ColumnError(
            f"{table.shape[1]} columns under a header of {len(header)}",
            where=path,
            next_step="write a name for each",
        )
    if (np.abs(table[np.isfinite(table)]) > MOST).any():
        raise NotANumber(
            f"a number beyond {MOST:g}", where=path, next_step="write fields in uT and forces in N"
        )
    columns = {name: table[:, index] for index, name in enumerate(header)}
    values = np.column_stack([columns[name] for name in channel_names(n_sensors)])
    return values, np.column_stack([columns[name] for name in FORCES])


def _require_columns(header: list[str], path: Path) -> int:
    """Number of sensors, by the highest number in a column's name. Raises ColumnError."""
    numbers = [int(match[1]) for name in header if (match := CHANNEL.fullmatch(name))]
    n_sensors = max(numbers, default=1)
    wanted = ("Time", *channel_names(n_sensors), *FORCES)
    wrong = {
        "missing": [name for name in wanted if name not in header],
        "unknown": [name for name in header if name not in wanted],
        "repeated": [name for name in wanted if header.count(name) > 1],
    }
    if any(wrong.values()):
        parts = (f"{how} columns: {listed(names)}" for how, names in wrong.items() if names)
        raise ColumnError(
            ", ".join(parts),
            where=path,
            next_step="name the columns Time,X1,Y1,Z1,..,Fx,Fy,Fz and remove the others",
        )
    return n_sensors


def _header(path: Path) -> list[str]:
    try:
        require_lines(path)
        with path.open(newline="", encoding="utf-8-sig") as lines:
            return [name.strip() for name in next(csv.reader(lines), [])]
    except OSError as error:
        raise DataNotFound(
            f"cannot be read ({error.strerror})", where=path, next_step="check the path"
        ) from None
    except (UnicodeDecodeError, csv.Error):
        raise NotANumber(
            "not a CSV text file", where=path, next_step="Time,X1,Y1,Z1,..,Fx,Fy,Fz"
        ) from None
