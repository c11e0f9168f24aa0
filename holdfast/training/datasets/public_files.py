"""The two kinds of file that public data sets come in: npz archives and csv tables.

numpy and pandas read them; here their errors become typed ones that name the file, and the arrays
and columns that a set needs are checked once.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import (
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    one_line,
)
from holdfast.training.datasets.trials import ChannelsNotOffered
from holdfast.training.recording import LabelledRows

if TYPE_CHECKING:
    import pandas as pd

Shape = tuple[int | None, ...]
TrialRows = tuple[npt.NDArray[Any], npt.NDArray[Any]]
"""Last rows [m] of a trial's windows, and their labels [m]."""
UNLABELLED = -1
"""A row without a label, of no window."""
COPY_AGAIN = "copy the data set again from its source"


def read_arrays(path: Path, shapes: Mapping[str, Shape]) -> dict[str, npt.NDArray[Any]]:
    """The named arrays of an npz archive; a None in a shape stands for any length.

    Pickled objects are refused. Raises DataNotFound, ColumnError (missing array or shape) or
    NotANumber.
    """
    # np.load leaves a file open that it cannot read, so the file is opened here
    with (
        _copied_whole(path),
        path.open("rb") as file,
        np.load(file, allow_pickle=False) as archive,
    ):
        arrays = {name: archive[name] for name in shapes}

    for name, shape in shapes.items():
        found = arrays[name].shape
        lengths = zip(found, shape, strict=False)
        if len(found) != len(shape) or any(m not in (n, None) for n, m in lengths):
            what = f"array {name} has the shape {found}, not {shape}"
            raise ColumnError(what, where=path, next_step=COPY_AGAIN)
    return arrays


def read_table(path: Path, columns: Mapping[str, type]) -> pd.DataFrame:
    """These columns of a csv file with a header, each of its type.

    Raises DataNotFound, ColumnError, NotANumber or EmptyRecording.
    """
    import pandas as pd  # a third of a second, which sets in other formats do not need

    with _copied_whole(path):
        # As texts, since pandas' own reader rounds some decimals differently in the last bit.
        texts = pd.read_csv(path, dtype=str)
        table = texts[list(columns)].astype(dict(columns))
    if table.empty:
        what = "no rows of data"
        raise EmptyRecording(what, where=path, next_step=COPY_AGAIN)
    return table


@contextmanager
def _copied_whole(path: Path) -> Iterator[None]:
    """Around the reading of a file of a set. Raises DataNotFound, ColumnError or NotANumber."""
    try:
        yield
    except FileNotFoundError:
        raise DataNotFound("no such file", where=path, next_step=COPY_AGAIN) from None
    except KeyError as error:
        what = f"missing: {one_line(str(error))}"
        raise ColumnError(what, where=path, next_step=COPY_AGAIN) from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise NotANumber(
            f"cannot be read as numbers: {one_line(str(error)):.120}",
            where=path,
            cause="a copy cut short, or pickled objects, which are never read",
            next_step=COPY_AGAIN,
        ) from None


def channels_of(sensors: Sequence[int]) -> list[int]:
    """The columns of 3-axis sensors, counted from 0, in a table of all sensors' channels."""
    return [3 * sensor + axis for sensor in sensors for axis in range(3)]


def offered_channels(
    name: str, channels: int, offered: Mapping[int, Sequence[int]]
) -> list[int]:
    """The columns for so many channels; offered: channels -> sensors. Raises ChannelsNotOffered."""
    if channels not in offered:
        raise ChannelsNotOffered(name, channels, offered)
    return channels_of(offered[channels])


def join_trials(parts: Sequence[TrialRows], classes: tuple[str, ...]) -> LabelledRows:
    """One task from the windows of all trials, part k belonging to recording k."""
    labelled = []
    for number, (row, label) in enumerate(parts):
        trial = np.full(len(row), number, dtype=np.int64)
        labelled.append(LabelledRows(trial, row, label, classes))
    return LabelledRows.concatenated(labelled)
