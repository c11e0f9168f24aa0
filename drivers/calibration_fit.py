"""Fitting a calibration: least squares from field to force, with every block held out once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.drivers.calibration import Calibration, CalibrationOrigin, turn
from holdfast.edge_runtime.contract import NORMAL_AXIS, BoolArray, FloatArray
from holdfast.edge_runtime.errors import (
    ChannelError,
    DataError,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
)

MIN_FIT_ROWS = 10


@dataclass(frozen=True)
class Fit:
    """A calibration, and held_out_n [G, 3]: RMSE on each block of a fit to the other blocks."""

    calibration: Calibration
    held_out_n: FloatArray


def fit(
    field_ut: FloatArray,
    force_n: FloatArray,
    blocks: npt.NDArray[Any],
    *,
    rest_ut: FloatArray | None = None,
    reversed_: BoolArray | None = None,
    source: str = "",
    date: str = "",
    load_unit: str = "N",
) -> Fit:
    """Least squares through the resting field: force = sum over sensors of matrix (field - rest).

    field_ut: [M, 3], or [M, S, 3] for S sensors under one load. force_n: [M, 3], a column of nan
    for an axis that was not measured; or [M], the normal alone. blocks: [M], the press to which a
    row belongs; each block is held out once. rest_ut: [S, 3], None where the field is tared. Raises
    ChannelError, NotANumber, EmptyRecording, TooFewGroups, or DataError where the loads do not move
    the field in as many directions as they have.
    """
    field = field_ut[:, None, :] if field_ut.ndim == 2 else field_ut
    force = _three_axes(force_n)
    _check_rows(field, force, blocks)
    flipped = np.zeros(field.shape[1], dtype=np.bool_) if reversed_ is None else reversed_
    moved = turn(flipped) * (field if rest_ut is None else field - rest_ut)
    matrix = _solve(moved, force)
    residual = np.tile(_rmse(moved, force, matrix), (field.shape[1], 1))
    meta = CalibrationOrigin(source, date, load_unit, len(field), residual)
    return Fit(Calibration(matrix, rest_ut, flipped, meta), _held_out(moved, force, blocks))


def _three_axes(force_n: FloatArray) -> FloatArray:
    if force_n.ndim == 2:
        return force_n
    three = np.full((len(force_n), 3), np.nan)
    three[:, NORMAL_AXIS] = force_n
    return three


def _check_rows(field: FloatArray, force: FloatArray, blocks: npt.NDArray[Any]) -> None:
    if field.shape[2:] != (3,) or force.shape != (len(field), 3) or blocks.shape != (len(field),):
        raise ChannelError(
            f"fields {list(field.shape)}, forces {list(force.shape)} and blocks "
            f"{list(blocks.shape)} do not fit together",
            next_step="use [M, S, 3], [M, 3] and [M]",
        )
    if len(field) < MIN_FIT_ROWS:
        raise EmptyRecording(
            f"{len(field)} rows to fit", next_step=f"press for at least {MIN_FIT_ROWS} rows"
        )
    loaded = _loaded_axes(force)
    if not loaded.any() or not (np.isfinite(field).all() and np.isfinite(force[:, loaded]).all()):
        raise NotANumber(
            "fields or forces are not finite",
            cause="rows where a sensor was lost",
            next_step="leave these rows out",
        )


def _loaded_axes(force: FloatArray) -> BoolArray:
    """[3] which axes were measured."""
    return np.array([not np.isnan(column).all() for column in force.T])


def _solve(moved: FloatArray, force: FloatArray) -> FloatArray:
    """[S, 3, 3] by least squares; zeros for axes that were not measured."""
    n_sensors, loaded = moved.shape[1], _loaded_axes(force)
    solution, _, rank, _ = np.linalg.lstsq(
        moved.reshape(len(moved), -1), force[:, loaded], rcond=None
    )
    if rank < loaded.sum():
        raise DataError(
            f"loads along {loaded.sum()} axes move the field in {rank} directions only",
            cause="a lost magnet, or a probe that was pressed in one direction only",
            next_step="check the fields, then press and shear to every side",
        )
    matrix = np.zeros((n_sensors, 3, 3))
    matrix[:, loaded, :] = solution.T.reshape(-1, n_sensors, 3).transpose(1, 0, 2)
    return matrix


def _rmse(moved: FloatArray, force: FloatArray, matrix: FloatArray) -> FloatArray:
    """[3] root mean square error of the sum of the shares, nan where an axis was not measured."""
    error = np.einsum("sij,tsj->ti", matrix, moved) - force
    root: FloatArray = np.sqrt(np.mean(error**2, axis=0))
    return root


def _held_out(moved: FloatArray, force: FloatArray, blocks: npt.NDArray[Any]) -> FloatArray:
    names = np.unique(blocks)
    if len(names) < 2:
        raise TooFewGroups(
            f"{len(names)} block of loads",
            cause="the sensor was pressed once",
            next_step="press it at least twice; each block is held out once",
        )
    return np.array([_one_held_out(moved, force, blocks == name) for name in names])


def _one_held_out(moved: FloatArray, force: FloatArray, out: BoolArray) -> FloatArray:
    return _rmse(moved[out], force[out], _solve(moved[~out], force[~out]))
