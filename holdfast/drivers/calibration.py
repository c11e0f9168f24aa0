"""What an unloaded hand reads (its bias), and from field to force (its calibration), with files.

A calibration is one matrix [3, 3] in N/uT for each sensor. Where several sensors lie under one load
(a pad, or six fingertips pressed in turn), each sensor gives its share, and the load is the sum of
the shares. `holdfast calibrate` fits the matrices. Files are JSON, written with every digit and
checked value by value.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    NORMAL_FLOOR,
    UNITS,
    BoolArray,
    FloatArray,
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
from holdfast.core.schema import json_of, text_of
from holdfast.core.writing import write_whole

MIN_BIAS_ROWS = 30
LOST_SHARE = 0.05
"""Of the rows of a channel, more lost than this is a finger's wires; less is a moment's bus."""
QUIET: dict[Unit, float] = {"N": 0.12, "uT": 40.0}
"""The noise of an untouched channel stays below this.

The TMAG5273's noise is 22 uT in x and y, and 11 uT in z.
"""


@dataclass(frozen=True)
class Bias:
    """What an unloaded hand reads: values [C] median, spread [C] standard deviation, over n rows.

    reversed [S]: whose magnet is upside down. The values are as read: a reversed magnet is
    reported, not corrected.
    """

    values: FloatArray
    spread: FloatArray
    n: int
    unit: Unit
    reversed: BoolArray


def bias_of(values: FloatArray, unit: Unit) -> tuple[Bias, tuple[str, ...]]:
    """The bias of unloaded rows [T, C], and warnings that name the channels.

    Warnings are about lost rows (more than LOST_SHARE), noise or drift (from the first to the last
    third) above QUIET, and reversed magnets, whose resting normal is below minus NORMAL_FLOOR.
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
    if values.ndim != 2 or not values.shape[1] or values.shape[1] % 3:
        raise ChannelError(
            f"rows of shape {list(values.shape)}",
            next_step="give [T, C] with three channels a sensor",
        )
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
            upside_down,
            "the magnet is reversed (normal field below zero at rest) in {}; "
            "next: turn the magnet or its sign",
        ),
    )
    return tuple(text.format(_named(which)) for which, text in found if which.any())


def _middle(rows: FloatArray) -> FloatArray:
    """[C] median of the finite rows; nan without any (np.nanmedian would warn)."""
    middle = np.full(rows.shape[1], np.nan)
    for k, column in enumerate(rows.T):
        finite = column[np.isfinite(column)]
        if finite.size:
            middle[k] = np.median(finite)
    return middle


def _named(which: BoolArray) -> str:
    names = channel_names(len(which) // 3)
    return ", ".join(names[index] for index in np.flatnonzero(which))


@dataclass(frozen=True)
class CalibrationOrigin:
    """Where a calibration comes from.

    source: of the loads. date: as the caller gave it. load_unit: the unit in which the loads were
    read. n: rows fitted. residual_n: [S, 3] RMSE over the fitted rows, nan where an axis was never
    loaded; sensors under one load share the residual of that load.
    """

    source: str
    date: str
    load_unit: str
    n: int
    residual_n: FloatArray


@dataclass(frozen=True)
class Calibration:
    """matrix [S, 3, 3] N/uT; rest_ut [S, 3] the resting field, None where fields come tared.

    reversed [S]: whose magnet is upside down. A row of zeros in a matrix is an axis that was never
    loaded. The matrix is that of an upright magnet. A reversed magnet has the field of the other
    sign on all three axes, and `apply` turns it. shear_gain: ratio of shear and normal force as it
    is read at a light touch, over the true one; None where no load has shown it.
    """

    matrix: FloatArray
    rest_ut: FloatArray | None
    reversed: BoolArray
    meta: CalibrationOrigin
    shear_gain: float | None = None

    def apply(self, field_ut: FloatArray) -> FloatArray:
        """[.., S, 3] uT -> [.., S, 3] N; a nan makes its whole sensor nan. Raises ChannelError."""
        if field_ut.shape[-2:] != self.matrix.shape[:2]:
            raise ChannelError(
                f"a field of shape {list(field_ut.shape)} for {len(self.matrix)} sensors",
                cause="the calibration is of another hand",
                next_step=f"use fields [.., {len(self.matrix)}, 3], or calibrate this hand",
            )
        moved = field_ut if self.rest_ut is None else field_ut - self.rest_ut
        force: FloatArray = np.einsum(
            "sij,...sj->...si", self.matrix, turn(self.reversed) * moved
        )
        return force


def turn(reversed_: BoolArray) -> FloatArray:
    """[S, 1] the sign that turns a reversed magnet's field."""
    return np.where(reversed_, -1.0, 1.0)[:, None]


def rmse_normal(error_n: FloatArray) -> float:
    """Root mean square of [.., 3] errors along the normal."""
    return float(np.sqrt(np.mean(error_n[..., NORMAL_AXIS] ** 2)))


def rmse_shear(error_n: FloatArray) -> float:
    """Root mean square of [.., 3] errors over the loaded shear axes (not nan); nan without any."""
    shear = np.delete(error_n, NORMAL_AXIS, axis=-1)
    known = shear[np.isfinite(shear)]
    return float(np.sqrt(np.mean(known**2))) if known.size else float("nan")


FORMAT = 1
CALIBRATION = "calibration"
BIAS = "bias"
GAINS = (0.1, 10.0)
"""A shear gain beyond these is a mistake, not a sensor."""
NEXT = {
    CALIBRATION: "write it again with holdfast calibrate PATH --out FILE",
    BIAS: "take the bias again (holdfast bias), with nothing touching the hand",
}


def write_calibration(path: str | Path, calibration: Calibration) -> Path:
    """As JSON with all digits; OutputError where that cannot be done."""
    meta = calibration.meta
    rest = calibration.rest_ut
    content = {
        "format": FORMAT,
        "kind": CALIBRATION,
        "matrix_n_per_ut": calibration.matrix.tolist(),
        "rest_ut": None if rest is None else rest.tolist(),
        "reversed": calibration.reversed.tolist(),
        "shear_gain": calibration.shear_gain,
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
    """Read and check a calibration. Raises DataNotFound, DataError, ChannelError, NotANumber.

    DataError: not JSON, another format, or a singular matrix. With a singular matrix two loaded
    axes become one, or no field is a force, and the finger would always read zero.
    """
    file = _File(Path(path), CALIBRATION)
    matrix = file.numbers("matrix_n_per_ut", (None, 3, 3))
    n_sensors = len(matrix)
    for number, one in enumerate(matrix, 1):
        if _is_singular(one):
            what = f"matrix_n_per_ut of sensor {number} is singular"
            raise file.wrong(DataError, what)

    rest = None
    if file.value("rest_ut") is not None:
        rest = file.numbers("rest_ut", (n_sensors, 3))
    meta = CalibrationOrigin(
        source=file.word("source"),
        date=file.word("date"),
        load_unit=file.word("load_unit"),
        n=file.count("n"),
        residual_n=file.numbers("residual_n", (n_sensors, 3), gaps=True),
    )
    reversed_ = file.flags("reversed", n_sensors)
    return Calibration(matrix, rest, reversed_, meta, _gain_in(file))


def _gain_in(file: _File) -> float | None:
    """The shear gain; None in files that are older than it. Raises DataError."""
    gain = file.value("shear_gain") if file.has("shear_gain") else None
    if gain is None:
        return None
    low, high = GAINS
    if type(gain) not in (int, float) or not low <= gain <= high:
        what = f"shear_gain {gain!r:.40} is not a number from {low:g} to {high:g}"
        raise file.wrong(DataError, what)
    return float(gain)


def _is_singular(matrix: FloatArray) -> bool:
    """Whether the rows of the loaded axes (not all zero) do not span as many directions."""
    # scaled row by row: a calibration in small numbers is not singular
    largest = np.abs(matrix).max(axis=1)
    rows = matrix[largest != 0.0] / largest[largest != 0.0, None]
    return not len(rows) or int(np.linalg.matrix_rank(rows)) < len(rows)


def write_bias(path: str | Path, bias: Bias) -> Path:
    """As JSON with all digits; OutputError where that cannot be done."""
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
    """Read and check a bias. Raises what `read_calibration` raises, or UnitError."""
    file = _File(Path(path), BIAS)
    values = file.numbers("values", (None,))
    if len(values) % 3:
        raise file.wrong(ChannelError, f"{len(values)} values, not a multiple of three")
    unit = file.word("unit")
    if unit not in UNITS:
        raise file.wrong(UnitError, f"unit {unit!r} is not one of {', '.join(UNITS)}")
    return Bias(
        values=values,
        spread=file.numbers("spread", (len(values),)),
        n=file.count("n"),
        unit=UNITS[UNITS.index(unit)],
        reversed=file.flags("reversed", len(values) // 3),
    )


class _File:
    """A JSON object of the right format and kind; its values are checked when they are read."""

    def __init__(self, path: Path, kind: str) -> None:
        self._path = path
        self._kind = kind
        content = self._content()
        if not isinstance(content, dict):
            raise self.wrong(DataError, "not a JSON object")
        self._values: dict[str, Any] = content
        if self.value("format") != FORMAT or isinstance(self.value("format"), bool):
            raise self.wrong(
                DataError,
                f"format {self.value('format')!r} is not known, only {FORMAT}",
            )
        if self.value("kind") != kind:
            raise self.wrong(
                DataError, f"this is a {self.value('kind')!r}, not a {kind}"
            )

    def wrong(self, error: type[DataError], what: str) -> DataError:
        """The error, with its place and the next step."""
        return error(
            what,
            where=self._path,
            cause="it was written by hand or by another program",
            next_step=NEXT[self._kind],
        )

    def has(self, name: str) -> bool:
        """Whether it has a value of this name."""
        return name in self._values

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
            raise self.wrong(
                NotANumber, f"{name} is {value!r}, not a whole number from 0"
            )
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
        found = np.array(self.value(name), dtype=object)
        # numpy keeps lists of unequal length as leaves
        leaves = list(found.flat)
        ragged = not leaves or any(isinstance(leaf, list) for leaf in leaves)
        fits = not ragged and found.ndim == len(shape)
        for size, wanted in zip(found.shape, shape, strict=False):
            fits = fits and wanted in (None, size)

        if not fits:
            letters = ["S" if one is None else str(one) for one in shape]
            shown = "not rectangular" if ragged else list(found.shape)
            what = f"{name} has shape {shown}, not [{', '.join(letters)}]"
            raise self.wrong(ChannelError, what)

        numbers = [self._number(name, leaf, gaps) for leaf in leaves]
        return np.array(numbers).reshape(found.shape)

    def _number(self, name: str, leaf: object, gaps: bool) -> float:
        if leaf is None and gaps:
            return float("nan")
        # True is an int in Python, and no number in a file
        if isinstance(leaf, bool) or not isinstance(leaf, int | float):
            raise self.wrong(
                NotANumber, f"{name} holds {leaf!r}, which is not a number"
            )
        # also refuses nan, for which every comparison is false
        if not abs(leaf) <= sys.float_info.max:
            raise self.wrong(NotANumber, f"{name} holds {leaf!r}, which is not finite")
        return float(leaf)

    def _content(self) -> Any:
        try:
            return json_of(text_of(self._path))
        except FileNotFoundError:
            raise DataNotFound(
                "no such file", where=self._path, next_step=NEXT[self._kind]
            ) from None
        except OSError as error:
            raise DataNotFound(
                f"cannot be read ({error.strerror})",
                where=self._path,
                next_step="check the path and its permissions",
            ) from None
        except ValueError as error:
            raise self.wrong(DataError, f"not JSON: {error}") from None
