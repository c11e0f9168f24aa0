"""Which files are logs, how each is read, and what is refused.

A bag of ROS 2 is a folder with metadata.yaml, a LeRobot set one with meta/info.json. Any other file
that begins like a table is one, whatever it is called.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path

from holdfast.core.errors import DataError, DataNotFound, EmptyRecording, NotANumber
from holdfast.core.trial_layout import LOG_MARKS, LOG_SUFFIXES
from holdfast.interop.formats.streams import ForeignLog, Stream, counted
from holdfast.interop.formats.tables import begin_of
from holdfast.interop.joining import united, whole_stamps, without_repeats

PROSE = (".txt", ".dat", ".log", ".json", "")
"""Endings that other files have too: such a file in a folder is a log if it is a table."""
SCALARS = ".json"
"""What one object says of a trial: who held what, and when it fell."""
MODULES = {
    ".xlsx": "workbook", ".xlsm": "workbook", ".parquet": "parquet", ".mcap": "mcap_file",
    ".xdf": "xdf", ".xdfz": "xdf", LOG_MARKS[0]: "ros2", LOG_MARKS[1]: "lerobot",
    SCALARS: "scalars",
}  # fmt: skip
"""Ending or marking file -> the module that alone imports its library; of others it is `tables`."""
LABEL_COLUMNS = 3
"""Of a table of labels: when each begins, when it ends, and what it is."""
POINTER = b"version https://git-lfs"
"""How a file begins whose content was not fetched."""
FOREIGN = {
    "a MATLAB file: save its columns as CSV": ".mat",
    "HDF5: save its tables as CSV or Parquet": ".h5 .hdf5 .hdf",
    "numpy: save it by numpy.savetxt as CSV": ".npy .npz",
    "a pickle: save its columns as CSV": ".pkl .pickle .pt",
    "JSON in lines: save it as CSV": ".jsonl .ndjson",
    "of LabVIEW: save it as text (LVM)": ".tdms",
    "an old workbook: save it as .xlsx": ".xls",
    "a picture or a film": ".png .jpg .jpeg .bmp .tif .tiff .mp4 .avi",
    "packed: unpack it": ".zip .gz .7z .tar .rar",
    "a bag of ROS 1: rosbags-convert makes one of ROS 2": ".bag",
    "a recording of a camera system: export it as CSV": ".c3d .trc",
}
"""What others write and nothing here reads -> endings."""


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
    root = source if _kind_of(source) is None else source.parent
    others: list[str] = []
    found: list[LogPlace] = []
    named: dict[str, LogPlace] = {}
    # of two with one name a text is that of the labels
    places = sorted(
        _places(source, root), key=lambda one: (counted(one.name), one.kind in PROSE)
    )
    for place in places:
        wide = _columns_of(place)
        if not wide and place.path != source:
            if place.kind == SCALARS and place.name in named:
                # what is broken here is said, not that the log has no facts
                with suppress(EmptyRecording):
                    read_log(place)
            others.append(place.path.name)
            continue
        first = named.setdefault(place.name, place)
        if first is place or wide <= LABEL_COLUMNS:
            found.append(place)
        else:
            others.append(f"{place.path.name} (as {first.path.name})")

    if all(place.kind == SCALARS for place in found):
        # one that tells more than others
        paths = (place.path for place in places)
        seen = max(paths, key=_what_it_is, default=source)
        what = _what_it_is(seen) or "no table"
        raise DataNotFound(
            f"no log here; {seen.name} is {what}",
            where=seen,
            next_step=f"give a folder with files that end in {', '.join(LOG_SUFFIXES)}",
        )

    return found, others


def _what_it_is(path: Path) -> str:
    """What a path is that nothing here reads; "" where it does not show."""
    if not path.exists():
        return "no file or folder"
    if path.is_file():
        with path.open("rb") as file:
            if file.read(len(POINTER)) == POINTER:
                return "a Git LFS pointer: git lfs pull fetches its content"
    suffix = path.suffix.lower()
    kinds = (what for what, ends in FOREIGN.items() if suffix in ends.split())
    return next(kinds, "")


def read_log(place: LogPlace) -> ForeignLog:
    """Read a log.

    Raises LibraryMissing for its extra, or a DataError that names the file.
    """
    reader = import_module(
        f"holdfast.interop.formats.{MODULES.get(place.kind, 'tables')}"
    )
    what = _what_it_is(place.path)
    if what:
        raise NotANumber(f"{place.path.name} is {what}", where=place.path)
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

    same: dict[tuple[str, ...], list[Stream]] = {}
    for stream in log.streams:
        if stream.rows:
            plain = without_repeats(whole_stamps(stream))
            same.setdefault(tuple(plain.columns), []).append(plain)
    if not same:
        raise EmptyRecording("no row of data", where=place.path)
    return replace(log, streams=tuple(map(united, same.values())))


def _columns_of(place: LogPlace) -> int:
    """How many columns a file has that begins like a table, 0 for another one.

    What may be prose must have mostly numbers. Of a format of its own: more than labels have.
    """
    try:
        if place.kind == SCALARS:
            read_log(place)
            return 1
        if place.kind in MODULES:
            return LABEL_COLUMNS + 1
        layout, _ = begin_of(place.path)
    except (DataError, ValueError):
        # bytes that only look like cells
        return 0

    wide = len(layout.names)
    return wide if place.kind not in PROSE or 2 * len(layout.numeric) >= wide else 0


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
        return suffix if suffix in (*LOG_SUFFIXES, SCALARS) else ""
    return next((mark for mark in LOG_MARKS if (path / mark).is_file()), None)
