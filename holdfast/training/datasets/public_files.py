"""Checked reading of the two file kinds public data sets come in: npz archives and csv tables.

Every fault is a typed error that names the file and the place. Cells of a table are read by
Python's own `float`, because pandas rounds some decimals differently in the last bit.
"""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import FloatArray, IntArray
from holdfast.core.errors import (
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    listed,
)
from holdfast.training.recording import LabelledRows

Shape = tuple[int | None, ...]
Arrays = dict[str, npt.NDArray[Any]]
TrialRows = tuple[npt.NDArray[Any], npt.NDArray[Any]]
"""Last rows [m] of a trial's windows, and their labels [m]."""
UNLABELLED = -1
"""A row without a label, of no window."""
COPY_AGAIN = "copy the data set again from its source"


def read_arrays(path: Path, shapes: Mapping[str, Shape]) -> Arrays:
    """The named arrays of an npz archive; a None in a shape stands for any length.

    Pickled objects are refused. Raises DataNotFound, ColumnError (missing array or shape) or
    NotANumber.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            missing = sorted(set(shapes) - set(archive.files))
            if missing:
                raise ColumnError(
                    f"arrays missing: {listed(missing)}",
                    where=path,
                    next_step=COPY_AGAIN,
                )
            arrays = {name: archive[name] for name in shapes}
    except FileNotFoundError:
        raise DataNotFound("no such file", where=path, next_step=COPY_AGAIN) from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise NotANumber(
            f"cannot be read as an npz archive of numbers ({type(error).__name__})",
            where=path,
            cause="a copy cut short, or pickled objects, which are never read",
            next_step=COPY_AGAIN,
        ) from None

    for name, shape in shapes.items():
        _check_array(arrays[name], name, shape, path)
    return arrays


def _check_array(array: npt.NDArray[Any], name: str, shape: Shape, path: Path) -> None:
    """Raise NotANumber for an array of anything else, ColumnError for another shape."""
    if array.dtype.kind not in "iuf":
        raise NotANumber(
            f"array {name} holds {array.dtype}, not numbers",
            where=path,
            next_step=COPY_AGAIN,
        )

    fits = array.ndim == len(shape)
    if fits:
        for wanted, length in zip(shape, array.shape, strict=True):
            fits = fits and wanted in (None, length)
    if not fits:
        expected = " x ".join("any" if n is None else str(n) for n in shape)
        found = " x ".join(map(str, array.shape))
        raise ColumnError(
            f"array {name} is {found}, not {expected}", where=path, next_step=COPY_AGAIN
        )


@dataclass(frozen=True)
class Table:
    """A csv table of text cells: columns by name; the header is line 1."""

    path: Path
    columns: dict[str, list[str]]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def text(self, name: str) -> list[str]:
        """One column as it stands. Raises ColumnError where it is missing."""
        self.require([name])
        return self.columns[name]

    def require(self, names: Sequence[str]) -> None:
        """Raise ColumnError unless all these columns are there."""
        missing = [name for name in names if name not in self.columns]
        if missing:
            raise ColumnError(
                f"columns missing: {listed(missing)}",
                where=self.path,
                next_step=COPY_AGAIN,
            )

    def numbers(self, name: str, *, finite: bool = True) -> FloatArray:
        """One column as float64. Raises ColumnError, or NotANumber (of nan too, if `finite`)."""
        cells = self.text(name)
        values = np.empty(len(cells))
        for k, cell in enumerate(cells):
            value = _number(cell)
            if value is None or (finite and not np.isfinite(value)):
                raise NotANumber(
                    f"line {k + 2}, column {name}: {cell!r:.40} is no number",
                    where=self.path,
                    cause="text or an empty cell in the data",
                    next_step="correct or remove that line",
                )
            values[k] = value
        return values

    def whole_numbers(self, name: str) -> IntArray:
        """One column of whole numbers, also where they are written as 12.0."""
        values = self.numbers(name)
        broken = np.flatnonzero(values != np.round(values))
        if broken.size:
            raise NotANumber(
                f"line {broken[0] + 2}, column {name}: not a whole number",
                where=self.path,
                next_step="correct that line",
            )
        return values.astype(np.int64)


def read_table(path: Path) -> Table:
    """A csv file with a header. Raises DataNotFound, NotANumber, EmptyRecording or ColumnError."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as lines:
            rows = [row for row in csv.reader(lines) if row]
    except FileNotFoundError:
        raise DataNotFound("no such file", where=path, next_step=COPY_AGAIN) from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise NotANumber(
            f"cannot be read as a csv text file ({type(error).__name__})",
            where=path,
            next_step=COPY_AGAIN,
        ) from None
    if len(rows) < 2:
        raise EmptyRecording(
            "no rows of data",
            where=path,
            cause="a copy cut short",
            next_step=COPY_AGAIN,
        )

    # Every row is checked against the header: a short row would shift the columns behind the gap.
    names = [name.strip() for name in rows[0]]
    fault = "a column occurs twice" if len(set(names)) < len(names) else ""
    for number, row in enumerate(rows, 1):
        if len(row) != len(names):
            fault = f"line {number} has another number of cells"
            break
    if fault:
        raise ColumnError(
            fault, where=path, cause="a copy cut short", next_step=COPY_AGAIN
        )

    columns = {}
    for k, name in enumerate(names):
        columns[name] = [row[k].strip() for row in rows[1:]]
    return Table(path, columns)


def _number(cell: str) -> float | None:
    """The number in a cell, or None."""
    try:
        # Python reads 1_000 as a number; a data set means something else by it.
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def channels_of(sensors: Sequence[int]) -> list[int]:
    """The columns of 3-axis sensors, counted from 0, in a table of all sensors' channels."""
    return [3 * sensor + axis for sensor in sensors for axis in range(3)]


def join_trials(parts: Sequence[TrialRows], classes: tuple[str, ...]) -> LabelledRows:
    """One task from the windows of all trials, part k belonging to recording k."""
    labelled = []
    for number, (row, label) in enumerate(parts):
        trial = np.full(len(row), number, dtype=np.int64)
        labelled.append(LabelledRows(trial, row, label, classes))
    return LabelledRows.concatenated(labelled)
