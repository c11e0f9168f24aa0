"""Prepared samples as a CSV that replays to the same decisions: Time, X1 .. Zn, valid1 .. validn, all digits kept."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import TextIO

from edge_runtime.contract import Sample, channel_names
from edge_runtime.errors import OutputError
from edge_runtime.trial_file import TIME_COLUMN


class SampleFile:
    """A new file, line-buffered; invalid values are written as they are, nan too. Raises OutputError."""

    def __init__(self, path: Path, n_channels: int) -> None:
        try:
            self._file: TextIO = path.open("x", encoding="utf-8", buffering=1)
        except OSError as error:
            raise OutputError(f"cannot write ({error.strerror})", where=path, next_step="name a new file") from None
        sensors = n_channels // 3
        head = [TIME_COLUMN, *channel_names(sensors), *(f"valid{k}" for k in range(1, sensors + 1))]
        self._file.write(",".join(head) + "\n")
        self._first_ns: int | None = None

    def write(self, sample: Sample) -> None:
        """One line; time in s since the first sample."""
        if self._first_ns is None:
            self._first_ns = sample.t_ns
        time_ns = sample.t_ns - self._first_ns
        cells = [f"{time_ns // 10**9}.{time_ns % 10**9:09d}", *map(repr, sample.values.tolist())]
        self._file.write(",".join([*cells, *("1" if one else "0" for one in sample.valid)]) + "\n")

    def __enter__(self) -> SampleFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()
