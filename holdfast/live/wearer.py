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
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.hand_lines import (
    NOT_RISING,
    NOT_UNDERSTOOD,
    RisingRule,
    SkippedLines,
    fields_of,
    not_an_address,
    printable,
    sequence_of,
)
from holdfast.core.trial_layout import intent_path
from holdfast.edge_runtime.wearer import (
    INTENT_HEADER,
    Intent,
    IntentMonitor,
    Words,
    intent_of,
    intent_row,
    read_intent,
)
from holdfast.live.outputs import STOPPED, SampleFile, file_sink
from holdfast.live.sources import LINES, REPLAY, open_feed, source_url, stream_name

if TYPE_CHECKING:
    from holdfast.drivers.line_feeds import Feed


@dataclass
class IntentLog:
    """An output: a file of the items that came at each sample, next to the samples' file.

    now_ns: the run's clock. Raises OutputError.
    """

    intent: IntentMonitor
    now_ns: Callable[[], int]
    samples: SampleFile

    def __post_init__(self) -> None:
        self.sink = file_sink(intent_path(self.samples.path), INTENT_HEADER)

    def write(self, *sample: object) -> None:
        """The items of one sample, on the time axis of the samples' file."""
        first_ns = self.samples.first_ns
        # without a first sample there is no time axis for the items yet
        if first_ns is None or self.sink.failure is not None:
            return
        # the file has both times of an item: a run with a scene has a clock of its own
        after_ns = time.monotonic_ns() - self.now_ns()
        for item in self.intent.fresh:
            self.sink(intent_row(item, first_ns, after_ns))

    def close(self, reason: str = STOPPED) -> None:
        """Wait for the last lines."""
        self.sink.close()


@dataclass
class LineWords:
    """Items as lines, stamped at the sample at which they are read."""

    feed: Feed
    now_ns: Callable[[], int]
    report: Callable[[str], object]

    def __post_init__(self) -> None:
        self._rule = RisingRule()
        self._skipped = SkippedLines("wearer", self.report, self.now_ns)

    def __call__(self) -> list[Intent]:
        """What is waiting, oldest first."""
        items = []
        for line in self.feed.pull(0.0):
            items += self._read(line)
        return items

    def _read(self, line: bytes) -> list[Intent]:
        """The item of a line; none where it is skipped."""
        now_ns, kind, why = self.now_ns(), NOT_RISING, ""
        line = line.strip()
        try:
            is_object = line.startswith(b"{")
            fields = fields_of(line) if is_object else {"wants": line.decode()}
            sequence = sequence_of(fields.get("sequence"))
            item = intent_of(fields.get("wants"), now_ns)
            if self._rule.obeys(now_ns, sequence):
                return [item]
        except ValueError as error:
            kind, why = NOT_UNDERSTOOD, f" ({error})"
        self._skipped.count(kind, f"{printable(line)} is skipped: {kind}{why}")
        return []

    def close(self) -> None:
        self._skipped.close()


def replayed_words(path: Path, now_ns: Callable[[], int]) -> Words:
    """The words of a recorded file; its time begins at the first look."""
    waiting = read_intent(path)
    began_ns: int | None = None

    def words() -> list[Intent]:
        nonlocal began_ns
        now = now_ns()
        began_ns = now if began_ns is None else began_ns
        due = []
        # not at the first look itself, which drops what is there
        while waiting and began_ns + waiting[0].t_ns < now:
            item = waiting.pop(0)
            due.append(item._replace(t_ns=began_ns + item.t_ns))
        return due

    return words


@contextmanager
def wearer_monitor(
    url: str, clock: Any, report: Callable[[str], None]
) -> Iterator[IntentMonitor]:
    """The stream of --wearer, opened.

    Raises UsageError, DeviceError, LibraryMissing, a DataError for a recorded file.
    """
    with ExitStack() as stack:
        words = _words_of(url, clock.now_ns, report, stack)
        yield IntentMonitor(words, clock.now_ns, report)


def _words_of(
    url: str, now_ns: Callable[[], int], report: Callable[[str], None], stack: ExitStack
) -> Words:
    if url.startswith(REPLAY):
        return replayed_words(Path(url.removeprefix(REPLAY)), now_ns)
    if url.startswith("lsl://"):
        from holdfast.drivers.lsl import LslInlet, LslIntent

        name = stream_name(source_url(url).name)
        inlet = stack.enter_context(closing(LslInlet(name)))
        return LslIntent(inlet, now_ns, report)
    if url != "-" and not url.startswith(tuple(f"{one}://" for one in LINES)):
        raise not_an_address(url, "wearer")

    feed = stack.enter_context(closing(open_feed(source_url(url), "--wearer", report)))
    return stack.enter_context(closing(LineWords(feed, now_ns, report)))
