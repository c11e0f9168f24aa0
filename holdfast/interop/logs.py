"""Which files are logs, how each is read, and the columns of one log on one clock.

A bag of ROS 2 is a folder with metadata.yaml, a LeRobot set one with meta/info.json. Any other file
that begins like a table is one, whatever it is called.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

import numpy as np

from holdfast.core.contract import IntArray
from holdfast.core.errors import DataNotFound, EmptyRecording
from holdfast.core.trial_layout import LOG_MARKS, LOG_SUFFIXES
from holdfast.interop.streams import (
    LOG_TIME,
    Columns,
    ForeignLog,
    Stream,
    is_text,
)

BAG, LEROBOT = LOG_MARKS
TEXT, SHEET = (".csv", ".tsv"), (".xlsx", ".xlsm")
PROSE = (".txt", ".dat", ".log", "")
"""Endings that other files have too: such a file in a folder is a log if it is a table."""
NO_LOGS = [
    ".md",
    ".py",
    ".json",
    ".toml",
    ".yaml",
    ".yml",
    ".html",
    ".pdf",
    ".png",
    ".jpg",
    ".jpeg",
    ".svg",
    ".gif",
    ".mp4",
    ".avi",
    ".mov",
    ".zip",
    ".gz",
    ".npz",
    ".npy",
    ".pkl",
    ".pt",
    ".onnx",
    ".docx",
    ".doc",
    ".pptx",
    ".ino",
    ".c",
    ".h",
    ".cpp",
    ".m",
    ".ipynb",
    ".xml",
    ".url",
    ".db3",
    ".jsonl",
]
MODULES = {
    ".parquet": "holdfast.interop.parquet",
    ".mcap": "holdfast.interop.mcap_file",
    ".xdf": "holdfast.interop.xdf",
    ".xdfz": "holdfast.interop.xdf",
    BAG: "holdfast.interop.ros2",
    LEROBOT: "holdfast.interop.lerobot",
}
"""Ending or marking file -> the module that has `read_log` and alone imports its library."""
NEAR_STEPS = 0.6
"""A value of another clock belongs to a row if it is so many steps away."""


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
    kind = _kind_of(source)
    if kind is not None:
        name = source.stem if source.is_file() else source.name
        return [LogPlace(source, name, kind)], []

    if not source.is_dir():
        raise DataNotFound(
            "no such file or folder", where=source, next_step="check the path"
        )

    from holdfast.interop.tables import is_table

    places: list[LogPlace] = []
    others: list[str] = []
    by_name: dict[str, LogPlace] = {}
    for place in sorted(_below(source, source), key=lambda one: counted(one.name)):
        first = by_name.setdefault(place.name, place)
        if place.kind in NO_LOGS or (place.kind in PROSE and not is_table(place.path)):
            others.append(place.path.name)
        elif first is not place and first.kind != place.kind:
            others.append(f"{place.path.name} (as {first.path.name})")
        else:
            places.append(place)

    if not places:
        raise DataNotFound(
            "no log in this folder",
            where=source,
            next_step=f"give a folder with files that end in {', '.join(LOG_SUFFIXES)}",
        )

    return places, others


def counted(name: str) -> list[tuple[int, int, str]]:
    """A key by which trial_2 comes before trial_10."""
    parts = re.split(r"(\d+)", name)
    return [
        (int(p), 0, "") if p.isdecimal() and len(p) < 18 else (0, 1, p) for p in parts
    ]


def read_log(place: LogPlace) -> ForeignLog:
    """Read a log.

    Raises LibraryMissing for its extra, or a DataError that names the file.
    """
    if place.kind in SHEET:
        from holdfast.interop.workbook import read_workbook

        return ForeignLog(place.path, place.name, tuple(read_workbook(place.path)))

    if place.kind in MODULES:
        reader = import_module(MODULES[place.kind])
        log: ForeignLog = reader.read_log(place.path, place.name)
        streams = [one for one in log.streams if one.rows]
        if not streams:
            raise EmptyRecording("no stream with a sample", where=place.path)
        return replace(log, streams=tuple(_once(streams)))

    from holdfast.interop.tables import read_text_table

    table = read_text_table(place.path)
    return ForeignLog(place.path, place.name, (table,))


def _below(folder: Path, source: Path) -> Iterator[LogPlace]:
    for path in sorted(folder.iterdir()):
        if path.name.startswith((".", "~$")) or path.is_symlink():
            continue
        kind = _kind_of(path)
        if kind is not None:
            below = path.relative_to(source)
            name = below.with_suffix("") if path.is_file() else below
            yield LogPlace(path, name.as_posix(), kind)
        elif path.is_dir():
            yield from _below(path, source)


def _kind_of(path: Path) -> str | None:
    """The ending of a file, "" for one that is not known; the mark of a folder; else None."""
    if path.is_file():
        suffix = path.suffix.lower()
        return suffix if suffix in (*LOG_SUFFIXES, *NO_LOGS) else ""

    for mark in (BAG, LEROBOT):
        if (path / mark).is_file():
            return mark

    return None


# -- streams of one log


def _once(streams: Sequence[Stream]) -> list[Stream]:
    """Each stream once: one that was recorded twice, or that began anew, is one stream."""
    kept: list[Stream] = []
    for stream in streams:
        same = [
            k
            for k, one in enumerate(kept)
            if one.columns.keys() == stream.columns.keys()
        ]
        if not same or stream.t_ns is None or kept[same[0]].t_ns is None:
            kept.append(stream)
            continue
        first = kept[same[0]]
        at_ns = [one.t_ns for one in (first, stream) if one.t_ns is not None]
        if at_ns[0][-1] < at_ns[1][0] or at_ns[1][-1] < at_ns[0][0]:
            order = (first, stream) if at_ns[0][0] < at_ns[1][0] else (stream, first)
            kept[same[0]] = _in_turn(*order)
        else:
            note = f"{stream.name or 'a stream'} is there twice: the longer one is used"
            longer = max(first, stream, key=lambda one: one.rows)
            kept[same[0]] = replace(longer, notes=(*longer.notes, note))

    return kept


def _in_turn(first: Stream, later: Stream) -> Stream:
    columns = {
        name: np.concatenate([first.columns[name], later.columns[name]])
        for name in first.columns
    }
    assert first.t_ns is not None
    assert later.t_ns is not None
    t_ns = np.concatenate([first.t_ns, later.t_ns])
    return replace(first, columns=columns, t_ns=t_ns)


def table_of(log: ForeignLog, names: Collection[str]) -> Columns:
    """All columns of the streams that have one of these names, on one clock, with the labels.

    A name that no stream has is left out. The clock is that of the slowest of several streams; what
    was not sent about a row is nan there. Labels of a stream of their own hold until the next one.
    """
    used = [one for one in log.streams if one.columns.keys() & set(names)]
    if not used:
        return {}
    stamped = [one for one in used if one.t_ns is not None]
    if len(used) > 1 and len(stamped) == len(used):
        columns = joined(used)
    else:
        columns = dict(used[0].columns)
        if used[0].t_ns is not None:
            columns[LOG_TIME] = used[0].t_ns

    for stream in log.streams if LOG_TIME in columns else ():
        if not stream.columns.keys() & set(names):
            columns = _held(stream, columns[LOG_TIME]) | columns

    return columns


def _held(stream: Stream, t_ns: IntArray) -> Columns:
    """The texts and whole numbers of another stream that were sent last at stamps [T]."""
    if stream.t_ns is None:
        return {}
    order = np.argsort(stream.t_ns, kind="stable")
    last = np.searchsorted(stream.t_ns[order], t_ns, side="right") - 1
    columns: Columns = {}
    for name, column in stream.columns.items():
        if is_text(column):
            columns[name] = np.where(last < 0, "", column[order][last])
        elif not (column % 1 > 0).any():
            columns[name] = np.where(last < 0, np.nan, column[order][last])

    return columns


def joined(streams: Sequence[Stream]) -> Columns:
    """Streams with stamps on the clock of the slowest one, the longest of equal ones."""
    from holdfast.interop.tables import pd

    steps = [step_ns(one) for one in streams]
    slowest = max(steps)
    slow = [
        one for one, step in zip(streams, steps, strict=True) if step > 0.9 * slowest
    ]
    stamps = [one.t_ns for one in slow if one.t_ns is not None]
    grid = np.unique(np.concatenate(stamps))
    # stamps that all streams share are one clock; others are as many clocks as streams
    if len(grid) > 1.5 * max(map(len, stamps)):
        grid = np.unique(max(stamps, key=len))
    columns: Columns = {LOG_TIME: grid}
    left = pd.DataFrame({LOG_TIME: grid})
    for stream, step in zip(streams, steps, strict=True):
        right = pd.DataFrame(stream.columns).assign(**{LOG_TIME: stream.t_ns})
        near = pd.merge_asof(
            left,
            right.sort_values(LOG_TIME, kind="stable"),
            on=LOG_TIME,
            direction="nearest",
            tolerance=max(1, int(NEAR_STEPS * max(slowest, step))),
        )
        for name, column in stream.columns.items():
            cells = near[name]
            columns[name] = (
                cells.fillna("").to_numpy(object)
                if is_text(column)
                else cells.to_numpy(np.float64)
            )

    return columns


def step_ns(stream: Stream) -> float:
    """The usual step of a stream's own stamps; that of a stream of one row is 0."""
    assert stream.t_ns is not None
    steps = np.diff(np.unique(stream.t_ns))
    return float(np.median(steps)) if len(steps) else 0.0
