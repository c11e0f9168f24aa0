"""Where the answers of a run go: every destination is an Output, of a kind in output_table.py.

The loop passes each answer to all outputs in turn, also to the grip and the wearer's cues, and
never waits for one.

Streams and files are logs: a thread writes each (lines.py). Lines that they do not take in time are
dropped whole and counted. A log that fails is left out, reported and counted, while the loop goes
on. The loop itself writes to a UDP port, because a socket never delays it.
"""

from __future__ import annotations

import math
import os
import socket
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol
from urllib.parse import urlsplit

from msgspec.json import encode

from holdfast.core.contract import (
    RISKY_SLIP,
    SITUATIONS,
    GripCommand,
    Prediction,
    Sample,
    Unit,
    channel_names,
    not_learned_in_words,
    valid_names,
)
from holdfast.core.errors import OutputError, UsageError
from holdfast.core.hand_card import HandCard, leave_empty
from holdfast.core.lines import CLOSING_S, LineWriter, Sink
from holdfast.core.source import SourceReading
from holdfast.core.trial_file import TIME_COLUMN, ZEROS, Zero
from holdfast.edge_runtime.engine import OpenedModel

RISKY = SITUATIONS[RISKY_SLIP]
STOPPED, FAILED = "stopped", "failed"
"""Why an output is closed: the run came to its end, or an error ended it."""


class Output(Protocol):
    """Gets every answer of a run."""

    def write(
        self,
        prediction: Prediction,
        sample: Sample,
        reading: SourceReading,
        command: GripCommand | None,
    ) -> None:
        """Pass on one answer, the prepared sample that it is for, and the reading behind it.

        command: the grip command of this sample, None without a grip. Never waits.
        """
        ...

    def close(self, reason: str) -> None:
        """End within bounded time. reason: STOPPED or FAILED. A second call does nothing."""
        ...


def close_at_end(stack: ExitStack, output: Output) -> None:
    """Close an output when the stack ends, FAILED where an exception ends it."""

    def close(kind: object, error: BaseException | None, trace: object) -> None:
        output.close(STOPPED if error is None else FAILED)

    # push and not callback: only an exit function is told of the exception
    stack.push(close)


def emit_to(
    outputs: Sequence[Output],
    newest_command: Callable[[], GripCommand | None] = lambda: None,
) -> Callable[[Prediction, Sample, SourceReading], None]:
    """An emit that passes each answer to all outputs in turn.

    newest_command: of the grip, which is the first of the outputs where there is one.
    """

    def emit(prediction: Prediction, sample: Sample, reading: SourceReading) -> None:
        for output in outputs:
            output.write(prediction, sample, reading, newest_command())

    return emit


def to_json_line(prediction: Prediction, not_learned: Collection[str] = ()) -> str:
    """One line without the line break; floats keep all their digits, unknown values are null.

    not_learned: what the model cannot tell, which has no probability.
    """
    # straight from the prediction: a copy as a dictionary would take longer than the text
    if not not_learned:
        return encode(prediction).decode()

    # a probability of almost 0 would look like an answer
    known: dict[str, float | None] = {**prediction.p_situation}
    known |= dict.fromkeys(known.keys() & not_learned)
    altered = {"p_situation": known, "p_risky": known[RISKY]}
    return encode(vars(prediction) | altered).decode()


def about_model(model: OpenedModel) -> list[str]:
    """What is reported of a model when a run begins: its engine, its hand, its gaps."""
    card = model.card
    lines = [model.engine] if model.engine else []
    if card.hand is not None:
        lines.append(card.hand.in_words())
    lines += not_learned_in_words(card.not_learned)
    return lines


@dataclass
class UdpSink:
    """One datagram for each line. A port without a listener is no failure.

    A controller may start later.
    """

    sender: socket.socket
    target: tuple[object, ...]
    name: str
    dropped: int = 0
    failure: OSError | None = None

    def __call__(self, line: str) -> bool:
        """Send it; False where the buffer is full or the network is down."""
        try:
            self.sender.sendto(line.encode(), self.target)
        # the network may come back, so the sink stays and only the line is lost
        except OSError:
            self.dropped += 1
            return False
        return True

    def end(self) -> None:
        """No line is waiting."""

    def close(self, wait_s: float = CLOSING_S) -> None:
        """Close the socket; no line is waiting."""
        self.sender.close()


def udp_sink(address: str) -> UdpSink:
    """A sink to HOST:PORT. Raises UsageError."""
    try:
        parts = urlsplit(f"//{address}")
        found = socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_DGRAM)
        family, kind, protocol, _, target = found[0]
        if not parts.hostname or not parts.port:
            raise ValueError("no host or no port")
    except (OSError, ValueError) as error:
        what = f"udp://{address} is no address: {error}"
        step = "udp://HOST:PORT, such as udp://127.0.0.1:9000"
        raise UsageError(what, next_step=step) from None

    sender = socket.socket(family, kind, protocol)
    # a full buffer loses a line; it must never hold up the loop
    sender.setblocking(False)
    return UdpSink(sender, target, f"udp://{address}")


def file_sink(path: Path, header: str | None = None) -> LineWriter:
    """A new file, a line at a time, after its header.

    Raises OutputError if it exists or is not writable.
    """
    try:
        # O_EXCL: a recording that is there already is never overwritten
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    except OSError as error:
        raise OutputError(
            f"cannot write ({error.strerror})", where=path, next_step="name a new file"
        ) from None
    return LineWriter(handle, str(path), header)


def seconds_text(t_ns: int) -> str:
    """A time in s with all its digits; t_ns: 0 or more.

    >>> seconds_text(1_500_000_000)
    '1.500000000'
    """
    # whole numbers: as a float, a time of many hours would lose its nanoseconds
    seconds, rest_ns = divmod(t_ns, 10**9)
    return f"{seconds}.{rest_ns:09d}"


@dataclass
class LineOutput:
    """Predictions as JSON lines, to every sink that works; it reports the sinks that fail.

    only_checked, also_closed: sinks that get their lines elsewhere: checked for failures, or closed
    with the others too. report: receives a line for each failure. failures: the error by the sink's
    name. not_learned: what the model cannot tell.
    """

    sinks: list[Sink]
    report: Callable[[str], object]
    only_checked: Sequence[Sink] = ()
    not_learned: Collection[str] = ()
    failures: dict[str, OSError] = field(default_factory=dict)
    also_closed: list[Sink] = field(default_factory=list)

    @property
    def dropped(self) -> int:
        """Lines that were offered to sinks and are not in them; exact after `close`."""
        return sum(sink.dropped for sink in self._closed_here())

    def _closed_here(self) -> list[Sink]:
        return [*self.sinks, *self.also_closed]

    def write(
        self,
        prediction: Prediction,
        sample: Sample | None = None,
        reading: SourceReading | None = None,
        command: GripCommand | None = None,
    ) -> None:
        """Pass the prediction to all working sinks, and look for failures."""
        line = to_json_line(prediction, self.not_learned)
        for sink in self.sinks:
            if sink.failure is None:
                sink(line)
        self._note_failures()

    def _note_failures(self) -> None:
        """Report each sink that has failed, once; it gets no more lines."""
        for sink in (*self._closed_here(), *self.only_checked):
            error = sink.failure
            if error is not None and sink.name not in self.failures:
                self.failures[sink.name] = error
                why = error.strerror or error
                self.report(
                    f"{sink.name} takes no more lines ({why}); it is dropped, control goes on"
                )

    def close(self, reason: str = STOPPED, wait_s: float = CLOSING_S) -> None:
        """End all sinks at once and wait at most wait_s for all together.

        Report those that failed.
        """
        # all end before one is waited for, so that they share the time
        for sink in self._closed_here():
            sink.end()
        end_s = time.monotonic() + wait_s
        for sink in self._closed_here():
            sink.close(end_s - time.monotonic())
        self._note_failures()


class RowFile:
    """A new CSV with a row an answer; its first column is the time in s since the first sample.

    What it adds is in `_cells`. first_ns: time of the first sample, None before it. After a failure
    it takes no more rows: the run's lines report it, and the run goes on. Raises OutputError.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self.path = path
        self.sink = file_sink(path, ",".join(columns))
        self.first_ns: int | None = None

    def write(
        self,
        prediction: Prediction,
        sample: Sample,
        reading: SourceReading | None = None,
        command: GripCommand | None = None,
    ) -> None:
        """Add the row of one answer."""
        if self.sink.failure is not None:
            return
        # the first sample sets the time axis, also of the intent's log
        if self.first_ns is None:
            self.first_ns = sample.t_ns

        time_s = seconds_text(sample.t_ns - self.first_ns)
        self.sink(",".join([time_s, *self._cells(prediction, sample, command)]))

    def _cells(
        self, prediction: Prediction, sample: Sample, command: GripCommand | None
    ) -> list[str]:
        """What stands behind the time."""
        raise NotImplementedError

    def close(self, reason: str = STOPPED) -> None:
        """Wait for the last rows."""
        self.sink.close()


class SampleFile(RowFile):
    """A new CSV of prepared samples that replays to the same states, row by row.

    Columns: Time, X1 .. Zn, valid1 .. validn, sequence and prepared_UNIT (core/trial_file.py).
    Invalid values are written as they are, nan too; an axis that the hand does not measure is nan.
    All digits are kept.
    """

    def __init__(
        self,
        path: Path,
        n_channels: int,
        unit: Unit = "N",
        zero: Zero = ZEROS[0],
        hand: HandCard | None = None,
    ) -> None:
        """zero: what was removed from the samples. hand: the model's."""
        sensors = n_channels // 3
        names = [TIME_COLUMN, *channel_names(sensors), *valid_names(sensors)]
        super().__init__(path, [*names, "sequence", f"prepared_{unit}"])
        self._zero = str(1 + ZEROS.index(zero))
        self._hand = hand

    def _cells(
        self, prediction: Prediction, sample: Sample, command: GripCommand | None
    ) -> list[str]:
        values = leave_empty(sample.values, self._hand)
        valid = ["1" if one else "0" for one in sample.valid]
        return [*map(repr, values.tolist()), *valid, str(sample.sequence), self._zero]


class AnswerFile(RowFile):
    """A new CSV of answers, for a spreadsheet.

    Columns: time_s; state; p_risky, empty where it is not known; act, 0 or 1; target_n, N of either
    side, empty where no target is commanded. not_learned: what the model cannot tell.
    """

    def __init__(self, path: Path, not_learned: Collection[str] = ()) -> None:
        super().__init__(path, ["time_s", "state", "p_risky", "act", "target_n"])
        self._tells_risky = RISKY not in not_learned

    def _cells(
        self, prediction: Prediction, sample: Sample, command: GripCommand | None
    ) -> list[str]:
        known = self._tells_risky and math.isfinite(prediction.p_risky)
        p_risky = repr(prediction.p_risky) if known else ""
        target_n = None if command is None else command.target_n
        target = "" if target_n is None else repr(target_n)
        return [prediction.state, p_risky, str(int(prediction.act)), target]
