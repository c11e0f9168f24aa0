"""The live loop: read on an absolute schedule, answer, pass on, and know where the time went.

    due --(wait)--> read --> convert --> step --> decide --> emit

The k-th sample is due at start + k periods, so a late one delays no other. A sample that would be
due in the past is not read: it counts as an overrun, and the monitor takes it as lost (a stalled
machine loses samples, it is never silently late). A recording is due at its own rate, so that every
row of it is met once.

A reading is used once. One with the stamp of the last is the same again (repeated); one a little
older came late (late): both count, and the sample is lost. Stamps more than a second back are
another clock's: the stream begins anew (restarts), unknown until it has settled, while a request
goes on. A line that its consumer does not take is dropped (edge_runtime/sinks.py) and counts:
nobody who reads too slowly delays an answer to anybody else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from edge_runtime.contract import BoolArray, CommandLink, FloatArray, Prediction, Sample, Unit
from edge_runtime.monitor import GripMonitor
from edge_runtime.tare import Tare

STAGES = ("read", "convert", "step", "decide", "emit")
REMEMBERED = 1 << 16
"""Latencies of so many last samples are kept for the summary."""
PERCENTS = (50.0, 99.0, 99.9)
ANOTHER_CLOCK_NS = 1_000_000_000
"""No reading is under way for so long: stamps further back come from a clock that was set, or that
wrapped."""


@dataclass(frozen=True)
class Measured:
    """One reading of a source: values [C] in its unit, valid [S], why [S] not ("" where valid)."""

    t_ns: int
    values: FloatArray
    valid: BoolArray
    why: tuple[str, ...] = ()


class Source(Protocol):
    """A hand that can be read now: a driver's, or a recording that pretends."""

    unit: Unit
    n_channels: int
    rate_hz: float | None
    """Of a recording; None where the reader decides."""

    def read(self) -> Measured | None:
        """The newest reading; None where there will be no more."""
        ...

    def close(self) -> None:
        """Give it back."""
        ...


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
    """What a run did: samples by state, what was lost and why, acts, and microseconds by stage of
    the last samples."""

    samples: int = 0
    overruns: int = 0
    acts: int = 0
    too_old: int = 0
    """Answers that were older than two periods, and so unknown."""
    repeated: int = 0
    late: int = 0
    restarts: int = 0
    dropped: int = 0
    """Lines that a consumer did not take."""
    lost_sinks: dict[str, str] = field(default_factory=dict)
    """Why a consumer failed and got no more lines, by its name."""
    states: dict[str, int] = field(default_factory=dict)
    stage_us: npt.NDArray[np.float32] = field(
        default_factory=lambda: np.zeros((REMEMBERED, len(STAGES)), dtype=np.float32)
    )

    def note(self, prediction: Prediction, acted_before: bool, times_ns: list[int]) -> None:
        """One sample; times_ns: when it was due to be read, then the end of every stage."""
        self.stage_us[self.samples % REMEMBERED] = np.diff(times_ns) / 1e3
        self.samples += 1
        self.states[prediction.state] = self.states.get(prediction.state, 0) + 1
        self.acts += prediction.act and not acted_before
        self.too_old += prediction.late

    def latency_us(self) -> dict[str, dict[str, float]]:
        """Stage, and "read to emit" -> p50, p99, p99.9 in us."""
        kept = self.stage_us[: min(self.samples, REMEMBERED)].astype(np.float64)
        if not len(kept):
            return {}
        whole = np.column_stack([kept, kept.sum(axis=1)])
        return {
            name: {f"p{percent:g}": _percentile(whole[:, k], percent) for percent in PERCENTS}
            for k, name in enumerate((*STAGES, "read to emit"))
        }

    def to_json(self) -> dict[str, Any]:
        """As a JSON object."""
        told = {
            "samples": self.samples,
            "overruns": self.overruns,
            "acts": self.acts,
            "states": self.states,
        }
        return {
            **told,
            **self.lost(),
            "lost_sinks": self.lost_sinks,
            "latency_us": self.latency_us(),
        }

    def lost(self) -> dict[str, int]:
        """What else went wrong, by its name above."""
        return {
            name: getattr(self, name)
            for name in ("repeated", "late", "restarts", "too_old", "dropped")
        }


def _percentile(values: FloatArray, percent: float) -> float:
    """As numpy.percentile, whose first call imports numpy.ma: 0.1 s, of the second in which SIGTERM
    ends a run."""
    return float(
        np.interp(percent / 100.0 * (len(values) - 1), np.arange(len(values)), np.sort(values))
    )


class Stamps:
    """Whether a reading is a new one, by its source's stamps, and what time its sample is given."""

    def __init__(self, period_ns: float) -> None:
        self._period_ns = round(period_ns)
        self._newest_ns: int | None = None
        self._given_ns = 0

    def judge(self, t_ns: int) -> tuple[str, int]:
        """("", "repeated", "late" or "restarts"; time of the sample, which never runs backwards but
        at a restart)."""
        newest_ns = self._newest_ns
        if newest_ns is None or t_ns < newest_ns - ANOTHER_CLOCK_NS:
            self._newest_ns = self._given_ns = t_ns
            return ("" if newest_ns is None else "restarts"), t_ns
        if t_ns <= newest_ns:
            self._given_ns += self._period_ns
            return ("repeated" if t_ns == newest_ns else "late"), self._given_ns
        self._newest_ns, self._given_ns = t_ns, max(t_ns, self._given_ns + 1)
        return "", self._given_ns


@dataclass(frozen=True)
class Command:
    """What the user commands at a sample: opening ends an act and prevents one, override ends every
    request for long.

    link: whether commands come at all, and still.
    """

    opening: bool = False
    override: bool = False
    link: CommandLink = "none"


def run_live(
    source: Source,
    monitor: GripMonitor,
    tare: Tare,
    clock: Clock,
    emit: Callable[[Prediction, Sample, Measured], int | None],
    *,
    stopped: Callable[[], bool],
    command: Callable[[], Command] = Command,
) -> Summary:
    """Read, answer and emit until stopped, or until the source ends. Raises what the source and
    emit raise.

    emit returns how many lines were dropped, where it counts them.
    """
    summary, period_ns = Summary(), 1e9 / (source.rate_hz or monitor.card.rate_hz)
    stamps, start_ns, turn, acted = Stamps(period_ns), clock.now_ns(), 0, False
    while not stopped():
        clock.wait_until(start_ns + round(turn * period_ns))
        began_ns = clock.now_ns()
        measured = source.read()
        if measured is None:
            break
        read_ns = clock.now_ns()
        trouble, t_ns = stamps.judge(measured.t_ns)
        if trouble == "restarts":
            monitor.lose_track()
        if trouble:
            setattr(summary, trouble, getattr(summary, trouble) + 1)
        lost = trouble in ("repeated", "late")
        values, valid = tare.prepare(
            measured.values, np.zeros_like(measured.valid) if lost else measured.valid
        )
        sample = Sample(t_ns, values, valid, turn)
        converted_ns = clock.now_ns()
        told = command()
        prediction = monitor.feed(
            sample, opening=told.opening, override=told.override, commands=told.link
        )
        summary.dropped += emit(prediction, sample, measured) or 0
        times = [
            began_ns,
            read_ns,
            converted_ns,
            monitor.stepped_ns,
            prediction.t_decided_ns,
            clock.now_ns(),
        ]
        summary.note(prediction, acted, times)
        acted = prediction.act
        turn += 1
        missed = int((clock.now_ns() - start_ns) / period_ns) - turn
        if missed > 0:
            summary.overruns += missed
            turn += missed
    return summary
