"""A calibration by least squares from field to force, and its errors on loads that it never saw.

A probing is a series of presses from unloaded to unloaded. Every split leaves one probing out: rows
of one press are too alike to judge a model that has seen some of them.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NORMAL_AXIS, BoolArray, FloatArray, Json
from holdfast.core.errors import DataError
from holdfast.drivers.calibration import (
    Calibration,
    CalibrationOrigin,
    rmse_normal,
    rmse_shear,
    turn,
)

MIN_GAIN_ROWS = 10
"""Rows of light touches with shear: fewer show no shear gain."""
LIGHT_N = 3.0
"""The shear gain is measured below this normal force: silicone stiffens, and slips are light."""
TOUCHED_N = 0.3
"""And above this one, below which a ratio is mostly noise."""
SHEAR_SHARE = 0.1
"""The load's shear over its normal force, at least."""


@dataclass(frozen=True)
class LoadSet:
    """Rows of several probings, two at least, of one piece of hardware.

    blocks [M]: the number of a row's probing among their names. field_ut [M, S, 3]: less its rest.
    force_n [M, 3]: nan for an axis that was not measured. load_unit: in which the loads were read.
    rest_ut: [S, 3], or None where fields come tared. reversed_: [S] magnets that are upside down.
    note: what the reader left out or found.
    """

    name: str
    probings: list[str]
    blocks: npt.NDArray[Any]
    field_ut: FloatArray
    force_n: FloatArray
    load_unit: str
    rest_ut: FloatArray | None
    reversed_: BoolArray
    note: str


@dataclass(frozen=True)
class AxisError:
    """Root mean square error over the probings left out, and on each, N."""

    rmse_n: float
    each_probing_n: list[float]


@dataclass(frozen=True)
class Fit:
    """A calibration, and held_out_n [G, 3]: RMSE on each probing of a fit to the others."""

    calibration: Calibration
    held_out_n: FloatArray

    def errors(self) -> dict[str, AxisError]:
        """For normal and shear, where every probing was loaded on that axis."""
        errors = {}
        for axis, rmse_of in (("normal", rmse_normal), ("shear", rmse_shear)):
            # Shear has two axes, so its error is that of a vector.
            each = [rmse_of(row) for row in self.held_out_n]
            # An axis that one probing did not load has no error over all of them.
            if np.isfinite(each).all():
                rmse_n = float(np.sqrt(np.mean(np.square(each))))
                errors[axis] = AxisError(rmse_n, each)
        return errors


def calibrate(loads: LoadSet, source: str, date: str) -> Fit:
    """The calibration of all probings: force = sum over sensors of matrix (field - rest).

    Raises DataError where the loads do not move the field in as many directions as they have.
    """
    force = loads.force_n
    blocks = loads.blocks
    # The fields are less their rest: no load means no force, whatever the rows say.
    moved = turn(loads.reversed_) * loads.field_ut
    matrix = _solve(moved, force)

    held_out = []
    for block in np.unique(blocks):
        out = blocks == block
        others = _solve(moved[~out], force[~out])
        held_out.append(_rmse(moved[out], force[out], others))

    # Several sensors under one load share one residual: no load is known for each of them.
    residual = np.tile(_rmse(moved, force, matrix), (len(matrix), 1))
    origin = CalibrationOrigin(
        f"{source}/{loads.name}", date, loads.load_unit, len(force), residual
    )
    tared = Calibration(matrix, None, loads.reversed_, origin)
    gain = measured_shear_gain(loads, tared)
    # A hand's fields are not less their rest, so its calibration has it.
    fitted = replace(tared, rest_ut=loads.rest_ut, shear_gain=gain)
    return Fit(fitted, np.array(held_out))


def _solve(moved: FloatArray, force: FloatArray) -> FloatArray:
    """[S, 3, 3] by least squares; zeros for axes that were not measured."""
    n_sensors = moved.shape[1]
    loaded = ~np.isnan(force).all(axis=0)
    flat = moved.reshape(len(moved), -1)
    # One matrix for all sensors at once: only their sum was measured.
    solution, _, rank, _ = np.linalg.lstsq(flat, force[:, loaded], rcond=None)
    if rank < loaded.sum():
        raise DataError(
            f"loads along {loaded.sum()} axes move the field in {rank} directions only",
            cause="a lost magnet, or a probe that was pressed in one direction only",
            next_step="check the fields, then press and shear to every side",
        )

    matrix = np.zeros((n_sensors, 3, 3))
    # lstsq gives [S * 3 fields, forces]; a sensor's matrix is [forces, 3 fields].
    by_sensor = solution.T.reshape(-1, n_sensors, 3)
    matrix[:, loaded, :] = by_sensor.transpose(1, 0, 2)
    return matrix


def _rmse(moved: FloatArray, force: FloatArray, matrix: FloatArray) -> FloatArray:
    """[3] root mean square error of the sum of the shares, nan where an axis was not measured."""
    error = np.einsum("sij,tsj->ti", matrix, moved) - force
    root: FloatArray = np.sqrt(np.mean(error**2, axis=0))
    return root


def measured_shear_gain(loads: LoadSet, fitted: Calibration) -> float | None:
    """Ratio of shear and normal force as read, over that of the load: the median of light touches.

    None where fewer than MIN_GAIN_ROWS rows have both. The map is one for all loads, and silicone
    stiffens, so a light touch reads another ratio than it has.
    """
    true_n = loads.force_n
    read_n = fitted.apply(loads.field_ut).sum(axis=1)
    true_ratio = _shear_over_normal(true_n)
    normal_n = true_n[:, NORMAL_AXIS]
    # An axis that was not measured is nan, and compares as false.
    light = (normal_n > TOUCHED_N) & (normal_n < LIGHT_N) & (true_ratio > SHEAR_SHARE)
    light &= read_n[:, NORMAL_AXIS] > 0.0
    if light.sum() < MIN_GAIN_ROWS:
        return None
    gains = _shear_over_normal(read_n[light]) / true_ratio[light]
    return float(np.median(gains))


def _shear_over_normal(force_n: FloatArray) -> FloatArray:
    """[M] of forces [M, 3]."""
    shear_n = np.delete(force_n, NORMAL_AXIS, axis=1)
    normal_n = np.maximum(force_n[:, NORMAL_AXIS], 1e-9)
    ratio: FloatArray = np.sqrt((shear_n**2).sum(axis=1)) / normal_n
    return ratio


def in_words(loads: LoadSet, fit: Fit) -> list[str]:
    """Lines for people: the data, the errors on probings left out, the shear gain."""
    rows, n_sensors = loads.field_ut.shape[:2]
    probings = f"{len(loads.probings)} probings"
    lines = [f"{loads.name}: {probings}, {rows} rows, {n_sensors} sensors"]
    lines.append(f"  {loads.note}; loads in {loads.load_unit}")
    for axis, error in fit.errors().items():
        each = ", ".join(f"{value:.2f}" for value in error.each_probing_n)
        lines.append(
            f"  {axis}: RMSE {error.rmse_n:.2f} N on probings left out ({each})"
        )

    gain = fit.calibration.shear_gain
    if gain is None:
        lines.append(
            "  shear gain: not measured, because no load has shear at a light touch; the friction "
            "estimate will take 1 (--shear-gain X writes one that is known)"
        )
    else:
        lines.append(
            f"  shear gain: {gain:.3g} (shear over normal force, as read over true)"
        )
    return lines


def as_json(loads: LoadSet, fit: Fit) -> Json:
    """The same as a JSON object."""
    return {
        "study": loads.name,
        "probings": loads.probings,
        "rows": len(loads.blocks),
        "sensors": loads.field_ut.shape[1],
        "load_unit": loads.load_unit,
        "note": loads.note,
        "errors": {axis: asdict(error) for axis, error in fit.errors().items()},
        "shear_gain": fit.calibration.shear_gain,
    }
