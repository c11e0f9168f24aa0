"""A trial's tactile.csv during recording: append-only, one line a sample.

    Time, X1, Y1, Z1 .. Zn, host_ns, sequence, valid1 .. validn

Every line is one write to the system, so a killed program loses at most the sample that it was
writing. Once a second of sample time, a thread syncs the file to the disk: a slow card delays no
sample, and a power cut costs about that second.

A killed program leaves a part of a line; a power cut may leave zeros behind it. `repair_table`
moves that end to `<file>.torn`, and nothing is deleted. Where header and rows disagree the file is
refused unchanged, for a person to correct.
"""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from holdfast.core.contract import BoolArray, FloatArray, channel_names, valid_names
from holdfast.core.errors import EmptyRecording, OutputError
from holdfast.core.trial_file import TIME_COLUMN, check_columns, table_of
from holdfast.core.writing import write_whole

TORN = ".torn"


@dataclass(frozen=True)
class RepairResult:
    """The result of a repair: whole lines of data, and the bytes of the torn end.

    torn: the file that has them, None where nothing was torn.
    """

    rows: int
    cut_bytes: int
    torn: Path | None


def repair_lines(path: Path, is_whole: Callable[[bytes], bool]) -> RepairResult:
    """Move the torn end of a file without a header to its own file.

    is_whole: judges a last line without its newline. Raises EmptyRecording without a file,
    OutputError.
    """
    data = read_damaged(path)
    text = data.rstrip(b"\0")
    begin = text.rfind(b"\n") + 1
    kept_bytes = len(text) if is_whole(text[begin:]) else begin
    rows = len(text[:kept_bytes].splitlines())
    return RepairResult(
        rows, len(data) - kept_bytes, move_aside(path, data, kept_bytes)
    )


def move_aside(path: Path, data: bytes, kept_bytes: int) -> Path | None:
    """Copy the data after kept_bytes to a new file, then cut the original there; None without any.

    An earlier torn end is never overwritten.
    """
    torn = data[kept_bytes:]
    if not torn:
        return None
    # the same torn end again, as after a repair that was itself cut off, needs no second file
    target, number = path.with_name(path.name + TORN), 1
    while target.exists() and read_damaged(target) != torn:
        number += 1
        target = path.with_name(f"{path.name}{TORN}{number}")
    # first the copy, then the cut: a kill in between loses nothing
    write_whole(target, torn)
    try:
        os.truncate(path, kept_bytes)
    except OSError as error:
        raise _unrepaired(path, error) from None
    return target


def read_damaged(path: Path) -> bytes:
    """A file's bytes. Raises EmptyRecording without it, OutputError where it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise EmptyRecording(
            "does not exist",
            where=path,
            cause="the recorder was killed at once",
            next_step="record again",
        ) from None
    except OSError as error:
        raise _unrepaired(path, error) from None


def _unrepaired(path: Path, error: OSError) -> OutputError:
    """The file is as it was; repairing a copy may work elsewhere."""
    return OutputError(
        f"cannot be repaired ({error.strerror})",
        where=path,
        next_step="copy the file and repair the copy",
    )


SYNC_EVERY_NS = 1_000_000_000
MOST_FILE_SENSORS = 64


class TactileFile:
    """A new file for n_channels. rows: whole lines. Raises OutputError.

    Lines written before it stay.
    """

    def __init__(self, path: Path, n_channels: int) -> None:
        self.path, self.rows, self._size = path, 0, 0
        try:
            # unbuffered, so that every line is one write; "x", so that no file is overwritten
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise self._failed(error) from None
        self._sync = _Sync(self._file.fileno())
        self._first_ns = self._synced_ns = 0
        try:
            self._append(header_line(n_channels // 3))
        except OutputError:
            self._sync.close()
            self._file.close()
            raise

    def write(
        self,
        t_ns: int,
        host_ns: int,
        sequence: int,
        values: FloatArray,
        valid: BoolArray,
    ) -> float:
        """Write one sample with all digits, nan where nothing came.

        Returns its Time, s from the first.
        """
        if not self.rows:
            self._first_ns = self._synced_ns = t_ns
        # whole numbers, so that no digit of the time is lost
        time_ns = t_ns - self._first_ns
        cells = [f"{time_ns // 10**9}.{time_ns % 10**9:09d}"]
        cells += map(repr, values.tolist())
        cells += [str(host_ns), str(sequence)]
        cells += ["1" if one else "0" for one in valid]
        self._append(",".join(cells))
        self.rows += 1
        # by the time of the samples: a replay or a test needs no clock
        if t_ns - self._synced_ns >= SYNC_EVERY_NS:
            self._synced_ns = t_ns
            self._sync.request()
        return 1e-9 * time_ns

    def close(self) -> None:
        """Sync and close the file. Raises OutputError where the disk fails."""
        self._sync.request()
        self._sync.close()
        self._file.close()
        self._raise_unsynced()

    def _append(self, line: str) -> None:
        """One write a line: all of it is in the file, or nothing."""
        self._raise_unsynced()
        data = f"{line}\n".encode()
        try:
            if self._file.write(data) != len(data):
                raise OSError(28, os.strerror(28))
        except OSError as error:
            # a line that was written in part would join the next one
            os.ftruncate(self._file.fileno(), self._size)
            raise self._failed(error) from None
        self._size += len(data)

    def _raise_unsynced(self) -> None:
        """An error of the thread, raised where the recorder can handle it."""
        if self._sync.failed is not None:
            raise self._failed(self._sync.failed)

    def _failed(self, error: OSError) -> OutputError:
        """The error of a write or a sync."""
        return OutputError(
            f"cannot write ({error.strerror})",
            where=self.path,
            cause="a full disk, no permission, or an old file",
            next_step="make room; the recording up to here is kept",
        )


def header_line(n_sensors: int) -> str:
    """The first line of a file with this many sensors, without its newline."""
    columns = [TIME_COLUMN, *channel_names(n_sensors), "host_ns", "sequence"]
    return ",".join([*columns, *valid_names(n_sensors)])


class _Sync:
    """fsync in a thread, once for each request."""

    def __init__(self, handle: int) -> None:
        self.failed: OSError | None = None
        self._handle, self._requests = handle, SimpleQueue[bool]()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def request(self) -> None:
        """Ask for one sync; returns at once."""
        self._requests.put(True)

    def close(self) -> None:
        """End the thread after the syncs that were asked for."""
        self._requests.put(False)
        self._thread.join()

    def _run(self) -> None:
        """The thread: one fsync a request, until a request to end."""
        while self._requests.get():
            try:
                os.fsync(self._handle)
            except OSError as error:
                self.failed = error


def repair_table(path: Path) -> RepairResult:
    """Move an incomplete last row of a tactile.csv, and zeros behind it, to another file.

    A whole row without its newline is whole. Raises EmptyRecording where the file ends within its
    header, ColumnError or NotANumber where header and rows disagree, and OutputError; the file is
    then unchanged.
    """
    data = read_damaged(path)
    # zeros at the end are blocks that a power cut left unwritten
    text = data.rstrip(b"\0")
    first, newline, _ = text.partition(b"\n")
    header = [name.strip() for name in first.decode("utf-8-sig", "replace").split(",")]
    if not newline and _is_begun(first):
        raise EmptyRecording(
            "the header is incomplete",
            where=path,
            cause="killed at once",
            next_step="record again",
        )
    check_columns(header, path)

    begin = text.rfind(b"\n") + 1
    kept_bytes = len(text) if _is_row(text[begin:], len(header)) else begin
    # what numpy does not read is no torn end: a person has to look at it
    table = table_of(
        io.StringIO(text[:kept_bytes].decode("utf-8-sig", "replace")), header, path
    )
    return RepairResult(
        len(table), len(data) - kept_bytes, move_aside(path, data, kept_bytes)
    )


def _is_begun(line: bytes) -> bool:
    """Whether a line is the beginning of a recorder's header."""
    headers = (header_line(sensors) for sensors in range(1, MOST_FILE_SENSORS + 1))
    return any(header.encode().startswith(line) for header in headers)


def _is_row(line: bytes, n_cells: int) -> bool:
    """Whether a line has all its numbers."""
    cells = line.split(b",")
    try:
        return len([float(cell) for cell in cells]) == n_cells
    except ValueError:
        return False
