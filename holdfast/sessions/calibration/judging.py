"""A calibration of all probings, and the errors of models on probings that they never saw.

Fields and loads of one piece of hardware, in probings; and the errors of a model on them.

A probing is a series of presses from unloaded to unloaded. Every split leaves one probing out.

Fitting a calibration: least squares from field to force, with every block held out once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NORMAL_AXIS, BoolArray, FloatArray
from holdfast.core.errors import (
    ChannelError,
    DataError,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
)
from holdfast.core.reading import Json
from holdfast.drivers.calibration import (
    Calibration,
    CalibrationOrigin,
    rmse_normal,
    rmse_shear,
    turn,
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
    flipped = (
        np.zeros(field.shape[1], dtype=np.bool_) if reversed_ is None else reversed_
    )
    moved = turn(flipped) * (field if rest_ut is None else field - rest_ut)
    matrix = _solve(moved, force)
    residual = np.tile(_rmse(moved, force, matrix), (field.shape[1], 1))
    meta = CalibrationOrigin(source, date, load_unit, len(field), residual)
    return Fit(
        Calibration(matrix, rest_ut, flipped, meta), _held_out(moved, force, blocks)
    )


def _three_axes(force_n: FloatArray) -> FloatArray:
    if force_n.ndim == 2:
        return force_n
    three = np.full((len(force_n), 3), np.nan)
    three[:, NORMAL_AXIS] = force_n
    return three


def _check_rows(field: FloatArray, force: FloatArray, blocks: npt.NDArray[Any]) -> None:
    if (
        field.shape[2:] != (3,)
        or force.shape != (len(field), 3)
        or blocks.shape != (len(field),)
    ):
        raise ChannelError(
            f"fields {list(field.shape)}, forces {list(force.shape)} and blocks "
            f"{list(blocks.shape)} do not fit together",
            next_step="use [M, S, 3], [M, 3] and [M]",
        )
    if len(field) < MIN_FIT_ROWS:
        raise EmptyRecording(
            f"{len(field)} rows to fit",
            next_step=f"press for at least {MIN_FIT_ROWS} rows",
        )
    loaded = _loaded_axes(force)
    if not loaded.any() or not (
        np.isfinite(field).all() and np.isfinite(force[:, loaded]).all()
    ):
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


def _held_out(
    moved: FloatArray, force: FloatArray, blocks: npt.NDArray[Any]
) -> FloatArray:
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


PUBLISHED_N = {"normal": 0.27, "shear": 0.12}
"""RMSE of eFlesh's network; its test rows are the last fifth of the probing it was trained on."""


@dataclass(frozen=True)
class Probing:
    """field_ut [M, S, 3] less its rest; load [M, 3] in the study's unit, nan if not measured."""

    name: str
    field_ut: FloatArray
    load: FloatArray


@dataclass(frozen=True)
class Study:
    """Probings of one piece of hardware.

    load_n: newtons in one unit of the load. rest_ut: [S, 3] or None. reversed_: [S] magnets that
    are upside down, or None where the polarity is unknown. evidence: lines that explain the unit.
    """

    name: str
    probings: tuple[Probing, ...]
    load_unit: str
    load_n: float
    rest_ut: FloatArray | None
    reversed_: BoolArray | None
    evidence: tuple[str, ...]

    @property
    def field_ut(self) -> FloatArray:
        """[M, S, 3] of all probings."""
        return np.concatenate([one.field_ut for one in self.probings])

    @property
    def force_n(self) -> FloatArray:
        """[M, 3] of all probings."""
        return self.load_n * np.concatenate([one.load for one in self.probings])

    @property
    def blocks(self) -> FloatArray:
        """[M] number of the probing of each row."""
        return np.repeat(
            np.arange(len(self.probings), dtype=np.float64),
            [len(one.load) for one in self.probings],
        )


@dataclass(frozen=True)
class AxisError:
    """Root mean square error over the probings left out, and on each, N."""

    rmse_n: float
    each_probing_n: list[float]


@dataclass(frozen=True)
class Judged:
    """A model's errors: held_out_n [G, 3] RMSE on each probing left out; nan: axis not loaded."""

    name: str
    held_out_n: FloatArray

    def errors(self) -> dict[str, AxisError]:
        """For normal and shear, where every probing was loaded on that axis."""
        errors = {}
        for axis, of in (("normal", rmse_normal), ("shear", rmse_shear)):
            each = [of(row) for row in self.held_out_n]
            if np.isfinite(each).all():
                errors[axis] = AxisError(float(np.sqrt(np.mean(np.square(each)))), each)
        return errors


N_TREES = 200


def judge(
    study: Study,
    source: str,
    day: str,
    seed: int,
    begin: Callable[[str], None] = lambda text: None,
) -> tuple[Calibration, list[Judged]]:
    """(calibration of all probings, errors of the linear map and of trees on probings left out).

    begin: called with what begins now.
    """
    begin(f"{study.name}: fitting one matrix")
    fitted = fit(
        study.field_ut,
        study.force_n,
        study.blocks,
        reversed_=study.reversed_,
        source=f"{source}/{study.name}",
        date=day,
        load_unit=study.load_unit,
    )
    plain = fitted.calibration
    calibration = Calibration(plain.matrix, study.rest_ut, plain.reversed, plain.meta)
    begin(f"{study.name}: extra trees on {len(study.probings)} splits, to compare with")
    trees = Judged("extra trees", _trees_rmse_n(study, seed))
    return calibration, [Judged("one matrix", fitted.held_out_n), trees]


def _trees_rmse_n(study: Study, seed: int) -> FloatArray:
    """[G, 3] RMSE of extra trees on each probing, fitted to the others, N."""
    from sklearn.ensemble import ExtraTreesRegressor

    field, force, blocks = study.field_ut, study.force_n, study.blocks
    field = field.reshape(len(blocks), -1)
    axes = np.flatnonzero(np.isfinite(force).all(axis=0))
    rmse = np.full((len(study.probings), 3), np.nan)
    for block in range(len(study.probings)):
        out = blocks == block
        model = ExtraTreesRegressor(N_TREES, min_samples_leaf=3, random_state=seed)
        model.fit(field[~out], force[~out][:, axes].squeeze())
        error = model.predict(field[out]).reshape(-1, len(axes)) - force[out][:, axes]
        rmse[block, axes] = np.sqrt(np.mean(error**2, axis=0))
    return rmse


def in_words(
    study: Study, judged: Sequence[Judged], calibration: Calibration
) -> Iterator[str]:
    """Lines for people: the data, the evidence, the error of each model."""
    rows, n_sensors = calibration.meta.n, len(calibration.matrix)
    yield f"{study.name}: {len(study.probings)} probings, {rows} rows, {n_sensors} sensors"
    yield from (f"  {line}" for line in study.evidence)
    for model in judged:
        for axis, error in model.errors().items():
            each = ", ".join(f"{value:.2f}" for value in error.each_probing_n)
            rmse = f"RMSE {error.rmse_n:.2f} N on probings left out ({each})"
            published = f"eFlesh publishes {PUBLISHED_N[axis]} N"
            yield f"  {model.name}, {axis}: {rmse}; {published}, on later rows of the same probing"


def as_json(study: Study, judged: Sequence[Judged], seed: int) -> Json:
    """The same as a JSON object."""
    return {
        "study": study.name,
        "probings": [one.name for one in study.probings],
        "rows": len(study.blocks),
        "sensors": study.field_ut.shape[1],
        "load_unit": study.load_unit,
        "evidence": list(study.evidence),
        "seed": seed,
        "published_n": PUBLISHED_N,
        "models": {
            model.name: {axis: asdict(error) for axis, error in model.errors().items()}
            for model in judged
        },
    }
