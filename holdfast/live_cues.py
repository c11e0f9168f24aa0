"""`holdfast run --feedback URL`: vibration cues for the wearer, on a wire of their own.

A wire that fails is reported and tried again (edge_runtime/grip_sinks.py); the loop never waits for
it. The last line is the cue `unknown`: nothing looks after the grip any more.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from holdfast.edge_runtime.contract import Prediction, Sample
from holdfast.edge_runtime.cue_card import SHIPPED, read_cues
from holdfast.edge_runtime.cues import (
    QUIET,
    QUIET_NS,
    SILENCE,
    UNKNOWN,
    Cues,
    CueTable,
    Pattern,
    cue_line,
)
from holdfast.edge_runtime.grip_sinks import LineSink, line_sink

Say = Callable[[str], None]
Emit = Callable[[Prediction, Sample, Any], int | None]


class CueOutput:
    """Sends the cues of a run."""

    def __init__(self, sink: LineSink, table: CueTable) -> None:
        self._sink, self._table, self._cues = sink, table, Cues(table)
        self._newest_ns: int | None = None

    def before(self, emit: Emit) -> Emit:
        """An emit that first sends the cue of a sample, and then calls another emit."""

        def both(prediction: Prediction, sample: Sample, measured: Any) -> int | None:
            self.show(prediction)
            return emit(prediction, sample, measured)

        return both

    def show(self, prediction: Prediction) -> None:
        """Send the cue of one sample, or a sign of life where none was due for long."""
        now_ns = prediction.t_decided_ns
        kind = self._cues.due(prediction)
        if kind is not None:
            if self._send(prediction, kind, self._table.rules[kind].pattern):
                self._cues.sent(kind, now_ns)
        elif self._newest_ns is None or now_ns - self._newest_ns >= QUIET_NS:
            self._send(prediction, QUIET, SILENCE)
        else:
            self._sink.look()

    def _send(self, prediction: Prediction, kind: str, pattern: Pattern) -> bool:
        line = cue_line(prediction.sequence, prediction.t_acquired_ns, kind, pattern)
        taken = self._sink(line, prediction.sequence)
        if taken:
            self._newest_ns = prediction.t_decided_ns
        return taken

    @contextmanager
    def running(self, say: Say) -> Iterator[None]:
        """The time of the loop; its last cue is sent before anything is closed."""
        reason = "failed"
        try:
            yield
            reason = "stopped"
        finally:
            self._sink.finish(reason)
            if self._sink.dropped:
                say(f"{self._sink.name}: {self._sink.dropped} lines did not leave")


@contextmanager
def cue_output(args: argparse.Namespace, clock: Any, say: Say) -> Iterator[CueOutput]:
    """The wire of --feedback with the patterns of --cues, opened.

    Raises UsageError, DeviceError, OutputError, CardError, DataNotFound.
    """
    table = read_cues(args.cues or SHIPPED)
    last = partial(last_cue, table)
    opened = line_sink(
        args.feedback, "--feedback", last, say, clock.now_ns, effect="the wearer feels no cue"
    )
    with opened as sink:
        yield CueOutput(sink, table)


def last_cue(table: CueTable, sequence: int, t_ns: int, reason: str) -> str:
    """The line that ends the cues, or begins them after a failure: the state is not known."""
    return cue_line(sequence, t_ns, UNKNOWN, table.rules[UNKNOWN].pattern)
