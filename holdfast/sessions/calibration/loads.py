"""The unit of a load column that names none, from the readings themselves.

The unit of eflesh_calibration is written nowhere ("weight"). The evidence, printed with every run:

- A reading of exactly -1 is no load: nearly every second row has it, and no other reading is below
  zero. It is left out.
- The deeper half of a press gives the pad's stiffness, and its end the largest load. In newtons the
  pad would carry 3.5 kN at 380 N/mm under a probe that an arm holds; in gram-force 34 N at 3.7 N/mm
  (shear: 18 N at 1.1 N/mm).
- The authors publish errors of 0.27 N and 0.12 N. A network is not 250 times better than the best
  linear map of the same readings, so newtons are out; nor is it worse than a linear map, so
  millinewtons are out. Gram-force is what is left.
- Centinewtons differ from gram-force by 2 %, which the data cannot resolve; a column called
  "weight" is more likely gram-force.

The field needs no guess: it moves in steps of 2.4 (x, y) and 3.872 (z), or 0.6 and 0.968, which are
16 and 4 times the MLX90393's 0.150 and 0.242 uT.

A CSV file with loads beside the fields: columns Time, X1..Zn (uT) and Fx, Fy, Fz (N).

Where the loads are: a CSV file, or a folder of probings.

A folder of probings in the layout of eflesh_calibration: one folder a probing.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from holdfast.core.contract import NORMAL_AXIS, BoolArray, FloatArray, channel_names
from holdfast.core.errors import (
    ChannelError,
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
    UnitError,
    listed,
)
from holdfast.core.reading import require_lines
from holdfast.core.trial_layout import NORMAL_FLOOR
from holdfast.sessions.calibration.judging import PUBLISHED_N, Probing, Study, fit

UNITS_N = {"newton": 1.0, "gram-force": 9.80665e-3, "millinewton": 1e-3}
LARGEST_PLAUSIBLE_N = 200.0
"""More than an arm can push into a palm-sized printed pad."""


def load_unit(
    probings: Sequence[Probing], axis: int, loads: FloatArray, depth_mm: FloatArray
) -> tuple[str, tuple[str, ...]]:
    """(unit of the load column, the evidence).

    Raises UnitError unless readings and published error leave exactly one unit.
    """
    published = PUBLISHED_N["normal" if axis == NORMAL_AXIS else "shear"]
    blocks = np.repeat(np.arange(len(probings)), [len(one.load) for one in probings])
    linear = fit(
        np.concatenate([one.field_ut for one in probings]),
        np.concatenate([one.load for one in probings]),
        blocks,
    )
    units_rmse = float(np.sqrt(np.mean(linear.held_out_n[:, axis] ** 2)))
    stiffness = _stiffness_per_mm(loads, depth_mm)
    reach = f"up to {loads.max():.0f} at {depth_mm.max():.0f} mm"
    lines = [f"load column: steps of {_resolution(loads):g}, {reach}"]
    left = []
    for unit, newton in UNITS_N.items():
        ratio = published / (units_rmse * newton)
        fits = loads.max() * newton < LARGEST_PLAUSIBLE_N and 0.05 <= ratio <= 1.0
        left += [unit] if fits else []
        lines.append(
            f"as {unit}: largest {loads.max() * newton:.4g} N, stiffness {stiffness * newton:.3g} "
            f"N/mm; the published {published} N would be {ratio:.2g} of a linear map's error: "
            + ("possible" if fits else "out")
        )
    if len(left) != 1:
        raise UnitError(
            f"the load column fits {' and '.join(left) or 'no known unit'}",
            cause="; ".join(lines),
            next_step="ask the authors of the recording",
        )
    doubt = (
        "; the data cannot exclude centinewton (2 % more)"
        if left == ["gram-force"]
        else ""
    )
    return left[0], (*lines, f"taken as {left[0]}{doubt}")


def _resolution(loads: FloatArray) -> float:
    """Smallest step between two readings."""
    return float(np.round(np.diff(np.unique(loads)).min(), 6))


def _stiffness_per_mm(loads: FloatArray, depth_mm: FloatArray) -> float:
    """Slope of the load over the deeper half of the press, least squares."""
    deep = depth_mm > 0.5 * depth_mm.max()
    return float(np.polyfit(depth_mm[deep], loads[deep], 1)[0])


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
        Probing(f"probing {k + 1}", moved, force)
        for k, (moved, force, _) in enumerate(pieces)
    )
    rest_ut = np.median([rest for _, _, rest in pieces], axis=0)
    reversed_ = rest_ut[:, NORMAL_AXIS] < -NORMAL_FLOOR["uT"]
    names = ", ".join(str(k + 1) for k in np.flatnonzero(reversed_)) or "none"
    rows = f"{int(lost.sum())} rows with a lost value left out"
    evidence = f"{rows}; sensors with a reversed magnet: {names}"
    return Study(path.stem, probings, "N", 1.0, rest_ut, reversed_, (evidence,))


def _tared(
    field: FloatArray, force: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
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
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    )
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _read_csv(path: Path) -> tuple[FloatArray, FloatArray]:
    """(values [T, C] uT, force [T, 3] N)."""
    header = _header(path)
    n_sensors = _require_columns(header, path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows: raised below
            table = np.loadtxt(
                path, delimiter=",", skiprows=1, ndmin=2, encoding="utf-8-sig"
            )
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
            f"a number beyond {MOST:g}",
            where=path,
            next_step="write fields in uT and forces in N",
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
        parts = (
            f"{how} columns: {listed(names)}" for how, names in wrong.items() if names
        )
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


NO_LOAD = -1.0


def probed_study(folder: Path, axis: int) -> Study:
    """The study of a folder; axis: of the load. Raises a DataError."""
    paths = sorted(path for path in folder.iterdir() if path.is_dir())
    if len(paths) < 2:
        raise TooFewGroups(
            f"{len(paths)} probings",
            where=folder,
            next_step="one is left out: give at least two",
        )
    read = [_read_probing(path, axis) for path in paths]
    probings = tuple(probing for probing, _, _ in read)
    if len({one.field_ut.shape[1] for one in probings}) > 1:
        raise ChannelError(
            "probings of different numbers of sensors",
            where=folder,
            next_step="split the folder",
        )
    depth_mm = np.concatenate([depth for _, depth, _ in read])
    loads = np.concatenate([one.load[:, axis] for one in probings])
    n_missing = sum(missing for _, _, missing in read)
    missing = f"-1 means no reading in {n_missing} rows, left out; no other reading is below zero"
    unit, evidence = load_unit(probings, axis, loads, depth_mm)
    return Study(
        folder.name, probings, unit, UNITS_N[unit], None, None, (missing, *evidence)
    )


def _read_probing(folder: Path, axis: int) -> tuple[Probing, FloatArray, int]:
    """(probing, depth [M] of the probe in mm, rows without a reading).

    The files hold the field less its rest, measured before every press.
    """
    field, states = (
        _table(folder / "sensor_post_baselines.csv"),
        _table(folder / "states.csv"),
    )
    if (field.shape[1] - 1) % 3 or states.shape[1] != 5 or len(field) != len(states):
        raise ColumnError(
            f"{field.shape[1]} columns of fields, {states.shape[1]} of states, "
            f"{len(field)} and {len(states)} rows",
            where=folder,
            next_step="time and three columns a sensor; time, x, y, z, load; row for row",
        )
    load = states[:, 4]
    read = load != NO_LOAD
    if (load[read] < 0.0).any():
        raise UnitError(
            "loads below zero beside the -1 for no reading",
            where=folder,
            next_step="correct states.csv",
        )
    three = np.full((int(read.sum()), 3), np.nan)
    three[:, axis] = load[read]
    depth_mm = states[:, 3].max() - states[read, 3]
    return (
        Probing(folder.name, field[read, 1:].reshape(len(three), -1, 3), three),
        depth_mm,
        int((~read).sum()),
    )


def _table(path: Path) -> FloatArray:
    """A CSV file of numbers without a header."""
    try:
        require_lines(path)
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except OSError:
        raise DataNotFound(
            "no such file, or unreadable", where=path, next_step="copy the folder again"
        ) from None
    except ValueError as error:
        raise NotANumber(
            str(error), where=path, next_step="write plain decimal numbers"
        ) from None
    if not table.size or not np.isfinite(table).all():
        raise NotANumber("empty, or not finite", where=path, next_step="copy it again")
    return table


KINDS = {"normal_force": NORMAL_AXIS, "shear_force": 0}
"""Folder -> axis of its load. The direction of shear is unknown; it is called x here."""


def read_studies(path: Path) -> list[Study]:
    """One study of a CSV file, or a normal and a shear one of a folder. Raises a DataError."""
    if not path.is_dir():
        return [csv_study(path)]
    kinds = [kind for kind in KINDS if (path / kind).is_dir()]
    if not kinds:
        raise DataNotFound(
            f"no {' or '.join(KINDS)} in this folder",
            where=path,
            next_step="give a folder like eflesh_calibration, or a CSV file",
        )
    return [probed_study(path / kind, KINDS[kind]) for kind in kinds]
