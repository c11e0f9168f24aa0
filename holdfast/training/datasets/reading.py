"""Checked reading of the two file kinds public data sets come in: npz archives and csv tables.

Nothing here knows a data set; every fault is a typed error that names the file and the place.

How many channels of a set are used, where more than one number is possible.

The last step of every reader: the windows of single trials become one task.

Trials that are found but not yet read, so that a check can go on after a fault.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.archives import NOT_AN_ARCHIVE, require_modest_archive
from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import (
    ChannelError,
    ColumnError,
    DataError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    listed,
)
from holdfast.core.reading import require_lines
from holdfast.training.datasets.places import Fault, TrialPlace, refuse
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import LabelledRows
from holdfast.training.windows import TimedTrial

Shape = tuple[int | None, ...]
COPY_AGAIN = "copy the data set again from its source"


def read_arrays(path: Path, shapes: Mapping[str, Shape]) -> dict[str, npt.NDArray[Any]]:
    """The named arrays of an npz archive; a None in a shape stands for any length.

    Pickled objects are refused. Raises DataNotFound, ColumnError (missing array or shape) or
    NotANumber.
    """
    try:
        require_modest_archive(path)
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
    except NOT_AN_ARCHIVE as error:
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
    if array.dtype.kind not in "iuf":
        raise NotANumber(
            f"array {name} holds {array.dtype}, not numbers",
            where=path,
            next_step=COPY_AGAIN,
        )
    if array.ndim != len(shape) or any(
        want not in (None, got) for want, got in zip(shape, array.shape, strict=True)
    ):
        wanted = " x ".join("any" if want is None else str(want) for want in shape)
        got = " x ".join(map(str, array.shape))
        raise ColumnError(
            f"array {name} is {got}, not {wanted}", where=path, next_step=COPY_AGAIN
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
        values = np.array([_number(cell) for cell in cells], dtype=object)
        bad = [
            k
            for k, value in enumerate(values)
            if value is None or (finite and not np.isfinite(value))
        ]
        if bad:
            raise NotANumber(
                f"line {bad[0] + 2}, column {name}: {cells[bad[0]]!r:.40} is no number",
                where=self.path,
                cause="text or an empty cell in the data",
                next_step="correct or remove that line",
            )
        return values.astype(np.float64)

    def whole_numbers(self, name: str) -> npt.NDArray[np.int64]:
        """One column of whole numbers, also where they are written as 12.0."""
        values = self.numbers(name)
        if np.any(values != np.round(values)):
            line = int(np.flatnonzero(values != np.round(values))[0]) + 2
            raise NotANumber(
                f"line {line}, column {name}: not a whole number",
                where=self.path,
                next_step="correct that line",
            )
        return values.astype(np.int64)


def read_table(path: Path) -> Table:
    """A csv file with a header. Raises DataNotFound, NotANumber, EmptyRecording or ColumnError."""
    try:
        require_lines(path)
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
    header = [name.strip() for name in rows[0]]
    ragged = [k for k, row in enumerate(rows) if len(row) != len(header)]
    if ragged or len(set(header)) < len(header):
        what = (
            f"line {ragged[0] + 1} has another number of cells"
            if ragged
            else "a column occurs twice"
        )
        raise ColumnError(
            what, where=path, cause="a copy cut short", next_step=COPY_AGAIN
        )
    return Table(
        path,
        {name: [row[k].strip() for row in rows[1:]] for k, name in enumerate(header)},
    )


def _number(cell: str) -> float | None:
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


class ChannelsNotOffered(ChannelError):
    """A set cannot be read with that number of channels. offered: those that it has, in words."""

    def __init__(self, set_name: str, channels: int, offered: Iterable[int]) -> None:
        self.offered = " or ".join(map(str, sorted(offered)))
        super().__init__(
            f"{set_name} has no {channels}-channel case",
            next_step=f"ask for {self.offered}",
        )


TrialRows = tuple[npt.NDArray[Any], npt.NDArray[Any]]
"""Last rows [m] of a trial's windows, and their labels [m]."""


def join_trials(parts: Sequence[TrialRows], classes: tuple[str, ...]) -> LabelledRows:
    """One task from the windows of all trials, part k belonging to recording k."""
    trial = np.repeat(np.arange(len(parts)), [len(rows) for rows, _ in parts])
    row, label = (
        np.concatenate([part[k] for part in parts]).astype(np.int64) for k in (0, 1)
    )
    return LabelledRows(trial.astype(np.int64), row, label, classes)


def finite_sensors(raw: FloatArray) -> BoolArray:
    """[T, C] -> [T, C/3]: True where all three channels of a sensor are finite."""
    by_sensor = np.isfinite(raw).reshape(len(raw), -1, 3)
    return np.logical_and.reduce(by_sensor, axis=2)


@dataclass(frozen=True)
class TrialReader:
    """A trial's place, and the function that reads, prepares and labels it."""

    place: TrialPlace
    read: Callable[[], TimedTrial]


def read_all(
    readers: Sequence[TrialReader], fault: Fault = refuse, part: Part = ignored
) -> list[TimedTrial | None]:
    """The trials in their order, None for one that cannot be used.

    fault: receives its DataError. part: receives the share of the trials that is read.
    """
    trials = []
    for number, reader in enumerate(readers, 1):
        trials.append(_read(reader, fault))
        part(number / len(readers))
    return trials


def _read(reader: TrialReader, fault: Fault) -> TimedTrial | None:
    try:
        return reader.read()
    except DataError as error:
        fault(error)
        return None
