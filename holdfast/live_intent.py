"""The wearer's own command beside the samples of `holdfast run --samples FILE`: FILE.intent.csv."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from holdfast.edge_runtime.intent import IntentMonitor
from holdfast.edge_runtime.intent_file import intent_header, intent_row
from holdfast.edge_runtime.sinks import Sink, file_sink
from holdfast.edge_runtime.trial_layout import intent_path


class IntentLog:
    """Writes what came at each sample."""

    def __init__(self, sink: Sink, intent: IntentMonitor, now_ns: Callable[[], int]) -> None:
        self.sink, self._intent, self._now_ns = sink, intent, now_ns

    def write(self, first_ns: int | None) -> int:
        """The items of one sample; returns how many lines were dropped.

        first_ns: time of the first sample.
        """
        if not self._intent.fresh or first_ns is None or self.sink.failure is not None:
            return 0
        after_ns, count = time.monotonic_ns() - self._now_ns(), self._intent.n_envelopes
        rows = [intent_row(one, first_ns, after_ns, count) for one in self._intent.fresh]
        return sum(not self.sink(row) for row in rows)


@contextmanager
def intent_log(
    samples: Path, intent: IntentMonitor, now_ns: Callable[[], int]
) -> Iterator[IntentLog]:
    """A new file beside the samples. now_ns: the run's clock. Raises OutputError."""
    header = intent_header(intent.n_envelopes)
    with file_sink(intent_path(samples), "--intent", header) as sink:
        yield IntentLog(sink, intent, now_ns)
