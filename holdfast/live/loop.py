"""The live loop: read on an absolute schedule, answer, pass on, and measure each stage.

    due --(wait)--> read --> convert --> step --> decide --> emit

Sample k is due at start + k periods, so a late sample delays no other one. A sample that would be
due in the past is not read: it counts as an overrun, and the monitor takes it as lost. So a stalled
machine loses samples, but it is never late without reporting it. A recording is due at its rate,
so every row of it is read once. A source that waits for its next sample paces the loop itself.

A reading is used once. A reading with the stamp of the last one is the same again (`repeated`); a
slightly older one came late (`late`). Both are counted, and their sample is lost. Stamps that go
back by more than a second come from another clock. The stream then starts again (`restarts`): the
state is unknown until the model has settled, and an active request continues. A line that a
consumer does not take is dropped (holdfast/live/outputs.py) and counted, so a slow consumer never
delays an answer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    Command,
    FloatArray,
    Prediction,
    Sample,
)
from holdfast.core.errors import count_of
from holdfast.core.source import SelfPaced, Source, SourceReading
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.edge_runtime.preparation import Tare

STAGES = ("read", "convert", "step", "decide", "emit")
REMEMBERED = 1 << 16
"""The summary uses the latencies of this many last samples."""
PERCENTS = (50.0, 99.0, 99.9)
PERCENT_NAMES = ("p50", "p99", "p99.9")
ANOTHER_CLOCK_NS = 1_000_000_000
"""A reading never takes this long: an older stamp comes from a clock that was set or wrapped."""


Emit = Callable[[Prediction, Sample, SourceReading], object]
"""Passes an answer on, with the prepared sample and the reading that it is for."""


class Clock(Protocol):
    """Time to run by."""

    def now_ns(self) -> int:
        """Monotonic, ns."""
        ...

    def wait_until(self, t_ns: int) -> None:
        """Return at t_ns, or at once where it is past."""
        ...


@dataclass
class Summary:
    """What a run did: samples by state, losses and their reasons, acts, and us by stage."""

    samples: int = 0
    overruns: int = 0
    acts: int = 0
    too_old: int = 0
    """Answers older than two periods; their state is unknown."""
    repeated: int = 0
    late: int = 0
    restarts: int = 0
    dropped: int = 0
    """Lines that a consumer did not take."""
    lost_sinks: dict[str, str] = field(default_factory=dict)
    """The error after which a consumer got no more lines, by its name."""
    states: dict[str, int] = field(default_factory=dict)
    silent: tuple[str, ...] = ()
    """Sensors that were never valid."""
    source_ended: bool = False
    """It had no more samples, as a recording; a hand never ends by itself."""
    stage_us: npt.NDArray[np.float32] = field(
        default_factory=lambda: np.zeros((REMEMBERED, len(STAGES)), dtype=np.float32)
    )

    def note(
        self, prediction: Prediction, acted_before: bool, times_ns: list[int]
    ) -> None:
        """Count one sample. times_ns: when its read began, then the end of every stage."""
        # a ring of fixed size: a run of days must not grow in memory
        self.stage_us[self.samples % REMEMBERED] = np.diff(times_ns) / 1e3
        self.samples += 1
        self.states[prediction.state] = self.states.get(prediction.state, 0) + 1
        self.acts += prediction.act and not acted_before
        self.too_old += prediction.late

    def count(self, trouble: str) -> None:
        """One reading that was "repeated" or "late", or at which the stream "restarts"."""
        self.repeated += trouble == "repeated"
        self.late += trouble == "late"
        self.restarts += trouble == "restarts"

    def latency_us(self) -> dict[str, dict[str, float]]:
        """Stage, and "read to emit" -> p50, p99, p99.9 in us."""
        # before the ring is full, its rest is zeros and no measurement
        kept = self.stage_us[: min(self.samples, REMEMBERED)].astype(np.float64)
        if not len(kept):
            return {}
        columns = dict(zip(STAGES, kept.T, strict=True))
        # the sum of percentiles is not the percentile of the sum, so this one has its own
        columns["read to emit"] = kept.sum(axis=1)

        latency_us = {}
        for name, values in columns.items():
            percentiles = [_percentile(values, percent) for percent in PERCENTS]
            latency_us[name] = dict(zip(PERCENT_NAMES, percentiles, strict=True))

        return latency_us

    def lost(self) -> dict[str, int]:
        """The other losses, by the names above."""
        return {
            "repeated": self.repeated,
            "late": self.late,
            "restarts": self.restarts,
            "too_old": self.too_old,
            "dropped": self.dropped,
        }


def _percentile(values: FloatArray, percent: float) -> float:
    """Like numpy.percentile, without its import of numpy.ma.

    That import takes 0.1 s, and a run must end within a second of SIGTERM.
    """
    place = percent / 100.0 * (len(values) - 1)
    return float(np.interp(place, np.arange(len(values)), np.sort(values)))


class Stamps:
    """Judges by the source's stamps whether a reading is new, and gives each sample its time."""

    def __init__(self, period_ns: float) -> None:
        self._period_ns = round(period_ns)
        self._newest_ns: int | None = None
        self._given_ns = 0

    def judge(self, t_ns: int) -> tuple[str, int]:
        """Whether the reading is new, and the time of its sample.

        The first is "", "repeated", "late" or "restarts". The time goes back at a restart only.
        """
        newest_ns = self._newest_ns
        # a small step back is a late reading; a large one is another clock
        if newest_ns is None or t_ns < newest_ns - ANOTHER_CLOCK_NS:
            self._newest_ns = t_ns
            self._given_ns = t_ns
            trouble = "" if newest_ns is None else "restarts"
            return trouble, t_ns

        # used twice, one reading would count as two samples; its place stays empty instead
        if t_ns <= newest_ns:
            self._given_ns += self._period_ns
            trouble = "repeated" if t_ns == newest_ns else "late"
            return trouble, self._given_ns

        # places that were given to lost readings may lie ahead of the stamps
        self._newest_ns = t_ns
        self._given_ns = max(t_ns, self._given_ns + 1)
        return "", self._given_ns


class _LiveRun:
    """A running loop: its source, its schedule, and what it has counted so far."""

    def __init__(
        self,
        source: Source,
        monitor: GripMonitor,
        tare: Tare,
        clock: Clock,
        emit: Emit,
        command: Callable[[], Command],
    ) -> None:
        self._source = source
        self._clock = clock
        self._monitor = monitor
        self._tare = tare
        self._emit = emit
        self._command = command
        self.summary = Summary()
        self._period_ns = 1e9 / (source.rate_hz or monitor.card.rate_hz)
        self._stamps = Stamps(self._period_ns)
        self._start_ns = clock.now_ns()
        # its reads wait for the next sample: a schedule of this clock would drift from its own
        self._is_paced = isinstance(source, SelfPaced)
        self._turn = 0
        self._acted = False

    def answer_next(self) -> bool:
        """Wait until the next sample is due, read and answer it; False where the source ended."""
        # from the start and not from the last turn: rounding and delays do not add up
        if not self._is_paced:
            due_ns = self._start_ns + round(self._turn * self._period_ns)
            self._clock.wait_until(due_ns)
        began_ns = self._clock.now_ns()
        measured = self._source.read()
        # a recording that ends; a hand never does
        if measured is None:
            self.summary.source_ended = True
            return False
        read_ns = self._clock.now_ns()

        sample = self._sample(measured)
        converted_ns = self._clock.now_ns()
        prediction = self._predict(sample)
        self._emit(prediction, sample, measured)

        times_ns = [
            began_ns,
            read_ns,
            converted_ns,
            self._monitor.stepped_ns,
            prediction.t_decided_ns,
            self._clock.now_ns(),
        ]
        # after emit, so that counting and its cost are part of no stage
        self.summary.note(prediction, self._acted, times_ns)
        self._acted = prediction.act
        self._schedule_next()
        return True

    def _sample(self, measured: SourceReading) -> Sample:
        """The reading without its bias; no sensor is valid where the reading is not a new one."""
        trouble, t_ns = self._stamps.judge(measured.t_ns)
        if trouble == "restarts":
            # samples before and after another clock are no one history
            self._monitor.lose_track()

        if trouble:
            self.summary.count(trouble)
        # its values are history already, so no sensor counts as read
        lost = trouble in ("repeated", "late")
        valid = np.zeros_like(measured.valid) if lost else measured.valid
        values, valid = self._tare.prepare(measured.values, valid)
        return Sample(t_ns, values, valid, self._turn)

    def _predict(self, sample: Sample) -> Prediction:
        # asked for as late as possible, so that an opening command counts for this very sample
        command = self._command()
        return self._monitor.feed(
            sample,
            opening=command.opening,
            override=command.override,
            commands=command.link,
        )

    def _schedule_next(self) -> None:
        """Count this turn, and skip the turns whose time has passed."""
        self._turn += 1
        if self._is_paced:
            return
        # turns that are past are never made up for: late answers would act on old touch
        passed_ns = self._clock.now_ns() - self._start_ns
        missed = int(passed_ns / self._period_ns) - self._turn
        if missed > 0:
            self.summary.overruns += missed
            self._turn += missed


def run_live(
    source: Source,
    monitor: GripMonitor,
    tare: Tare,
    clock: Clock,
    emit: Emit,
    *,
    stopped: Callable[[], bool],
    command: Callable[[], Command] = Command,
) -> Summary:
    """Read, answer and emit until stopped or until the source ends.

    What source and emit raise passes. The summary counts no dropped lines: emit knows them.
    """
    run = _LiveRun(source, monitor, tare, clock, emit, command)
    while not stopped() and run.answer_next():
        pass
    return run.summary


def report_summary(summary: Summary, report: Callable[[str], object]) -> None:
    """Print counts, lost outputs, and the latency of each stage."""
    states = ", ".join(f"{name} {count}" for name, count in summary.states.items())
    counts = [
        count_of(summary.samples, "sample"),
        count_of(summary.overruns, "overrun"),
    ]
    counts += [f"{count} {name}" for name, count in summary.lost().items() if count]
    counts.append(count_of(summary.acts, "act"))
    report(f"\n{', '.join(counts)}; {states}")

    if summary.silent:
        report(f"never answered: {', '.join(summary.silent)}")
    # a sink that broke during the run is named once more: its message may have scrolled away
    for sink, reason in summary.lost_sinks.items():
        report(f"lost: {sink} ({reason})")
    for stage, figures in summary.latency_us().items():
        each = "  ".join(f"{name} {value:8.1f} us" for name, value in figures.items())
        report(f"{stage:<14}{each}")
