"""Which files are logs, how each is read, and the columns of one log on one clock.

A bag of ROS 2 is a folder with metadata.yaml, a LeRobot set one with meta/info.json. Any other file
that begins like a table is one, whatever it is called.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise
from pathlib import Path

import numpy as np

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import IntArray
from holdfast.core.errors import DataError, DataNotFound, EmptyRecording, NotANumber
from holdfast.core.trial_layout import LOG_MARKS, LOG_SUFFIXES
from holdfast.interop.columns import unit_of_time
from holdfast.interop.layout import layout_of
from holdfast.interop.streams import (
    LOG_TIME,
    Column,
    Columns,
    ForeignLog,
    Stream,
    counted,
    is_text,
)
from holdfast.interop.tables import HEAD_BYTES, HEAD_LINES, encoding_of, pd

PROSE = (".txt", ".dat", ".log", "")
"""Endings that other files have too: such a file in a folder is a log if it is a table."""
NO_LOGS = (
    ".json", ".jsonl", ".toml", ".yaml", ".yml", ".md", ".html", ".svg", ".xml", ".ipynb", ".py",
    ".m", ".c", ".h", ".cpp", ".ino",
)  # fmt: skip
"""Texts that may look like tables."""
MODULES = {
    ".xlsx": "workbook", ".xlsm": "workbook", ".parquet": "parquet", ".mcap": "mcap_file",
    ".xdf": "xdf", ".xdfz": "xdf", LOG_MARKS[0]: "ros2", LOG_MARKS[1]: "lerobot",
}  # fmt: skip
"""Ending or marking file -> the module that alone imports its library; of others it is `tables`."""
NEAR_STEPS = 0.6
"""A value of another clock belongs to a row if it is so many steps away."""
SHEET = "sheet"
"""The column that names the sheet of a row, where several are one table."""


@dataclass(frozen=True)
class LogPlace:
    """A log that was found. name: its path below the source, without its ending.

    kind: its ending, or the file that marks its folder.
    """

    path: Path
    name: str
    kind: str


def find_logs(source: Path) -> tuple[list[LogPlace], list[str]]:
    """(the logs of a file or folder, by name; what is no log, in words). Raises DataNotFound."""
    others: list[str] = []
    found: dict[str, LogPlace] = {}
    doubtful: list[LogPlace] = []
    root = source if _kind_of(source) is None else source.parent
    for place in sorted(_places(source, root), key=lambda one: counted(one.name)):
        if place.path != source and not _is_table(place):
            others.append(place.path.name)
            doubtful += [] if place.kind in (*PROSE, *NO_LOGS) else [place]
        elif place.name in found:
            others.append(f"{place.path.name} (as {found[place.name].path.name})")
        else:
            found[place.name] = place

    # where there is nothing else, reading them says what is wrong
    places = [*found.values()] or doubtful
    if not places:
        raise DataNotFound(
            "no log in this folder" if source.exists() else "no such file or folder",
            where=source,
            next_step=f"give a folder with files that end in {', '.join(LOG_SUFFIXES)}",
        )

    return places, others


def read_log(place: LogPlace) -> ForeignLog:
    """Read a log.

    Raises LibraryMissing for its extra, or a DataError that names the file.
    """
    reader = import_module(f"holdfast.interop.{MODULES.get(place.kind, 'tables')}")
    try:
        log: ForeignLog = reader.read_log(place.path, place.name)
    except DataError as error:
        raise type(error)(
            error.what,
            where=error.where or place.path,
            cause=error.cause,
            next_step=error.next_step,
        ) from None
    except Exception as error:  # each library raises whatever its parsing meets
        raise NotANumber(
            f"cannot be read as a log ({type(error).__name__}: {str(error)[:120]})",
            where=place.path,
            cause="another format, or an interrupted recording or copy",
            next_step="open it with the program that wrote it, and save it again or as CSV",
        ) from None

    streams = [_whole_stamps(one) for one in log.streams if one.rows]
    if not streams:
        raise EmptyRecording("no row of data", where=place.path)
    same: dict[tuple[str, ...], list[Stream]] = {}
    for stream in streams:
        same.setdefault(tuple(stream.columns), []).append(stream)
    return replace(log, streams=tuple(map(_united, same.values())))


def _is_table(place: LogPlace) -> bool:
    """Whether a file begins like a table; what may be prose, like one with mostly numbers."""
    if place.kind in MODULES or place.kind in NO_LOGS:
        return place.kind in MODULES
    with place.path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    text = head.decode(encoding_of(head), "replace")
    try:
        layout = layout_of(text.splitlines()[:HEAD_LINES])
    except DataError:
        return False

    return place.kind not in PROSE or 2 * len(layout.numeric) >= len(layout.names)


def _places(path: Path, root: Path) -> Iterator[LogPlace]:
    kind = _kind_of(path)
    if kind is not None:
        name = path.with_suffix("") if path.is_file() else path
        yield LogPlace(path, name.relative_to(root).as_posix(), kind)
    elif path.is_dir():
        for inner in sorted(path.iterdir()):
            if not inner.name.startswith((".", "~$")) and not inner.is_symlink():
                yield from _places(inner, root)


def _kind_of(path: Path) -> str | None:
    """The ending of a file, "" for one that is not known; the mark of a folder; else None."""
    if path.is_file():
        suffix = path.suffix.lower()
        return suffix if suffix in (*LOG_SUFFIXES, *NO_LOGS) else ""
    return next((mark for mark in LOG_MARKS if (path / mark).is_file()), None)


# -- streams of one log


def _whole_stamps(stream: Stream) -> Stream:
    """Stamps in two columns as one of ns: seconds or a clock, and what a second is parted into."""
    columns = dict(stream.columns)
    clocks = [name for name, column in columns.items() if _is_clock(column)]
    for name, column in stream.columns.items():
        seconds = re.sub("(?i)n(ano)?(?=se?cs?$|seconds$)", "", name)
        part_ns = NS_OF.get(unit_of_time(name) or "", 0)
        if seconds != name and seconds in columns:
            columns[name] = column + 10**9 * columns.pop(seconds)
        elif part_ns and len(clocks) == 1 and column.dtype.kind == "i":
            is_part = (column >= 0) & (part_ns * column < 10**9)
            if is_part.all():
                columns[clocks[0]] = columns[clocks[0]] + part_ns * columns.pop(name)

    return replace(stream, columns=columns)


def _is_clock(column: Column) -> bool:
    """Whether a column holds times of day or dates, in ns, without a part of a second."""
    is_ns = column.dtype.kind == "i" and len(column) and column.max() > 10**10
    return bool(is_ns) and len(np.unique(column)) > 1 and not (column % 10**9).any()


def _united(same: list[Stream]) -> Stream:
    """Streams of the same columns as one.

    One that began anew goes on; of one that was recorded twice the longer is used; sheets get a
    column with their names.
    """
    same.sort(key=lambda one: 0 if one.t_ns is None else int(one.t_ns[0]))
    longest = max(same, key=lambda one: one.rows)
    stamps = [one.t_ns for one in same if one.t_ns is not None]
    if any(later[0] <= before[-1] for before, later in pairwise(stamps)):
        note = f"{longest.name or 'a stream'} is there twice: the longer one is used"
        return replace(longest, notes=(*longest.notes, note))
    if len(same) == 1:
        return longest
    tables = [pd.DataFrame(one.columns).assign(**{SHEET: one.name}) for one in same]
    whole = pd.concat(tables, ignore_index=True)
    if stamps:
        whole = whole.drop(columns=SHEET)
    columns = {str(name): column.to_numpy() for name, column in whole.items()}
    t_ns = np.concatenate(stamps) if stamps else None
    return replace(longest, columns=columns, t_ns=t_ns)


def table_of(log: ForeignLog, names: Collection[str]) -> Columns:
    """All columns of the streams that have one of these names, on one clock, with the labels.

    A name that no stream has is left out. The clock is that of the slowest of several streams; what
    was not sent about a row is nan there. Labels of a stream of their own hold until the next one.
    """
    used = [one for one in log.streams if one.columns.keys() & set(names)]
    if not used:
        return {}
    columns = dict(used[0].columns)
    stamps = [one.t_ns for one in used if one.t_ns is not None]
    if len(stamps) < len(used):
        return columns
    # of equally slow streams that which lost the least
    slowest = max(map(step_ns, stamps))
    t_ns = max(stamps, key=lambda one: (step_ns(one) > 0.9 * slowest, len(one)))
    columns[LOG_TIME] = t_ns = t_ns if len(used) == 1 else np.unique(t_ns)
    for stream in log.streams:
        if stream not in used:
            columns = _at(stream, t_ns) | columns
        elif len(used) > 1:
            columns |= _at(stream, t_ns, NEAR_STEPS * slowest)

    return columns


def step_ns(stamps: IntArray) -> float:
    """The usual step of stamps [T], 0 of one alone."""
    steps = np.diff(np.unique(stamps))
    return float(np.median(steps)) if len(steps) else 0.0


def _at(stream: Stream, t_ns: IntArray, reach_ns: float | None = None) -> Columns:
    """The cells of a stream at stamps [T], "" and nan for none: the nearest ones within a reach.

    Without a reach the last ones before, of texts and of whole numbers alone.
    """
    if stream.t_ns is None:
        return {}
    table = pd.DataFrame(stream.columns, index=stream.t_ns).sort_index(kind="stable")
    table = table[~table.index.duplicated("last")]
    if reach_ns is None:
        rows = table.index.get_indexer(t_ns, "pad")
    else:
        rows = table.index.get_indexer(t_ns, "nearest", tolerance=max(1, int(reach_ns)))
    columns: Columns = {}
    for name, column in table.items():
        cells = column.to_numpy()
        none = "" if is_text(cells) else np.nan
        if reach_ns is not None or none == "" or not (cells % 1 > 0).any():
            columns[str(name)] = np.where(rows < 0, none, cells[rows])

    return columns
