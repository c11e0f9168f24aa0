"""Loads beside fields, for `holdfast calibrate`: a CSV file, or a folder of probings.

A CSV file has the columns Time, X1..Zn (uT) and Fx, Fy, Fz (N). A folder has the layout of
eflesh_calibration: one folder a probing.

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
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    NORMAL_FLOOR,
    UNIT_OF,
    BoolArray,
    FloatArray,
    channel_names,
)
from holdfast.core.errors import (
    ChannelError,
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
    UnitError,
    count_of,
    listed,
)
from holdfast.sessions.calibration import PUBLISHED_N, LoadSet, Probing, fit

UNITS_N = {
    "newton": UNIT_OF["N"][1],
    "gram-force": UNIT_OF["gf"][1],
    "millinewton": UNIT_OF["mN"][1],
}
"""Newtons in one unit, of the units that a load column without a name may be in."""
LARGEST_PLAUSIBLE_N = 200.0
"""More than an arm can push into a palm-sized printed pad."""
LEAST_RATIO = 0.05
MOST_RATIO = 1.0
"""Of a network's published error to that of a linear map of the same readings."""
MOST = 1e12
"""No field, force or time is larger."""
FORCES = ("Fx", "Fy", "Fz")
"""Columns of a CSV file with the load, N."""
CHANNEL = re.compile(r"[XYZ]([1-9][0-9]{0,2})")
"""A column of field: an axis and the number of the sensor from 1."""
UNLOADED_N = 0.3
LOADED_N = 1.0
"""A press begins beyond LOADED_N and is over below UNLOADED_N: noise between them ends none."""
MIN_UNLOADED = 5
"""Rows below UNLOADED_N that end a probing once LOADED_N was passed."""
NO_LOAD = -1.0
"""What eflesh_calibration writes where its load cell gave no reading."""
KINDS = {"normal_force": NORMAL_AXIS, "shear_force": 0}
"""Folder -> axis of its load. The direction of shear is unknown; it is called x here."""


def read_load_sets(path: Path) -> list[LoadSet]:
    """One set of a CSV file, or a normal and a shear one of a folder. Raises a DataError."""
    if not path.is_dir():
        return [_csv_set(path)]

    sets = []
    for kind, axis in KINDS.items():
        if (path / kind).is_dir():
            sets.append(_probed_set(path / kind, axis))

    if not sets:
        raise DataNotFound(
            f"no {' or '.join(KINDS)} in this folder",
            where=path,
            next_step="give a folder like eflesh_calibration, or a CSV file",
        )

    return sets


def _numbers(path: Path, *, header: bool) -> tuple[list[str], FloatArray]:
    """(names of the columns, [M, K]) of a CSV file. Raises DataNotFound, NotANumber."""
    names: list[str] = []
    try:
        with path.open(encoding="utf-8-sig") as lines, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # no rows: the callers raise
            if header:
                names = [name.strip() for name in lines.readline().split(",")]
            return names, np.loadtxt(lines, delimiter=",", ndmin=2)
    except OSError:
        raise DataNotFound(
            "no such file, or unreadable", where=path, next_step="check the path"
        ) from None
    except ValueError as error:
        raise NotANumber(
            str(error),
            where=path,
            next_step="write plain decimal numbers, and nan for a value that was lost",
        ) from None


# -- a CSV file


def _csv_set(path: Path) -> LoadSet:
    # Fields are absolute here: the rest is taken off below, for each probing.
    field, force = _read_csv(path)
    # A lost value would spoil the fit of all axes, so its whole row is left out.
    has_field = np.isfinite(field).all(axis=(1, 2))
    has_force = np.isfinite(force).all(axis=1)
    whole = has_field & has_force
    n_lost = int((~whole).sum())
    field = field[whole]
    force = force[whole]
    starts = probing_starts(np.linalg.norm(force, axis=1))
    # One probing is left out in turn, so there must be two.
    if len(starts) < 2:
        raise TooFewGroups(
            f"{len(starts)} probings",
            where=path,
            cause=f"the load must exceed {LOADED_N:g} N, "
            f"then stay below {UNLOADED_N:g} N for {MIN_UNLOADED} rows",
            next_step="press every fingertip at least twice, with a pause",
        )

    probings = []
    rests = []
    for first, stop in zip(starts, [*starts[1:], len(force)], strict=True):
        load = force[first:stop]
        loaded = np.flatnonzero(np.linalg.norm(load, axis=1) >= UNLOADED_N)
        # Each probing has its own rest, so that a drift between them is no load.
        at_rest = field[first : first + loaded[0]]
        rest = np.median(at_rest, axis=0)
        rests.append(rest)
        moved = field[first:stop] - rest
        probings.append(Probing(f"probing {len(rests)}", moved, load))

    # The rest of the hardware is that of most probings, whatever one drifted to.
    rest_ut = np.median(rests, axis=0)
    # A magnet that lies the right way up shows a resting field along the normal axis above zero.
    reversed_ = rest_ut[:, NORMAL_AXIS] < -NORMAL_FLOOR["uT"]
    turned = [str(k + 1) for k in np.flatnonzero(reversed_)]
    names = ", ".join(turned) or "none"
    rows = f"{count_of(n_lost, 'row')} with a lost value left out"
    evidence = [f"{rows}; sensors with a reversed magnet: {names}"]

    return LoadSet(path.stem, probings, "N", 1.0, rest_ut, reversed_, evidence)


def probing_starts(load_n: FloatArray) -> list[int]:
    """First row of each probing: of a pause (MIN_UNLOADED rows below UNLOADED_N) before a press.

    >>> probing_starts(np.array([0.0] * 6 + [2.0] * 3 + [0.0] * 6 + [2.0] + [0.0] * 7))
    [0, 9]
    """
    # A short dip below the limit within a press is no pause.
    unloaded: BoolArray = load_n < UNLOADED_N
    # With a loaded row before and after all others, every run has two edges.
    padded = np.concatenate([[False], unloaded, [False]])
    # Each run of unloaded rows begins at one edge and ends before the next.
    changes = np.diff(padded.astype(np.int8))
    edges = np.flatnonzero(changes).reshape(-1, 2)
    lengths = edges[:, 1] - edges[:, 0]
    pauses = edges[lengths >= MIN_UNLOADED].tolist()
    # A press lasts until the next pause, the last one until the end.
    ends = [first for first, _ in pauses[1:]] + [len(load_n)]

    starts = []
    for (first, stop), end in zip(pauses, ends[: len(pauses)], strict=True):
        if (load_n[stop:end] > LOADED_N).any():
            starts.append(first)

    return starts


def _read_csv(path: Path) -> tuple[FloatArray, FloatArray]:
    """(field [T, S, 3] uT, force [T, 3] N)."""
    header, table = _numbers(path, header=True)
    n_sensors = _require_columns(header, path)
    if not table.size:
        raise EmptyRecording("no rows", where=path, next_step="record it again")
    if table.shape[1] != len(header):
        raise ColumnError(
            f"{table.shape[1]} columns under a header of {len(header)}",
            where=path,
            next_step="write a name for each",
        )
    numbers = table[np.isfinite(table)]
    if (np.abs(numbers) > MOST).any():
        raise NotANumber(
            f"a number beyond {MOST:g}",
            where=path,
            next_step="write fields in uT and forces in N",
        )

    # Columns may stand in any order: they are taken by their names.
    fields = [header.index(name) for name in channel_names(n_sensors)]
    forces = [header.index(name) for name in FORCES]
    by_sensor = table[:, fields].reshape(len(table), -1, 3)
    return by_sensor, table[:, forces]


def _require_columns(header: list[str], path: Path) -> int:
    """Number of sensors, by the highest number in a column's name. Raises ColumnError."""
    matches = [CHANNEL.fullmatch(name) for name in header]
    # The highest number counts, so that a sensor in between that is missing is named below.
    n_sensors = max((int(match[1]) for match in matches if match), default=1)
    wanted = ("Time", *channel_names(n_sensors), *FORCES)
    wrong = {
        "missing": [name for name in wanted if name not in header],
        "unknown": [name for name in header if name not in wanted],
        "repeated": [name for name in wanted if header.count(name) > 1],
    }
    parts = []
    for how, names in wrong.items():
        if names:
            parts.append(f"{how} columns: {listed(names)}")

    if parts:
        raise ColumnError(
            ", ".join(parts),
            where=path,
            next_step="name the columns Time,X1,Y1,Z1,..,Fx,Fy,Fz and remove the others",
        )

    return n_sensors


# -- a folder of probings


def _probed_set(folder: Path, axis: int) -> LoadSet:
    """The set of a folder; axis: of the load. Raises a DataError."""
    paths = sorted(path for path in folder.iterdir() if path.is_dir())
    if len(paths) < 2:
        raise TooFewGroups(
            f"{len(paths)} probings",
            where=folder,
            next_step="one is left out: give at least two",
        )

    probings = []
    depths_mm = []
    n_missing = 0
    for path in paths:
        probing, depth_mm, missing = _read_probing(path, axis)
        probings.append(probing)
        depths_mm.append(depth_mm)
        n_missing += missing

    # One matrix is fitted to all probings, so they must come from the same hardware.
    if len({probing.field_ut.shape[1] for probing in probings}) > 1:
        raise ChannelError(
            "probings of different numbers of sensors",
            where=folder,
            next_step="split the folder",
        )

    unit, evidence = load_unit(probings, axis, np.concatenate(depths_mm))
    evidence.insert(
        0,
        f"-1 means no reading in {n_missing} rows, left out; no other reading is below zero",
    )
    newtons = UNITS_N[unit]

    return LoadSet(folder.name, probings, unit, newtons, None, None, evidence)


def _read_probing(folder: Path, axis: int) -> tuple[Probing, FloatArray, int]:
    """(probing, depth [M] of the probe in mm, rows without a reading).

    The files hold the field less its rest, measured before every press.
    """
    tables = []
    # The first file holds fields less the rest, the second the arm's position and the load.
    for name in ("sensor_post_baselines.csv", "states.csv"):
        _, table = _numbers(folder / name, header=False)
        if not table.size or not np.isfinite(table).all():
            raise NotANumber(
                "empty, or not finite", where=folder / name, next_step="copy it again"
            )
        tables.append(table)

    field, states = tables
    if (field.shape[1] - 1) % 3 or states.shape[1] != 5 or len(field) != len(states):
        raise ColumnError(
            f"{field.shape[1]} columns of fields, {states.shape[1]} of states, "
            f"{len(field)} and {len(states)} rows",
            where=folder,
            next_step="time and three columns a sensor; time, x, y, z, load; row for row",
        )

    height_mm = states[:, 3]
    load = states[:, 4]
    read = load != NO_LOAD
    if (load[read] < 0.0).any():
        raise UnitError(
            "loads below zero beside the -1 for no reading",
            where=folder,
            next_step="correct states.csv",
        )

    # The load cell measures one axis; the others are unknown, not zero.
    loads = np.full((int(read.sum()), 3), np.nan)
    loads[:, axis] = load[read]
    moved = field[read, 1:].reshape(len(loads), -1, 3)
    # The arm's height falls as the probe goes down.
    depth_mm = height_mm.max() - height_mm[read]

    n_missing = int((~read).sum())
    return Probing(folder.name, moved, loads), depth_mm, n_missing


def load_unit(
    probings: Sequence[Probing], axis: int, depth_mm: FloatArray
) -> tuple[str, list[str]]:
    """(unit of the load column, the evidence); axis: of the loads.

    Raises UnitError unless readings and published error leave exactly one unit.
    """
    load = np.concatenate([probing.load for probing in probings])
    field_ut = np.concatenate([probing.field_ut for probing in probings])
    rows = [len(probing.load) for probing in probings]
    # The error of a linear map stands in the unknown unit; the published one is in newtons.
    blocks = np.repeat(np.arange(len(rows)), rows)
    linear = fit(field_ut, load, blocks)
    squares = linear.held_out_n[:, axis] ** 2
    linear_rmse = float(np.sqrt(np.mean(squares)))
    published = PUBLISHED_N["normal" if axis == NORMAL_AXIS else "shear"]
    readings = load[:, axis]
    largest = readings.max()
    # The first half of a press is soft: the probe finds the pad.
    deep = depth_mm > 0.5 * depth_mm.max()
    slope, _ = np.polyfit(depth_mm[deep], readings[deep], 1)
    per_mm = float(slope)
    # The smallest step of the readings shows the resolution of the load cell, as evidence only.
    steps = np.diff(np.unique(readings))
    step = float(np.round(steps.min(), 6))
    reach = f"up to {largest:.0f} at {depth_mm.max():.0f} mm"
    lines = [f"load column: steps of {step:g}, {reach}"]

    possible = []
    for unit, newton in UNITS_N.items():
        ratio = published / (linear_rmse * newton)
        is_plausible = largest * newton < LARGEST_PLAUSIBLE_N
        fits = is_plausible and LEAST_RATIO <= ratio <= MOST_RATIO
        if fits:
            possible.append(unit)
        verdict = "possible" if fits else "out"
        lines.append(
            f"as {unit}: largest {largest * newton:.4g} N, stiffness {per_mm * newton:.3g} "
            f"N/mm; the published {published} N would be {ratio:.2g} of a linear map's error: "
            f"{verdict}"
        )

    if len(possible) != 1:
        raise UnitError(
            f"the load column fits {' and '.join(possible) or 'no known unit'}",
            cause="; ".join(lines),
            next_step="ask the authors of the recording",
        )

    taken = f"taken as {possible[0]}"
    # Centinewtons are so close that no reading can tell them from gram-force.
    if possible == ["gram-force"]:
        taken += "; the data cannot exclude centinewton (2 % more)"
    return possible[0], [*lines, taken]
