"""A calibration by least squares from field to force, and its errors on loads that it never saw.

A probing is a series of presses from unloaded to unloaded. Every split leaves one probing out: rows
of one press are too alike to judge a model that has seen some of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NORMAL_AXIS, BoolArray, FloatArray, Json
from holdfast.core.errors import (
    ChannelError,
    DataError,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
)
from holdfast.drivers.calibration import (
    Calibration,
    CalibrationOrigin,
    rmse_normal,
    rmse_shear,
    turn,
)

MIN_FIT_ROWS = 10
"""The matrix of one sensor has nine unknowns: fewer rows would fit anything."""
N_TREES = 200
"""Of the trees that the matrix is compared with."""
PUBLISHED_N = {"normal": 0.27, "shear": 0.12}
"""RMSE of eFlesh's network; its test rows are the last fifth of the probing it was trained on."""


LIGHT_N = 3.0
"""The shear gain is measured below this normal force: silicone stiffens, and slips are light."""
TOUCHED_N = 0.3
"""And above this one, below which a ratio is mostly noise."""
SHEAR_SHARE = 0.1
"""The load's shear over its normal force, at least."""


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
    # One sensor is a hand with a single one.
    field = field_ut[:, None, :] if field_ut.ndim == 2 else field_ut
    force = force_n
    if force_n.ndim == 1:
        force = np.full((len(force_n), 3), np.nan)
        # A probe that presses straight down says nothing about shear.
        force[:, NORMAL_AXIS] = force_n
    _require_rows(field, force, blocks)
    n_sensors = field.shape[1]
    if reversed_ is None:
        reversed_ = np.zeros(n_sensors, dtype=np.bool_)
    # Through the resting field: no load means no force, whatever the rows say.
    rest = 0.0 if rest_ut is None else rest_ut
    moved = turn(reversed_) * (field - rest)
    matrix = _solve(moved, force)

    held_out = []
    for block in _at_least_two(blocks):
        out = blocks == block
        others = _solve(moved[~out], force[~out])
        held_out.append(_rmse(moved[out], force[out], others))

    # Several sensors under one load share one residual: no load is known for each of them.
    residual = np.tile(_rmse(moved, force, matrix), (n_sensors, 1))
    meta = CalibrationOrigin(source, date, load_unit, len(field), residual)
    return Fit(Calibration(matrix, rest_ut, reversed_, meta), np.array(held_out))


def _require_rows(
    field: FloatArray, force: FloatArray, blocks: npt.NDArray[Any]
) -> None:
    rows = len(field)
    shapes = field.shape[2:], force.shape, blocks.shape
    if shapes != ((3,), (rows, 3), (rows,)):
        raise ChannelError(
            f"fields {list(field.shape)}, forces {list(force.shape)} and blocks "
            f"{list(blocks.shape)} do not fit together",
            next_step="use [M, S, 3], [M, 3] and [M]",
        )
    if rows < MIN_FIT_ROWS:
        raise EmptyRecording(
            f"{rows} rows to fit", next_step=f"press for at least {MIN_FIT_ROWS} rows"
        )

    loaded = _loaded_axes(force)
    measured = force[:, loaded]
    is_finite = np.isfinite(field).all() and np.isfinite(measured).all()
    if not loaded.any() or not is_finite:
        raise NotANumber(
            "fields or forces are not finite",
            cause="rows where a sensor was lost",
            next_step="leave these rows out",
        )


def _at_least_two(blocks: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The names of the blocks. Raises TooFewGroups."""
    # Without a second press there is nothing that the fit has not seen.
    names = np.unique(blocks)
    if len(names) < 2:
        raise TooFewGroups(
            f"{len(names)} block of loads",
            cause="the sensor was pressed once",
            next_step="press it at least twice; each block is held out once",
        )
    return names


def _loaded_axes(force: FloatArray) -> BoolArray:
    """[3] which axes were measured."""
    measured: BoolArray = np.logical_not(np.isnan(force).all(axis=0))
    return measured


def _solve(moved: FloatArray, force: FloatArray) -> FloatArray:
    """[S, 3, 3] by least squares; zeros for axes that were not measured."""
    n_sensors = moved.shape[1]
    loaded = _loaded_axes(force)
    flat = moved.reshape(len(moved), -1)
    # One matrix for all sensors at once: only their sum was measured.
    measured = force[:, loaded]
    solution, _, rank, _ = np.linalg.lstsq(flat, measured, rcond=None)
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


@dataclass(frozen=True)
class Probing:
    """field_ut [M, S, 3] less its rest; load [M, 3] in the set's unit, nan if not measured."""

    name: str
    field_ut: FloatArray
    load: FloatArray


@dataclass(frozen=True)
class LoadSet:
    """Probings of one piece of hardware.

    load_n: newtons in one unit of the load. rest_ut: [S, 3] or None. reversed_: [S] magnets that
    are upside down, or None where the polarity is unknown. evidence: lines that explain the unit.
    """

    name: str
    probings: list[Probing]
    load_unit: str
    load_n: float
    rest_ut: FloatArray | None
    reversed_: BoolArray | None
    evidence: list[str]

    @property
    def field_ut(self) -> FloatArray:
        """[M, S, 3] of all probings."""
        return np.concatenate([probing.field_ut for probing in self.probings])

    @property
    def force_n(self) -> FloatArray:
        """[M, 3] of all probings."""
        return self.load_n * np.concatenate([probing.load for probing in self.probings])

    @property
    def blocks(self) -> FloatArray:
        """[M] number of the probing of each row."""
        rows = [len(probing.load) for probing in self.probings]
        return np.repeat(np.arange(len(rows), dtype=np.float64), rows)


@dataclass(frozen=True)
class AxisError:
    """Root mean square error over the probings left out, and on each, N."""

    rmse_n: float
    each_probing_n: list[float]


@dataclass(frozen=True)
class ModelErrors:
    """A model's errors: held_out_n [G, 3] RMSE on each probing left out; nan: axis not loaded."""

    name: str
    held_out_n: FloatArray

    def by_axis(self) -> dict[str, AxisError]:
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


def calibrate(
    loads: LoadSet,
    source: str,
    date: str,
    seed: int,
    begin: Callable[[str], None] = lambda text: None,
) -> tuple[Calibration, list[ModelErrors]]:
    """(calibration of all probings, errors of the linear map and of trees on probings left out).

    begin: called with what begins now.
    """
    begin(f"{loads.name}: fitting one matrix")
    fitted = fit(
        loads.field_ut,
        loads.force_n,
        loads.blocks,
        reversed_=loads.reversed_,
        source=f"{source}/{loads.name}",
        date=date,
        load_unit=loads.load_unit,
    )
    # The fields are already less their rest; a hand's are not.
    gain = measured_shear_gain(loads, fitted.calibration)
    calibration = replace(fitted.calibration, rest_ut=loads.rest_ut, shear_gain=gain)
    begin(f"{loads.name}: extra trees on {len(loads.probings)} splits, to compare with")
    trees = ModelErrors("extra trees", _trees_rmse_n(loads, seed))

    return calibration, [ModelErrors("one matrix", fitted.held_out_n), trees]


def measured_shear_gain(loads: LoadSet, fitted: Calibration) -> float | None:
    """Ratio of shear and normal force as read, over that of the load: the median of light touches.

    None where fewer than MIN_FIT_ROWS rows have both. The map is one for all loads, and silicone
    stiffens, so a light touch reads another ratio than it has.
    """
    true_n = loads.force_n
    read_n = fitted.apply(loads.field_ut).sum(axis=1)
    true_ratio = _shear_over_normal(true_n)
    normal_n = true_n[:, NORMAL_AXIS]
    # An axis that was not measured is nan, and compares as false.
    light = (normal_n > TOUCHED_N) & (normal_n < LIGHT_N) & (true_ratio > SHEAR_SHARE)
    light &= read_n[:, NORMAL_AXIS] > 0.0
    if light.sum() < MIN_FIT_ROWS:
        return None
    gains = _shear_over_normal(read_n[light]) / true_ratio[light]
    return float(np.median(gains))


def _shear_over_normal(force_n: FloatArray) -> FloatArray:
    """[M] of forces [M, 3]."""
    shear_n = np.delete(force_n, NORMAL_AXIS, axis=1)
    normal_n = np.maximum(force_n[:, NORMAL_AXIS], 1e-9)
    ratio: FloatArray = np.sqrt((shear_n**2).sum(axis=1)) / normal_n
    return ratio


def shear_gain_in_words(gain: float | None) -> str:
    """One line for people."""
    if gain is None:
        return (
            "  shear gain: not measured, because no load has shear at a light touch; the friction "
            "estimate will take 1 (--shear-gain X writes one that is known)"
        )
    return f"  shear gain: {gain:.3g} (shear over normal force, as read over true)"


def _trees_rmse_n(loads: LoadSet, seed: int) -> FloatArray:
    """[G, 3] RMSE of extra trees on each probing, fitted to the others, N."""
    from sklearn.ensemble import ExtraTreesRegressor

    field = loads.field_ut
    force = loads.force_n
    blocks = loads.blocks
    field = field.reshape(len(blocks), -1)
    axes = np.flatnonzero(np.isfinite(force).all(axis=0))
    force = force[:, axes]
    rmse = np.full((len(loads.probings), 3), np.nan)

    for block in range(len(loads.probings)):
        out = blocks == block
        # Trees can bend as a network does; what they gain over a matrix is the pad's non-
        # linearity.
        model = ExtraTreesRegressor(N_TREES, min_samples_leaf=3, random_state=seed)
        # One axis is a vector to scikit-learn, several are a matrix.
        model.fit(field[~out], force[~out].squeeze())
        predicted = model.predict(field[out]).reshape(-1, len(axes))
        error = predicted - force[out]
        rmse[block, axes] = np.sqrt(np.mean(error**2, axis=0))

    return rmse


def in_words(loads: LoadSet, models: Sequence[ModelErrors]) -> list[str]:
    """Lines for people: the data, the evidence, the error of each model."""
    rows, n_sensors = loads.field_ut.shape[:2]
    probings = f"{len(loads.probings)} probings"
    lines = [f"{loads.name}: {probings}, {rows} rows, {n_sensors} sensors"]
    lines += [f"  {line}" for line in loads.evidence]

    for model in models:
        for axis, error in model.by_axis().items():
            each = ", ".join(f"{value:.2f}" for value in error.each_probing_n)
            rmse = f"RMSE {error.rmse_n:.2f} N on probings left out ({each})"
            # The comparison is not fair to the matrix, so the sentence says how theirs was
            # measured.
            published = f"eFlesh publishes {PUBLISHED_N[axis]} N"
            lines.append(
                f"  {model.name}, {axis}: {rmse}; {published}, on later rows of the same probing"
            )

    return lines


def as_json(loads: LoadSet, models: Sequence[ModelErrors], seed: int) -> Json:
    """The same as a JSON object."""
    errors = {}
    for model in models:
        by_axis = model.by_axis().items()
        errors[model.name] = {axis: asdict(error) for axis, error in by_axis}

    return {
        "study": loads.name,
        "probings": [probing.name for probing in loads.probings],
        "rows": len(loads.blocks),
        "sensors": loads.field_ut.shape[1],
        "load_unit": loads.load_unit,
        "evidence": loads.evidence,
        "seed": seed,
        "published_n": PUBLISHED_N,
        "models": errors,
    }
