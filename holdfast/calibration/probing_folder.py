"""A folder of probings in the layout of eflesh_calibration: one folder a probing."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from holdfast.calibration.load_unit import UNITS_N, load_unit
from holdfast.calibration.study import Probing, Study
from holdfast.edge_runtime.contract import FloatArray
from holdfast.edge_runtime.errors import (
    ChannelError,
    ColumnError,
    DataNotFound,
    NotANumber,
    TooFewGroups,
    UnitError,
)
from holdfast.edge_runtime.reading import require_lines

NO_LOAD = -1.0


def probed_study(folder: Path, axis: int) -> Study:
    """The study of a folder; axis: of the load. Raises a DataError."""
    paths = sorted(path for path in folder.iterdir() if path.is_dir())
    if len(paths) < 2:
        raise TooFewGroups(
            f"{len(paths)} probings", where=folder, next_step="one is left out: give at least two"
        )
    read = [_read_probing(path, axis) for path in paths]
    probings = tuple(probing for probing, _, _ in read)
    if len({one.field_ut.shape[1] for one in probings}) > 1:
        raise ChannelError(
            "probings of different numbers of sensors", where=folder, next_step="split the folder"
        )
    depth_mm = np.concatenate([depth for _, depth, _ in read])
    loads = np.concatenate([one.load[:, axis] for one in probings])
    n_missing = sum(missing for _, _, missing in read)
    missing = f"-1 means no reading in {n_missing} rows, left out; no other reading is below zero"
    unit, evidence = load_unit(probings, axis, loads, depth_mm)
    return Study(folder.name, probings, unit, UNITS_N[unit], None, None, (missing, *evidence))


def _read_probing(folder: Path, axis: int) -> tuple[Probing, FloatArray, int]:
    """(probing, depth [M] of the probe in mm, rows without a reading).

    The files hold the field less its rest, measured before every press.
    """
    field, states = _table(folder / "sensor_post_baselines.csv"), _table(folder / "states.csv")
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
        raise NotANumber(str(error), where=path, next_step="write plain decimal numbers") from None
    if not table.size or not np.isfinite(table).all():
        raise NotANumber("empty, or not finite", where=path, next_step="copy it again")
    return table
