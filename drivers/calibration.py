"""Field to force, in one place; and the bias of an unloaded hand, with a check of how good it is.

A calibration is one matrix [3, 3] N/uT a sensor. Where several sensors lie under one load (a pad,
or six fingertips pressed in turn), each answers with its share and the load is the sum of the
shares.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from edge_runtime.contact import NORMAL_FLOOR
from edge_runtime.contract import NORMAL_AXIS, UNITS, BoolArray, FloatArray, Unit, channel_names
from edge_runtime.errors import (
    ChannelError,
    DataError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    TooFewGroups,
    UnitError,
)
from edge_runtime.reading import json_of, require_file, text_of
from edge_runtime.writing import write_whole

FORMAT = 1
CALIBRATION, BIAS = "calibration", "bias"
NEXT = {
    CALIBRATION: "write it again with holdfast calibrate PATH --out FILE",
    BIAS: "take the bias again, with nothing touching the hand",
}
MIN_FIT_ROWS = 10
MIN_BIAS_ROWS = 30
QUIET: Mapping[Unit, float] = {"N": 0.12, "uT": 40.0}
"""The spread of an untouched channel stays below this: the TMAG5273's noise is 22 uT in x and y, 11
uT in z."""


@dataclass(frozen=True)
class Meta:
    """Where a calibration comes from.

    source: of the loads. date: as the caller gave it. load_unit: what the loads were read in. n:
    rows fitted. residual_n: [S, 3] RMSE over the fitted rows, nan where an axis was never loaded;
    sensors that lie under one load have the residual of that load in common.
    """

    source: str
    date: str
    load_unit: str
    n: int
    residual_n: FloatArray


@dataclass(frozen=True)
class Calibration:
    """matrix [S, 3, 3] N/uT; rest_ut [S, 3] the resting field, None where fields come tared;
    reversed [S].

    A row of zeros in a matrix is an axis that was never loaded. The matrix is that of a magnet the
    right way up: a reversed magnet has the field of the other sign on all three axes, and is turned
    here.
    """

    matrix: FloatArray
    rest_ut: FloatArray | None
    reversed: BoolArray
    meta: Meta

    def apply(self, field_ut: FloatArray) -> FloatArray:
        """[.., S, 3] uT -> [.., S, 3] N; a lost value (nan) makes its whole sensor nan. Raises
        ChannelError."""
        if field_ut.shape[-2:] != self.matrix.shape[:2]:
            raise ChannelError(
                f"a field of shape {list(field_ut.shape)} for {len(self.matrix)} sensors",
                cause="another hand than the one that was calibrated",
                next_step=f"give [.., {len(self.matrix)}, 3], or calibrate this hand",
            )
        moved = field_ut if self.rest_ut is None else field_ut - self.rest_ut
        force: FloatArray = np.einsum("sij,...sj->...si", self.matrix, turn(self.reversed) * moved)
        return force


@dataclass(frozen=True)
class Fit:
    """A calibration, and what it would have done unseen: held_out_n [G, 3] RMSE on each block by
    the other blocks."""

    calibration: Calibration
    held_out_n: FloatArray


@dataclass(frozen=True)
class Bias:
    """What an unloaded hand reads: values [C] median, spread [C] standard deviation, over n rows;
    reversed [S].

    The values are as read; a reversed magnet is only pointed out, not turned.
    """

    values: FloatArray
    spread: FloatArray
    n: int
    unit: Unit
    reversed: BoolArray


def turn(reversed_: BoolArray) -> FloatArray:
    """[S, 1] the sign that turns a reversed magnet's field round."""
    return np.where(reversed_, -1.0, 1.0)[:, None]


def rmse_normal(error_n: FloatArray) -> float:
    """Root mean square of [.., 3] errors along the normal."""
    return float(np.sqrt(np.mean(error_n[..., NORMAL_AXIS] ** 2)))


def rmse_shear(error_n: FloatArray) -> float:
    """Root mean square of [.., 3] errors over the shear axes that were loaded (not nan); nan
    without any."""
    shear = np.delete(error_n, NORMAL_AXIS, axis=-1)
    known = shear[np.isfinite(shear)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


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
    for an axis that was not measured; or [M], the normal alone. blocks: [M], which probing a row
    belongs to; each is held out in turn. rest_ut: [S, 3], None where the field is tared. Raises
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
    meta = Meta(source, date, load_unit, len(field), residual)
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
            f"fields {list(field.shape)}, forces {list(force.shape)} and blocks {list(blocks.shape)} do not fit",
            next_step="give [M, S, 3], [M, 3] and [M]",
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
            next_step="leave those rows out",
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
            cause="a magnet that is lost, or a probe that was pressed one way",
            next_step="look at the fields, then press and shear to every side",
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
            cause="one probing",
            next_step="press at least twice; one is held out",
        )
    return np.array([_one_held_out(moved, force, blocks == name) for name in names])


def _one_held_out(moved: FloatArray, force: FloatArray, out: BoolArray) -> FloatArray:
    return _rmse(moved[out], force[out], _solve(moved[~out], force[~out]))


def bias_of(
    values: FloatArray, unit: Unit, *, normal_floor: float | None = None, quiet: float | None = None
) -> tuple[Bias, tuple[str, ...]]:
    """The bias of unloaded rows [T, C], and warnings that name the channels: rows lost, restless,
    drifting, reversed.

    normal_floor: a resting normal below minus that is a magnet upside down. quiet: the largest
    spread of an untouched channel, and the largest drift between the first and the last third; both
    in `unit`, and both have a default for N and uT. Raises EmptyRecording, NotANumber (a channel
    without MIN_BIAS_ROWS finite rows), ChannelError, UnitError.
    """
    floor, quiet = _or_default(normal_floor, NORMAL_FLOOR, unit), _or_default(quiet, QUIET, unit)
    _check_bias_rows(values)
    masked = np.where(np.isfinite(values), values, np.nan)
    middle, spread = np.nanmedian(masked, axis=0), np.nanstd(masked, axis=0)
    reversed_ = middle[NORMAL_AXIS::3] < -floor
    bias = Bias(middle, spread, len(values), unit, reversed_)
    return bias, _bias_warnings(masked, bias, quiet)


def _or_default(given: float | None, defaults: Mapping[Unit, float], unit: Unit) -> float:
    if given is None and unit not in defaults:
        raise UnitError(
            f"no usual noise is known in {unit}",
            next_step="give normal_floor and quiet in that unit",
        )
    return defaults[unit] if given is None else given


def _check_bias_rows(values: FloatArray) -> None:
    if values.ndim != 2 or values.shape[1] == 0 or values.shape[1] % 3:
        raise ChannelError(
            f"rows of shape {list(values.shape)}",
            next_step="give [T, C] with three channels a sensor",
        )
    if len(values) < MIN_BIAS_ROWS:
        raise EmptyRecording(
            f"{len(values)} rows for a bias",
            cause="the stream stopped",
            next_step=f"leave the hand alone for at least {MIN_BIAS_ROWS} rows",
        )
    few = np.isfinite(values).sum(axis=0) < MIN_BIAS_ROWS
    if few.any():
        raise NotANumber(
            f"fewer than {MIN_BIAS_ROWS} finite rows in {_named(few)}",
            cause="a finger that does not answer",
            next_step="holdfast doctor says which finger answers; or take more rows",
        )


def _bias_warnings(masked: FloatArray, bias: Bias, quiet: float) -> tuple[str, ...]:
    third = len(masked) // 3
    lost = np.isnan(masked).sum(axis=0)
    drift = np.abs(_middle(masked[-third:]) - _middle(masked[:third]))
    upside_down = np.repeat(bias.reversed, 3) & (np.arange(masked.shape[1]) % 3 == NORMAL_AXIS)
    found = (
        (
            lost > 0,
            f"up to {lost.max()} of {len(masked)} rows are lost in {{}}; next: look at that finger's wires",
        ),
        (
            bias.spread > quiet,
            f"more restless than {quiet:g} {bias.unit}: {{}}; likely cause: someone touched it; next: take it again",
        ),
        (
            drift > quiet,
            f"drifts by more than {quiet:g} {bias.unit}: {{}}; likely cause: it warms up, or a load creeps; "
            "next: wait a minute and take it again",
        ),
        (
            upside_down,
            "the magnet is reversed (normal field below zero at rest) in {}; next: turn it, or its sign",
        ),
    )
    return tuple(text.format(_named(which)) for which, text in found if which.any())


def _middle(rows: FloatArray) -> FloatArray:
    """[C] median of the finite rows; nan, and no warning of numpy's, where there is none."""
    return np.array(
        [np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in rows.T]
    )


def _named(which: BoolArray) -> str:
    names = channel_names(len(which) // 3)
    return ", ".join(names[index] for index in np.flatnonzero(which))


def write_calibration(path: str | Path, calibration: Calibration) -> Path:
    """As JSON, every bit of every number; OutputError where that cannot be done."""
    meta, rest = calibration.meta, calibration.rest_ut
    content = {
        "format": FORMAT,
        "kind": CALIBRATION,
        "matrix_n_per_ut": calibration.matrix.tolist(),
        "rest_ut": None if rest is None else rest.tolist(),
        "reversed": calibration.reversed.tolist(),
        "source": meta.source,
        "date": meta.date,
        "load_unit": meta.load_unit,
        "n": meta.n,
        "residual_n": [
            [None if np.isnan(value) else value for value in row]
            for row in meta.residual_n.tolist()
        ],
    }
    return write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def read_calibration(path: str | Path) -> Calibration:
    """Read and check. Raises DataNotFound, DataError (not JSON, another format, singular),
    ChannelError, NotANumber.

    Singular: two loaded axes are made one, or no field is a force, and the finger would read a calm
    zero for ever.
    """
    file = _File(Path(path), CALIBRATION)
    matrix = file.numbers("matrix_n_per_ut", (None, 3, 3))
    n_sensors = len(matrix)
    singular = np.flatnonzero([_is_singular(one) for one in matrix]) + 1
    if singular.size:
        raise file.wrong(DataError, f"matrix_n_per_ut of sensor {singular[0]} is singular")
    rest = None if file.value("rest_ut") is None else file.numbers("rest_ut", (n_sensors, 3))
    meta = Meta(
        file.word("source"),
        file.word("date"),
        file.word("load_unit"),
        file.count("n"),
        file.numbers("residual_n", (n_sensors, 3), gaps=True),
    )
    return Calibration(matrix, rest, file.flags("reversed", n_sensors), meta)


def _is_singular(matrix: FloatArray) -> bool:
    """Whether the rows of the axes that were loaded (not all zero) do not lead to as many
    directions, or are none."""
    largest = np.abs(matrix).max(axis=1)
    rows = matrix[largest > 0.0] / largest[largest > 0.0, None]
    return not len(rows) or int(np.linalg.matrix_rank(rows)) < len(rows)


def write_bias(path: str | Path, bias: Bias) -> Path:
    """As JSON, every bit of every number; OutputError where that cannot be done."""
    content = {
        "format": FORMAT,
        "kind": BIAS,
        "values": bias.values.tolist(),
        "spread": bias.spread.tolist(),
        "n": bias.n,
        "unit": bias.unit,
        "reversed": bias.reversed.tolist(),
    }
    return write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def read_bias(path: str | Path) -> Bias:
    """Read and check. Raises as `read_calibration`, or UnitError."""
    file = _File(Path(path), BIAS)
    values = file.numbers("values", (None,))
    if len(values) % 3:
        raise file.wrong(ChannelError, f"{len(values)} values, no multiple of three")
    unit = file.word("unit")
    if unit not in UNITS:
        raise file.wrong(UnitError, f"unit {unit!r} is not one of {', '.join(UNITS)}")
    spread = file.numbers("spread", (len(values),))
    flags = file.flags("reversed", len(values) // 3)
    return Bias(values, spread, file.count("n"), UNITS[UNITS.index(unit)], flags)


class _File:
    """A JSON object of ours, opened and of the right format and kind; its values are checked as
    they are taken."""

    def __init__(self, path: Path, kind: str) -> None:
        self._path, self._kind = path, kind
        content = self._content()
        if not isinstance(content, dict):
            raise self.wrong(DataError, "not a JSON object")
        self._values: dict[str, Any] = content
        if self.value("format") != FORMAT or isinstance(self.value("format"), bool):
            raise self.wrong(
                DataError, f"format {self.value('format')!r} is not known, only {FORMAT}"
            )
        if self.value("kind") != kind:
            raise self.wrong(DataError, f"this is a {self.value('kind')!r}, not a {kind}")

    def wrong(self, error: type[DataError], what: str) -> DataError:
        """The error, with where and the next step."""
        return error(
            what,
            where=self._path,
            cause="written by hand or by something else",
            next_step=NEXT[self._kind],
        )

    def value(self, name: str) -> Any:
        """A value; DataError where it is missing."""
        if name not in self._values:
            raise self.wrong(DataError, f"{name!r} is missing")
        return self._values[name]

    def word(self, name: str) -> str:
        """A text."""
        value = self.value(name)
        if not isinstance(value, str):
            raise self.wrong(DataError, f"{name} is {value!r}, not a text")
        return value

    def count(self, name: str) -> int:
        """A whole number from 0."""
        value = self.value(name)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise self.wrong(NotANumber, f"{name} is {value!r}, not a whole number from 0")
        return value

    def flags(self, name: str, n: int) -> BoolArray:
        """[n] of true and false."""
        value = self.value(name)
        if (
            not isinstance(value, list)
            or len(value) != n
            or not all(isinstance(one, bool) for one in value)
        ):
            raise self.wrong(ChannelError, f"{name} is not {n} times true or false")
        return np.array(value, dtype=np.bool_)

    def numbers(
        self, name: str, shape: tuple[int | None, ...], *, gaps: bool = False
    ) -> FloatArray:
        """Finite numbers of a shape, None for any length from 1; with gaps, null stands for nan."""
        leaves: list[Any] = []
        found = _shape(self.value(name), leaves)
        if not _fits(found, shape):
            wanted = ["S" if one is None else one for one in shape]
            told = "no rectangle" if found is None else list(found)
            raise self.wrong(
                ChannelError, f"{name} has shape {told}, not {wanted}".replace("'", "")
            )
        return np.array([self._number(name, leaf, gaps) for leaf in leaves]).reshape(found or ())

    def _number(self, name: str, leaf: object, gaps: bool) -> float:
        if leaf is None and gaps:
            return float("nan")
        if isinstance(leaf, bool) or not isinstance(leaf, int | float):
            raise self.wrong(NotANumber, f"{name} holds {leaf!r}, which is no number")
        if not abs(leaf) <= sys.float_info.max:
            raise self.wrong(NotANumber, f"{name} holds {leaf!r}, which is not finite")
        return float(leaf)

    def _content(self) -> Any:
        try:
            require_file(self._path)
            return json_of(text_of(self._path))
        except FileNotFoundError:
            raise DataNotFound(
                "no such file", where=self._path, next_step=NEXT[self._kind]
            ) from None
        except OSError as error:
            raise DataNotFound(
                f"cannot be read ({error.strerror})", where=self._path, next_step="check it"
            ) from None
        except ValueError:
            raise self.wrong(DataError, "not JSON") from None


def _fits(found: tuple[int, ...] | None, shape: tuple[int | None, ...]) -> bool:
    same_depth = found is not None and len(found) == len(shape)
    return same_depth and all(
        wanted in (None, size) for wanted, size in zip(shape, found or (), strict=True)
    )


def _shape(value: object, leaves: list[Any]) -> tuple[int, ...] | None:
    """Shape of nested lists, their leaves collected; None where they are ragged or empty."""
    if not isinstance(value, list):
        leaves.append(value)
        return ()
    inner = {_shape(one, leaves) for one in value}
    only = inner.pop() if len(inner) == 1 else None
    return None if only is None else (len(value), *only)
