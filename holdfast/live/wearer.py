"""The stream of --wearer: where the wearer's words come from, and their log beside the samples.

    unix:///PATH        datagrams {"wants": "open"}, or the bare word
    serial:///dev/ttyX  the same as lines of a serial port
    -                   the same from standard input
    lsl://NAME          words of the lab streaming layer
    replay://FILE       a recorded trial_n.intent.csv, in its time

A line may have a `sequence`, which must then rise (core/hand_lines.py). The log of
`holdfast run --to FILE.csv` is FILE.intent.csv.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import DeviceLost, UsageError
from holdfast.core.hand_lines import (
    NOT_RISING,
    NOT_UNDERSTOOD,
    RisingRule,
    Skipped,
    fields_of,
    printable,
    sequence_of,
)
from holdfast.core.trial_layout import intent_path
from holdfast.edge_runtime.wearer import (
    INTENT_HEADER,
    Intent,
    IntentMonitor,
    IntentStream,
    intent_of,
    intent_row,
    read_intent,
)
from holdfast.live.outputs import STOPPED, SampleFile, file_sink
from holdfast.live.sources import LINES, source_url, stream_name

if TYPE_CHECKING:
    from holdfast.drivers.line_feeds import Feed

ADDRESSES = (
    "unix:///run/holdfast/wearer, serial:///dev/ttyX, lsl://NAME, - or replay://FILE"
)


class IntentLog:
    """An output: a file of the items that came at each sample.

    path: of the samples; the log is a new file next to it. now_ns: the run's clock. Raises
    OutputError.
    """

    def __init__(
        self,
        path: Path,
        intent: IntentMonitor,
        now_ns: Callable[[], int],
        samples: SampleFile,
    ) -> None:
        self.sink = file_sink(intent_path(path), INTENT_HEADER)
        self._intent = intent
        self._now_ns = now_ns
        self._samples = samples

    def write(
        self, prediction: object = None, sample: object = None, reading: object = None
    ) -> None:
        """The items of one sample, on the time axis of the samples' file."""
        first_ns = self._samples.first_ns
        # without a first sample there is no time axis for the items yet
        if first_ns is None or self.sink.failure is not None:
            return
        # the file has both times of an item: a run with a scene has a clock of its own
        after_ns = time.monotonic_ns() - self._now_ns()
        for item in self._intent.fresh:
            self.sink(intent_row(item, first_ns, after_ns))

    def close(self, reason: str = STOPPED) -> None:
        """Wait for the last lines."""
        self.sink.close()


class LineWords:
    """Items as lines, stamped at the sample at which they are read."""

    def __init__(
        self, feed: Feed, now_ns: Callable[[], int], report: Callable[[str], object]
    ) -> None:
        self._feed = feed
        self._report = report
        self._lost = False
        self._now_ns = now_ns
        self._rule = RisingRule()
        self._skipped = Skipped("wearer", report, now_ns)

    def came(self) -> list[Intent]:
        """What is waiting, oldest first."""
        items = []
        for line in self._pulled():
            try:
                sequence, item = self._read(line)
            except ValueError as error:
                self._skip(NOT_UNDERSTOOD, line, f" ({error})")
                continue
            if self._rule.obeys(item.t_ns, sequence):
                items.append(item)
            else:
                self._skip(NOT_RISING, line)
        return items

    def forget(self) -> None:
        """Drop what is waiting."""
        while self._pulled():
            pass

    def close(self) -> None:
        """Close where lines come from; report the last counts."""
        self._skipped.close()
        self._feed.close()

    def _pulled(self) -> list[bytes]:
        """The lines that wait; none any more once a port was unplugged."""
        try:
            return [] if self._lost else self._feed.pull(0.0)
        except DeviceLost as error:
            self._lost = True
            self._report(f"wearer: {error}")
            return []

    def _read(self, line: bytes) -> tuple[int | None, Intent]:
        """(sequence, item). Raises ValueError."""
        if not line.startswith(b"{"):
            return None, intent_of(line.decode().strip(), self._now_ns())
        fields = fields_of(line)
        sequence = sequence_of(fields.pop("sequence", None))
        if set(fields) != {"wants"}:
            raise ValueError('no {"wants": ".."}')
        return sequence, intent_of(fields["wants"], self._now_ns())

    def _skip(self, kind: str, line: bytes, why: str = "") -> None:
        self._skipped.count(kind, f"{printable(line)} is skipped: {kind}{why}")


class ReplayedWords:
    """The items of a recorded file; its time begins at the first look."""

    def __init__(self, path: Path, now_ns: Callable[[], int]) -> None:
        record = read_intent(path)
        self._items = list(zip(record.time_s, record.items, strict=True))
        self._now_ns = now_ns
        self._began_ns: int | None = None

    def came(self) -> list[Intent]:
        """The items whose time has come."""
        now_ns = self._now_ns()
        self._began_ns = began_ns = self._began_ns or now_ns
        items = []
        while self._items and began_ns + 1e9 * self._items[0][0] <= now_ns:
            time_s, item = self._items.pop(0)
            items.append(Intent(began_ns + round(1e9 * time_s), item.wants))
        # what the recorder wrote at a silence is no word of the wearer
        return [item for item in items if item.wants not in ("unknown", "")]

    def forget(self) -> None:
        """A recording waits for its time."""

    def close(self) -> None:
        """Nothing to close."""


@contextmanager
def wearer_monitor(
    url: str, clock: Any, report: Callable[[str], None]
) -> Iterator[IntentMonitor]:
    """The stream of --wearer, opened.

    Raises UsageError, DeviceError, LibraryMissing, a DataError for a recorded file.
    """
    with _stream(url, clock, report) as stream:
        yield IntentMonitor(stream, clock.now_ns, report)


@contextmanager
def _stream(
    url: str, clock: Any, report: Callable[[str], None]
) -> Iterator[IntentStream]:
    if url.startswith(("udp://", "tcp://")):
        raise UsageError(
            f"--wearer {url[:80]!r}: nothing that moves a hand crosses a network",
            next_step=ADDRESSES,
        )
    where = source_url(url)
    if where.scheme == "lsl":
        from holdfast.drivers.lsl import LslIntent
        from holdfast.drivers.lsl_library import LslInlet

        with closing(LslInlet(stream_name(where.name))) as inlet:
            yield LslIntent(inlet, clock.now_ns, report)
    elif where.scheme in LINES:
        from holdfast.live.sources import open_feed

        feed = open_feed(where, "--wearer")
        with closing(LineWords(feed, clock.now_ns, report)) as words:
            yield words
    elif url.startswith("replay://"):
        yield ReplayedWords(Path(where.name), clock.now_ns)
    else:
        raise UsageError(f"--wearer {url[:80]!r} is no stream", next_step=ADDRESSES)
