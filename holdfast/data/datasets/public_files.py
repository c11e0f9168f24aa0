"""What the readers of public sets share: archives, channels, windows of all trials.

numpy and pandas read the files; their errors become typed ones in `copied_whole`.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import ColumnError, DataNotFound, NotANumber, one_line
from holdfast.data.datasets.thesis import SetMeta
from holdfast.data.recording import LabelledRows
from holdfast.edge_runtime.preparation import Preparation

TrialRows = tuple[npt.NDArray[Any], npt.NDArray[Any]]
"""Last rows [m] of a trial's windows, and their labels [m]."""
UNLABELLED = -1
"""A row without a label, of no window."""
COPY_AGAIN = "copy the data set again from its source"


def read_arrays(path: Path, *names: str) -> list[npt.NDArray[Any]]:
    """The named arrays of an npz archive; pickled objects are refused."""
    # np.load leaves a file open that it cannot read, so the file is opened here
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return [archive[name] for name in names]


@dataclass(frozen=True)
class PublicSet:
    """What a reader says of its set. meta: name, unit and kind, and a caveat for its figures.

    channels: the numbers of channels that it offers, the usual one first. hand: its hand card by
    name, "" without one. preparation: of its samples, "" for a licence or source that is not known.
    """

    meta: SetMeta
    channels: tuple[int, ...]
    preparation: Preparation
    hand: str = ""
    licence: str = ""
    source: str = ""


@contextmanager
def copied_whole(root: Path) -> Iterator[None]:
    """Around the reading of a set. Raises DataNotFound, ColumnError or NotANumber."""
    try:
        yield
    except FileNotFoundError as error:
        missing = error.filename or root
        raise DataNotFound(
            "no such file", where=missing, next_step=COPY_AGAIN
        ) from None
    except KeyError as error:
        what = f"missing: {one_line(str(error))}"
        raise ColumnError(what, where=root, next_step=COPY_AGAIN) from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise NotANumber(
            f"cannot be read as numbers: {one_line(str(error)):.120}",
            where=root,
            cause="a copy cut short, or pickled objects, which are never read",
            next_step=COPY_AGAIN,
        ) from None


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
