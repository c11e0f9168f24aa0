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

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import Command, FloatArray, Prediction, Sample
from holdfast.core.errors import count_of
from holdfast.core.source import Source, SourceReading, Turns
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.edge_runtime.preparation import Tare

STAGES = ("read", "convert", "step", "decide", "emit")
REMEMBERED = 1 << 16
"""The summary uses the latencies of this many last samples."""
WHOLE = "read to emit"
PERCENTS = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}
LOSSES = ("repeated", "late", "restarts", "too_old", "dropped")
"""too_old: answers older than two periods; dropped: lines that a consumer did not take."""
ANOTHER_CLOCK_NS = 1_000_000_000
"""A reading never takes this long: an older stamp comes from a clock that was set or wrapped."""
Emit = Callable[[Prediction, Sample, SourceReading], object]
"""Passes an answer on, with the prepared sample and the reading that it is for."""


@dataclass
class Summary:
    """What a run did: samples by state, losses by LOSSES, acts, and us by stage."""

    samples: int = 0
    overruns: int = 0
    acts: int = 0
    acting: bool = False
    lost: dict[str, int] = field(default_factory=lambda: dict.fromkeys(LOSSES, 0))
    states: Counter[str] = field(default_factory=Counter)
    source_ended: bool = False
    """It had no more samples, as a recording; a hand never ends by itself."""
    stage_us: npt.NDArray[np.float32] = field(
        default_factory=lambda: np.zeros((REMEMBERED, len(STAGES)), dtype=np.float32)
    )

    def note(self, prediction: Prediction, times_ns: list[int]) -> None:
        """Count one sample. times_ns: when its read began, then the end of every stage."""
        # a ring of fixed size: a run of days must not grow in memory
        self.stage_us[self.samples % REMEMBERED] = np.diff(times_ns) / 1e3
        self.samples += 1
        self.states[prediction.state] += 1
        self.acts += prediction.act and not self.acting
        self.acting = prediction.act
        self.lost["too_old"] += prediction.late

    def latency_us(self) -> dict[str, dict[str, float]]:
        """Stage, and WHOLE -> p50, p99, p99.9 in us."""
        # before the ring is full, its rest is zeros and no measurement
        kept = self.stage_us[: min(self.samples, REMEMBERED)].astype(np.float64)
        if not len(kept):
            return {}
        # the sum of percentiles is not the percentile of the sum, so this one has its own
        columns = [*kept.T, kept.sum(axis=1)]
        return dict(zip((*STAGES, WHOLE), map(percentiles, columns), strict=True))


def percentiles(values: FloatArray) -> dict[str, float]:
    """By the names of PERCENTS; like numpy.percentile, without its import of numpy.ma.

    That import takes 0.1 s, and a run must end within a second of SIGTERM.
    """
    places = np.array(list(PERCENTS.values())) * (len(values) - 1)
    found = np.interp(places, np.arange(len(values)), np.sort(values))
    return dict(zip(PERCENTS, found.tolist(), strict=True))


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


@dataclass
class LiveRun:
    """A running loop: its source, its schedule, and what it has counted so far.

    clock: has now_ns and wait_until. The summary counts no dropped lines: emit knows them.
    """

    source: Source
    monitor: GripMonitor
    tare: Tare
    clock: Any
    emit: Emit
    command: Callable[[], Command] = Command
    summary: Summary = field(default_factory=Summary)

    def __post_init__(self) -> None:
        self._fill = self.monitor.card.filler()
        period_ns = 1e9 / (self.source.rate_hz or self.monitor.card.rate_hz)
        self._stamps = Stamps(period_ns)
        self._turns = Turns(self.source, self.clock, period_ns)

    def until(self, stopped: Callable[[], bool]) -> Summary:
        """Read, answer and emit until stopped or until the source ends.

        What source and emit raise passes.
        """
        while not stopped() and self.answer_next():
            pass
        return self.summary

    def answer_next(self) -> bool:
        """Wait until the next sample is due, read and answer it; False where the source ended."""
        self._turns.wait()
        began_ns = self.clock.now_ns()
        measured = self.source.read()
        # a recording that ends; a hand never does
        if measured is None:
            self.summary.source_ended = True
            return False
        read_ns = self.clock.now_ns()

        sample = self._sample(measured)
        converted_ns = self.clock.now_ns()
        prediction = self._predict(sample)
        self.emit(prediction, sample, measured)

        times_ns = [
            began_ns,
            read_ns,
            converted_ns,
            self.monitor.stepped_ns,
            prediction.t_decided_ns,
            self.clock.now_ns(),
        ]
        # after emit, so that counting and its cost are part of no stage
        self.summary.note(prediction, times_ns)
        self.summary.overruns += self._turns.end()
        return True

    def _sample(self, measured: SourceReading) -> Sample:
        """The reading without its bias; no sensor is valid where the reading is not a new one."""
        trouble, t_ns = self._stamps.judge(measured.t_ns)
        if trouble == "restarts":
            # samples before and after another clock are no one history
            self.monitor.lose_track()

        if trouble:
            self.summary.lost[trouble] += 1
        # its values are history already, so no sensor counts as read
        lost = trouble in ("repeated", "late")
        valid = np.zeros_like(measured.valid) if lost else measured.valid
        values, valid = self.tare.prepare(self._fill(measured.values), valid)
        return Sample(t_ns, values, valid, self._turns.number)

    def _predict(self, sample: Sample) -> Prediction:
        # asked for as late as possible, so that an opening command counts for this very sample
        command = self.command()
        return self.monitor.feed(
            sample,
            opening=command.opening,
            override=command.override,
            commands=command.link,
        )


def report_summary(summary: Summary, report: Callable[[str], object]) -> None:
    """Print counts, and the latency of each stage."""
    counts = [
        count_of(summary.samples, "sample"),
        count_of(summary.overruns, "overrun"),
    ]
    for name, n in summary.lost.items():
        if n:
            counts.append(f"{n} {name}")
    counts.append(count_of(summary.acts, "act"))

    states = []
    for name, n in summary.states.items():
        states.append(f"{name} {n}")

    report(f"\n{', '.join(counts)}; {', '.join(states)}")
    for stage, figures in summary.latency_us().items():
        each = "  ".join(f"{name} {value:8.1f} us" for name, value in figures.items())
        report(f"{stage:<14}{each}")
