"""A trial's tactile.csv while it is recorded: append-only, one line a sample, nothing lost but the line under way.

    Time, X1, Y1, Z1 .. Zn, host_ns, sequence, valid1 .. validn

Every line is one write to the system, so a killed program loses at most the sample it was writing. The disk is told
once a second of the samples' time, by a thread: a slow card delays no sample, a power cut costs about that second.
`mend` takes a torn last line away, and nothing else.
"""

from __future__ import annotations

import os
import threading
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from edge_runtime.contract import BoolArray, FloatArray, channel_names
from edge_runtime.errors import EmptyRecording, OutputError
from edge_runtime.trial_file import TIME_COLUMN

SYNC_EVERY_NS = 1_000_000_000


class TactileFile:
    """A new file for n_channels. rows: lines that are whole. Raises OutputError; what was whole by then stays."""

    def __init__(self, path: Path, n_channels: int) -> None:
        sensors = n_channels // 3
        head = [TIME_COLUMN, *channel_names(sensors), "host_ns", "sequence"]
        self.path, self.rows, self._size = path, 0, 0
        try:
            self._file = path.open("xb", buffering=0)
        except OSError as error:
            raise self._failed(error) from None
        self._sync = _Sync(self._file.fileno())
        self._first_ns = self._synced_ns = 0
        try:
            self._append(",".join([*head, *(f"valid{k}" for k in range(1, sensors + 1))]))
        except OutputError:
            self._sync.close()
            self._file.close()
            raise

    def write(self, t_ns: int, host_ns: int, sequence: int, values: FloatArray, valid: BoolArray) -> float:
        """One sample, values with all their digits, nan where nothing came; returns its Time, s from the first."""
        if not self.rows:
            self._first_ns = self._synced_ns = t_ns
        time_ns = t_ns - self._first_ns
        cells = [f"{time_ns // 10**9}.{time_ns % 10**9:09d}", *map(repr, values.tolist()), str(host_ns), str(sequence)]
        self._append(",".join([*cells, *("1" if one else "0" for one in valid)]))
        self.rows += 1
        if t_ns - self._synced_ns >= SYNC_EVERY_NS:
            self._synced_ns = t_ns
            self._sync.ask()
        return 1e-9 * time_ns

    def close(self) -> None:
        """Everything on the disk, the file closed. Raises OutputError where the disk would not take it."""
        self._sync.ask()
        self._sync.close()
        self._file.close()
        self._raise_unsynced()

    def _append(self, line: str) -> None:
        self._raise_unsynced()
        data = f"{line}\n".encode()
        try:
            if self._file.write(data) != len(data):
                raise OSError(28, os.strerror(28))
        except OSError as error:
            os.ftruncate(self._file.fileno(), self._size)
            raise self._failed(error) from None
        self._size += len(data)

    def _raise_unsynced(self) -> None:
        if self._sync.failed is not None:
            raise self._failed(self._sync.failed)

    def _failed(self, error: OSError) -> OutputError:
        return OutputError(
            f"cannot write ({error.strerror})", where=self.path, cause="a full disk, no permission, or an old file",
            next_step="make room; what was recorded by then is kept",
        )  # fmt: skip


class _Sync:
    """fsync beside the loop, one for each time it is asked."""

    def __init__(self, handle: int) -> None:
        self.failed: OSError | None = None
        self._handle, self._asked = handle, SimpleQueue[bool]()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def ask(self) -> None:
        self._asked.put(True)

    def close(self) -> None:
        self._asked.put(False)
        self._thread.join()

    def _run(self) -> None:
        while self._asked.get():
            try:
                os.fsync(self._handle)
            except OSError as error:
                self.failed = error


@dataclass(frozen=True)
class Mended:
    """What mending found: whole rows, and bytes of a torn end that it took away."""

    rows: int
    cut_bytes: int


def mend(path: Path) -> Mended:
    """Take away what stands after the last whole line. Raises EmptyRecording without a header, OutputError."""
    try:
        data = path.read_bytes()
        whole = _whole_bytes(data)
        if not whole:
            raise EmptyRecording("not even a header", where=path, cause="killed at once", next_step="record again")
        if whole < len(data):
            os.truncate(path, whole)
    except OSError as error:
        raise OutputError(f"cannot be mended ({error.strerror})", where=path, next_step="copy it, mend that") from None
    return Mended(data[:whole].count(b"\n") - 1, len(data) - whole)


def _whole_bytes(data: bytes) -> int:
    """How many bytes the whole lines at the beginning are; after a power cut a tail of zeros may stand there too."""
    end = data.rfind(b"\n") + 1
    cells = data[: data.find(b"\n") + 1].count(b",")
    while end:
        begin = data.rfind(b"\n", 0, end - 1) + 1
        line = data[begin:end]
        if line.count(b",") == cells and b"\0" not in line:
            return end
        end = begin
    return 0
