"""Loads beside fields, for `holdfast calibrate`: a CSV file, or a folder of probings.

A CSV file has the columns Time, X1..Zn (uT) and Fx, Fy, Fz. A folder has the layout of
eflesh_calibration: one folder a probing, with fields less their rest and one load.

The unit of eflesh_calibration is written nowhere ("weight"); it is gram-force: the pad then carries
34 N at 3.7 N/mm, in newtons it would carry 3.5 kN, and in millinewtons the published error would be
worse than that of a linear map. The field moves in steps of 2.4 (x, y) and 3.872 (z), or 0.6 and
0.968, which are 16 and 4 times the MLX90393's 0.150 and 0.242 uT.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    NORMAL_FLOOR,
    UNIT_OF,
    FloatArray,
    channel_names,
)
from holdfast.core.errors import (
    ChannelError,
    ColumnError,
    DataNotFound,
    NotANumber,
    TooFewGroups,
    UsageError,
    count_of,
)
from holdfast.sessions.calibrate import LoadSet

FORCES = ("Fx", "Fy", "Fz")
"""Columns of a CSV file with the load."""
UNLOADED_N = 0.3
LOADED_N = 1.0
"""A press begins beyond LOADED_N and is over below UNLOADED_N: noise between them ends none."""
MIN_UNLOADED = 5
"""Rows below UNLOADED_N that end a probing once LOADED_N was passed."""
NO_LOAD = -1.0
"""What eflesh_calibration writes where its load cell gave no reading."""
KINDS = {"normal_force": NORMAL_AXIS, "shear_force": 0}
"""Folder -> axis of its load. The direction of shear is unknown; it is called x here."""


def read_load_sets(path: Path, load_unit: str | None = None) -> list[LoadSet]:
    """One set of a CSV file, or a normal and a shear one of a folder.

    load_unit: N, mN or gf; None for N, and not for a folder. Raises a DataError or UsageError.
    """
    if not path.is_dir():
        return [_csv_set(path, load_unit or "N")]

    if load_unit is None:
        raise UsageError(
            "--load-unit is missing: a folder of probings names no unit",
            next_step="--load-unit gf for eflesh_calibration",
        )
    sets = []
    for kind, axis in KINDS.items():
        if (path / kind).is_dir():
            sets.append(_probed_set(path / kind, axis, load_unit))
    if not sets:
        raise DataNotFound(
            f"no {' or '.join(KINDS)} in this folder",
            where=path,
            next_step="give a folder like eflesh_calibration, or a CSV file",
        )
    return sets


def _numbers(path: Path, skip: int = 0) -> FloatArray:
    """[M, K] of a CSV file after its header. Raises DataNotFound, NotANumber."""
    try:
        return np.loadtxt(path, delimiter=",", ndmin=2, skiprows=skip)
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


def _csv_set(path: Path, load_unit: str) -> LoadSet:
    field, force = _read_csv(path, load_unit)
    # A lost value would spoil the fit of all axes, so its whole row is left out.
    whole = np.isfinite(field).all(axis=(1, 2)) & np.isfinite(force).all(axis=1)
    n_lost = int((~whole).sum())
    field = field[whole]
    force = force[whole]
    load_n = np.linalg.norm(force, axis=1)
    starts = probing_starts(load_n)
    # One probing is left out in turn, so there must be two.
    if len(starts) < 2:
        raise TooFewGroups(
            f"{len(starts)} probings",
            where=path,
            cause=f"the load must exceed {LOADED_N:g} N, "
            f"then stay below {UNLOADED_N:g} N for {MIN_UNLOADED} rows",
            next_step="press every fingertip at least twice, with a pause",
        )

    blocks = np.searchsorted(starts, np.arange(len(force)), side="right") - 1
    rests = []
    for block in range(len(starts)):
        # Each probing has its own rest, so that a drift between them is no load.
        at_rest = (blocks == block) & (load_n < UNLOADED_N)
        rests.append(np.median(field[at_rest], axis=0))

    # The rest of the hardware is that of most probings, whatever one drifted to.
    rest_ut = np.median(rests, axis=0)
    # A magnet that lies the right way up shows a resting field along the normal axis above zero.
    reversed_ = rest_ut[:, NORMAL_AXIS] < -NORMAL_FLOOR["uT"]
    turned = ", ".join(str(k + 1) for k in np.flatnonzero(reversed_)) or "none"
    left_out = f"{count_of(n_lost, 'row')} with a lost value left out"
    note = f"{left_out}; sensors with a reversed magnet: {turned}"
    names = list(map("probing {}".format, range(1, len(starts) + 1)))
    # Rows before the first pause belong to no probing.
    inside = blocks >= 0
    return LoadSet(
        path.stem,
        names,
        blocks[inside],
        (field - np.array(rests)[blocks])[inside],
        force[inside],
        load_unit,
        rest_ut,
        reversed_,
        note,
    )


def probing_starts(load_n: FloatArray) -> list[int]:
    """First row of each probing: of a pause (MIN_UNLOADED rows below UNLOADED_N) before a press.

    >>> probing_starts(np.array([0.0] * 6 + [2.0] * 3 + [0.0] * 6 + [2.0] + [0.0] * 7))
    [0, 9]
    """
    starts: list[int] = []
    pause = 0
    begins = 0
    is_pressed = True
    for row, load in enumerate(load_n.tolist()):
        # A short dip below the limit within a press is no pause.
        pause = pause + 1 if load < UNLOADED_N else 0
        if pause == MIN_UNLOADED and is_pressed:
            begins = row + 1 - MIN_UNLOADED
            is_pressed = False
        if load > LOADED_N and not is_pressed:
            starts.append(begins)
            is_pressed = True
    return starts


def _read_csv(path: Path, load_unit: str) -> tuple[FloatArray, FloatArray]:
    """(field [T, S, 3] uT, force [T, 3] N)."""
    table = _numbers(path, skip=1)
    names = path.read_text("utf-8-sig").partition("\n")[0].split(",")
    header = list(map(str.strip, names))
    # Time, three columns a sensor, three forces, in any order.
    expected = ("Time", *channel_names(max(1, (len(header) - 4) // 3)), *FORCES)
    if sorted(header) != sorted(expected) or table.shape[1] != len(header):
        missing = ", ".join(name for name in expected if name not in header)
        raise ColumnError(
            f"{table.shape[1]} columns named {', '.join(header)}; "
            f"missing: {missing or 'none'}",
            where=path,
            next_step="name the columns Time,X1,Y1,Z1,..,Fx,Fy,Fz and remove the others",
        )

    # Columns may stand in any order: they are taken by their names.
    fields = list(map(header.index, expected[1:-3]))
    forces = list(map(header.index, FORCES))
    by_sensor = table[:, fields].reshape(len(table), -1, 3)
    return by_sensor, UNIT_OF[load_unit][1] * table[:, forces]


# -- a folder of probings


def _probed_set(folder: Path, axis: int, load_unit: str) -> LoadSet:
    """The set of a folder; axis: of the load. Raises a DataError."""
    paths = sorted(path for path in folder.iterdir() if path.is_dir())
    if len(paths) < 2:
        raise TooFewGroups(
            f"{len(paths)} probings",
            where=folder,
            next_step="one is left out: give at least two",
        )

    probings = [_read_probing(path, axis, load_unit) for path in paths]
    fields = [field for field, _ in probings]
    # One matrix is fitted to all probings, so they must come from the same hardware.
    if len({field.shape[1] for field in fields}) > 1:
        raise ChannelError(
            "probings of different numbers of sensors",
            where=folder,
            next_step="split the folder",
        )
    return LoadSet(
        folder.name,
        probings=[path.name for path in paths],
        blocks=np.repeat(np.arange(len(paths)), [len(field) for field in fields]),
        field_ut=np.concatenate(fields),
        force_n=np.concatenate([force for _, force in probings]),
        load_unit=load_unit,
        rest_ut=None,
        reversed_=np.zeros(fields[0].shape[1], dtype=np.bool_),
        note="rows with -1 as their load have no reading and are left out",
    )


def _read_probing(
    folder: Path, axis: int, load_unit: str
) -> tuple[FloatArray, FloatArray]:
    """(field [M, S, 3] uT, force [M, 3] N) of one probing."""
    # The first file holds fields less the rest, the second the arm's position and the load.
    field = _numbers(folder / "sensor_post_baselines.csv")
    states = _numbers(folder / "states.csv")
    if (field.shape[1] - 1) % 3 or states.shape[1] != 5 or len(field) != len(states):
        raise ColumnError(
            f"{field.shape[1]} columns of fields, {states.shape[1]} of states, "
            f"{len(field)} and {len(states)} rows",
            where=folder,
            next_step="time and three columns a sensor; time, x, y, z, load; row for row",
        )

    read = states[:, 4] != NO_LOAD
    # The load cell measures one axis; the others are unknown, not zero.
    force_n = np.full((int(read.sum()), 3), np.nan)
    force_n[:, axis] = UNIT_OF[load_unit][1] * states[read, 4]
    return field[read, 1:].reshape(len(force_n), -1, 3), force_n
