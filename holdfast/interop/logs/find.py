"""Which files of a folder are logs, and how each is read: the reader's library only for its files.

A bag of ROS 2 is a folder with metadata.yaml, a LeRobot set one with meta/info.json.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from holdfast.core.errors import DataError, DataNotFound
from holdfast.core.trial_layout import LOG_MARKS, LOG_SUFFIXES
from holdfast.interop.logs.layout import TableFormat
from holdfast.interop.logs.log import ForeignLog, Stream

BAG, LEROBOT = LOG_MARKS
TEXT, SHEET = (".csv", ".tsv", ".txt", ".dat"), (".xlsx", ".xlsm")
PROSE = (".txt", ".dat")
"""Endings that other files have too: such a file in a folder is a log if it is a table."""
FEWEST_ROWS = 3
MODULES = {
    ".parquet": "holdfast.interop.tables",
    ".mcap": "holdfast.interop.mcap_file",
    ".xdf": "holdfast.interop.xdf",
    ".xdfz": "holdfast.interop.xdf",
    BAG: "holdfast.interop.ros2",
    LEROBOT: "holdfast.interop.lerobot",
}
"""Ending or marking file -> the module that has `read_log` and alone imports its library."""


@dataclass(frozen=True)
class LogPlace:
    """A log that was found. name: its path below the source, without its ending.

    kind: its ending, or the file that marks its folder.
    """

    path: Path
    name: str
    kind: str

    @property
    def is_table(self) -> bool:
        """Text or a sheet: what may also be a table of events."""
        return self.kind in TEXT or self.kind in SHEET


def find_logs(source: Path) -> list[LogPlace]:
    """The logs of a file or folder, by name. Raises DataNotFound."""
    kind = _kind_of(source)
    if kind is not None:
        return [
            LogPlace(source, source.stem if source.is_file() else source.name, kind)
        ]
    if not source.is_dir():
        what = (
            "no log that can be read" if source.exists() else "no such file or folder"
        )
        raise DataNotFound(
            what,
            where=source,
            next_step=f"give a folder, or a file that ends in {', '.join(LOG_SUFFIXES)}",
        )
    places = sorted(_below(source, source), key=lambda place: _natural(place.name))
    if not places:
        raise DataNotFound(
            "no log in this folder",
            where=source,
            next_step=f"give a folder with files that end in {', '.join(LOG_SUFFIXES)}",
        )
    return places


def read_log(place: LogPlace, form: TableFormat) -> ForeignLog:
    """Read a log. Raises LibraryMissing for its extra, or a DataError that names the file."""
    if place.kind in TEXT:
        from holdfast.interop.logs.text_table import read_text_table as read_table
    elif place.kind in SHEET:
        from holdfast.interop.logs.workbook import read_workbook as read_table
    else:
        log: ForeignLog = import_module(MODULES[place.kind]).read_log(
            place.path, place.name
        )
        return log
    columns, first_line = read_table(place.path, form)
    return ForeignLog(place.path, place.name, (Stream(columns),), first_line=first_line)


def _below(folder: Path, source: Path) -> Iterator[LogPlace]:
    for path in sorted(folder.iterdir()):
        if path.name.startswith((".", "~$")):
            continue
        kind = _kind_of(path)
        if kind in PROSE and not _is_table(path):
            continue
        if kind is not None:
            below = path.relative_to(source)
            name = below.with_suffix("") if path.is_file() else below
            yield LogPlace(path, name.as_posix(), kind)
        elif path.is_dir() and not path.is_symlink():
            yield from _below(path, source)


def _kind_of(path: Path) -> str | None:
    if path.is_file():
        suffix = path.suffix.lower()
        return suffix if suffix in LOG_SUFFIXES else None
    for mark in (BAG, LEROBOT):
        if (path / mark).is_file():
            return mark
    return None


def _is_table(path: Path) -> bool:
    """Whether a text file is a table of numbers and no prose."""
    from holdfast.interop.logs.text_table import read_text_table

    try:
        columns, _ = read_text_table(path, TableFormat())
    except DataError:
        return False
    numbers = [column.dtype.kind in "iuf" for column in columns.values()]
    rows = len(next(iter(columns.values()), ()))
    return rows >= FEWEST_ROWS and 2 * sum(numbers) >= len(numbers)


def _natural(name: str) -> list[tuple[int, int, str]]:
    """A key by which trial_2 comes before trial_10."""
    parts = re.split(r"(\d+)", name)
    return [
        (int(p), 0, "") if p.isdecimal() and len(p) < 18 else (0, 1, p) for p in parts
    ]
