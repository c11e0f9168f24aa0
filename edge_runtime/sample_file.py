"""Prepared samples as a CSV that replays to the same decisions: Time, X1 .. Zn, valid1 .. validn.

All digits are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from holdfast.edge_runtime.contract import Sample, channel_names
from holdfast.edge_runtime.sinks import Sink, file_sink
from holdfast.edge_runtime.trial_file import TIME_COLUMN


class SampleFile:
    """Writes samples to a sink; invalid values are written as they are, nan too.

    first_ns: time of the first sample, None before it.
    """

    def __init__(self, sink: Sink) -> None:
        self.sink = sink
        self.first_ns: int | None = None

    def write(self, sample: Sample) -> bool:
        """One line, with the time in s since the first sample; False where a line is dropped."""
        if self.sink.failure is not None:
            return True
        if self.first_ns is None:
            self.first_ns = sample.t_ns
        time_ns = sample.t_ns - self.first_ns
        cells = [f"{time_ns // 10**9}.{time_ns % 10**9:09d}", *map(repr, sample.values.tolist())]
        return self.sink(",".join([*cells, *("1" if one else "0" for one in sample.valid)]))


@contextmanager
def sample_file(path: Path, n_channels: int) -> Iterator[SampleFile]:
    """A new file, written by its own thread. Raises OutputError."""
    sensors = n_channels // 3
    header = ",".join(
        [TIME_COLUMN, *channel_names(sensors), *(f"valid{k}" for k in range(1, sensors + 1))]
    )
    with file_sink(path, "--samples", header) as sink:
        yield SampleFile(sink)
