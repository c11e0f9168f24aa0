"""What an unloaded hand reads (its bias), and from field to force (its calibration), with files.

A calibration is one matrix [3, 3] in N/uT for each sensor. Where several sensors lie under one load
(a pad, or six fingertips pressed in turn), each sensor gives its share, and the load is the sum of
the shares. `holdfast calibrate` fits the matrices. Files are JSON, written with every digit.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    NORMAL_FLOOR,
    BoolArray,
    FloatArray,
    Json,
    Unit,
    channel_names,
)
from holdfast.core.errors import (
    ChannelError,
    DataError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    UnitError,
)
from holdfast.core.schema import read
from holdfast.core.writing import write_whole

TINY = np.finfo(np.float64).tiny
MIN_BIAS_ROWS = 30
LOST_SHARE = 0.05
"""Of the rows of a channel, more lost than this is a finger's wires; less is a moment's bus."""
QUIET: dict[Unit, float] = {"N": 0.12, "uT": 40.0}
"""The noise of an untouched channel stays below this.

The TMAG5273's noise is 22 uT in x and y, and 11 uT in z.
"""
LARGEST: dict[Unit, float] = {"N": 500.0, "uT": 3e5, "count": 2.0**31}
"""No unloaded channel reads more. The TMAG5273's widest range is 266 mT."""


@dataclass(frozen=True)
class Bias:
    """What an unloaded hand reads: values [C] median, spread [C] standard deviation, over n rows.

    reversed [S]: whose magnet is upside down. The values are as read: a reversed magnet is
    reported, not corrected. date: of the measurement, YYYY-MM-DD. calibration: the digest_of the
    file that made N of uT, "" without one. Both are None where a file does not say.
    """

    values: FloatArray
    spread: FloatArray
    n: int
    unit: Unit
    reversed: BoolArray
    date: str | None = None
    calibration: str | None = None


def bias_of(values: FloatArray, unit: Unit) -> tuple[Bias, tuple[str, ...]]:
    """The bias of unloaded rows [T, C], and warnings that name the channels.

    Warnings are about lost rows (more than LOST_SHARE), noise or drift (from the first to the last
    third) above QUIET, readings above LARGEST, and reversed magnets, whose resting normal is below
    minus NORMAL_FLOOR.
    Raises EmptyRecording, NotANumber (a channel without MIN_BIAS_ROWS finite rows), ChannelError,
    UnitError.
    """
    if unit not in QUIET:
        raise UnitError(
            f"no noise limits for the unit {unit}",
            next_step="take the bias in N or in uT",
        )
    _check_bias_rows(values)
    # an infinite value is as lost as nan, and nanmedian knows nan only
    masked = np.where(np.isfinite(values), values, np.nan)
    middle = np.nanmedian(masked, axis=0)
    spread = np.nanstd(masked, axis=0)
    reversed_ = middle[NORMAL_AXIS::3] < -NORMAL_FLOOR[unit]
    bias = Bias(middle, spread, len(values), unit, reversed_)
    return bias, _bias_warnings(masked, bias)


def _check_bias_rows(values: FloatArray) -> None:
    if len(values) < MIN_BIAS_ROWS:
        raise EmptyRecording(
            f"{len(values)} rows for a bias",
            cause="the stream stopped early",
            next_step=f"leave the hand untouched for at least {MIN_BIAS_ROWS} rows",
        )
    few = np.isfinite(values).sum(axis=0) < MIN_BIAS_ROWS
    if few.any():
        raise NotANumber(
            f"fewer than {MIN_BIAS_ROWS} finite rows in {_named(few)}",
            cause="a finger that does not answer",
            next_step="holdfast doctor shows which fingers answer; or take more rows",
        )


def _bias_warnings(masked: FloatArray, bias: Bias) -> tuple[str, ...]:
    # a drift shows between the ends, not between neighbouring rows
    third = len(masked) // 3
    lost = np.isnan(masked).sum(axis=0)
    drift = np.abs(_middle(masked[-third:]) - _middle(masked[:third]))
    upside_down = np.zeros(len(bias.values), dtype=np.bool_)
    upside_down[NORMAL_AXIS::3] = bias.reversed
    quiet = QUIET[bias.unit]
    limit = f"{quiet:g} {bias.unit}"
    found = (
        (
            lost > LOST_SHARE * len(masked),
            f"up to {lost.max()} of {len(masked)} rows are lost in {{}}; "
            "next: check that finger's wires",
        ),
        (
            bias.spread > quiet,
            f"noise above {limit}: {{}}; likely cause: the hand was touched; "
            "next: take the bias again",
        ),
        (
            drift > quiet,
            f"drifts by more than {limit}: {{}}; likely cause: it warms up, or a load creeps; "
            "next: wait a minute and take the bias again",
        ),
        (
            np.abs(bias.values) > LARGEST[bias.unit],
            f"reads more than {LARGEST[bias.unit]:g} {bias.unit} at rest: {{}}; likely cause: "
            "another unit or calibration; next: correct it",
        ),
        (
            upside_down,
            "the magnet is reversed (normal field below zero at rest) in {}; "
            "next: turn the magnet or its sign",
        ),
    )
    return tuple(text.format(_named(which)) for which, text in found if which.any())


def _middle(rows: FloatArray) -> FloatArray:
    """[C] median of the finite rows; nan without any."""
    with warnings.catch_warnings():
        # numpy warns of a channel without any
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmedian(rows, axis=0)


def _named(which: BoolArray) -> str:
    names = channel_names(len(which) // 3)
    return ", ".join(names[index] for index in np.flatnonzero(which))


@dataclass(frozen=True)
class Calibration:
    """matrix_n_per_ut [S, 3, 3]; rest_ut [S, 3] the resting field; where they come from.

    reversed [S]: whose magnet is upside down. The matrix is that of an upright magnet. A reversed
    magnet has the field of the other sign on all three axes, and `apply` turns it. shear_gain:
    ratio of shear and normal force as it is read at a light touch, over the true one; None where no
    load has shown it.

    source: of the loads. date: as the caller gave it. load_unit: the unit in which the loads were
    read. n: rows fitted. residual_n: [S, 3] RMSE over the fitted rows; sensors under one load share
    the residual of that load.
    """

    matrix_n_per_ut: FloatArray
    rest_ut: FloatArray
    reversed: BoolArray
    source: str
    date: str
    load_unit: str
    n: int
    residual_n: FloatArray
    shear_gain: float | None = None

    def apply(self, field_ut: FloatArray) -> FloatArray:
        """[.., S, 3] uT -> [.., S, 3] N; a nan makes its whole sensor nan. Raises ChannelError."""
        n_sensors = len(self.matrix_n_per_ut)
        if field_ut.shape[-2:] != (n_sensors, 3):
            raise ChannelError(
                f"a field of shape {list(field_ut.shape)} for {n_sensors} sensors",
                cause="the calibration is of another hand",
                next_step=f"use fields [.., {n_sensors}, 3], or calibrate this hand",
            )
        moved = turn(self.reversed) * (field_ut - self.rest_ut)
        force: FloatArray = np.einsum("sij,...sj->...si", self.matrix_n_per_ut, moved)
        return force


def turn(reversed_: BoolArray) -> FloatArray:
    """[S, 1] the sign that turns a reversed magnet's field."""
    return np.where(reversed_, -1.0, 1.0)[:, None]


# -- files

Vector = tuple[float, float, float]


class CalibrationFile(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """A calibration as its file has it: its fields, lists in place of arrays."""

    format: Literal[1]
    kind: Literal["calibration"]
    matrix_n_per_ut: Annotated[
        list[tuple[Vector, Vector, Vector]], msgspec.Meta(min_length=1)
    ]
    rest_ut: list[Vector]
    reversed: list[bool]
    # one beyond these bounds is a mistake, not a sensor
    shear_gain: Annotated[float, msgspec.Meta(ge=0.1, le=10.0)] | None = None
    source: str
    date: str
    load_unit: str
    n: Annotated[int, msgspec.Meta(ge=0)]
    residual_n: list[Vector]

    def __post_init__(self) -> None:
        """Raise ValueError where sensors differ in number or a matrix is singular."""
        n_sensors = len(self.matrix_n_per_ut)
        for name in ("rest_ut", "reversed", "residual_n"):
            rows = getattr(self, name)
            if len(rows) != n_sensors:
                raise ValueError(f"{name} has {len(rows)}; allowed: {n_sensors} rows")
        for number, matrix in enumerate(self.matrix_n_per_ut, 1):
            if _is_singular(np.array(matrix)):
                raise ValueError(
                    f"matrix_n_per_ut of sensor {number} is singular; "
                    "allowed: loads in three directions (holdfast calibrate)"
                )


def _is_singular(matrix: FloatArray) -> bool:
    """Whether two loaded axes would become one, or no field would be a force."""
    # scaled row by row: a calibration in small numbers is not singular
    largest = np.maximum(np.abs(matrix).max(axis=1, keepdims=True), TINY)
    return int(np.linalg.matrix_rank(matrix / largest)) < 3


def write_calibration(path: str | Path, calibration: Calibration) -> Path:
    """As JSON with all digits; OutputError where that cannot be done."""
    return _write(path, "calibration", calibration)


def digest_of(path: str | Path) -> str:
    """What tells a calibration file from others. Raises OSError."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]


def read_calibration(path: str | Path) -> Calibration:
    """Read and check a calibration. Raises DataNotFound, DataError."""
    file = _read(Path(path), CalibrationFile, "write one with holdfast calibrate")
    return Calibration(**file)


class BiasFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A bias as its file has it: its fields, lists in place of arrays."""

    format: Literal[1]
    kind: Literal["bias"]
    values: Annotated[list[float], msgspec.Meta(min_length=3)]
    spread: list[float]
    n: Annotated[int, msgspec.Meta(ge=1)]
    unit: Unit
    reversed: list[bool]
    # files of older versions say neither
    date: str | None = None
    calibration: str | None = None

    def __post_init__(self) -> None:
        """Raise ValueError where lists are not of the same sensors, or no sensor reads a value."""
        n_channels = 3 * len(self.reversed)
        if not len(self.values) == len(self.spread) == n_channels:
            raise ValueError(
                f"{len(self.values)} values, {len(self.spread)} in spread, and "
                f"{len(self.reversed)} in reversed; allowed: three values a sensor"
            )
        largest = LARGEST[self.unit]
        if max(map(abs, self.values)) > largest or max(self.spread) > largest:
            raise ValueError(
                f"values or spread beyond {largest:g} {self.unit}; allowed: what an unloaded hand "
                "reads (holdfast bias)"
            )
        if min(self.spread) < 0.0:
            raise ValueError("spread below 0; allowed: from 0")


def fields_of(content: Bias | Calibration) -> Json:
    """Its fields with all digits, arrays as lists."""
    fields: Json = msgspec.to_builtins(content, enc_hook=np.ndarray.tolist)
    return fields


def write_bias(path: str | Path, bias: Bias) -> Path:
    """As JSON; OutputError where that cannot be done."""
    return _write(path, "bias", bias)


def read_bias(path: str | Path) -> Bias:
    """Read and check a bias. Raises DataNotFound, DataError."""
    return Bias(**_read(Path(path), BiasFile, "take one with holdfast bias"))


def _write(path: str | Path, kind: str, content: Bias | Calibration) -> Path:
    file = {"format": 1, "kind": kind, **fields_of(content)}
    return write_whole(path, json.dumps(file, indent=1, allow_nan=False) + "\n")


def _read(path: Path, kind: type[msgspec.Struct], next_step: str) -> Json:
    """The fields of a file, lists as arrays."""
    try:
        file = msgspec.structs.asdict(read(path, kind, DataError))
    except FileNotFoundError:
        raise DataNotFound("no such file", where=path, next_step=next_step) from None
    del file["format"], file["kind"]
    for name, value in file.items():
        if isinstance(value, list):
            file[name] = np.array(value)
    return file
