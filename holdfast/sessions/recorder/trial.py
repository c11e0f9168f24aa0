"""One trial while it is recorded: its samples, its events, its meta.json, and its quality.

The quality of a recording: rate, jitter, lost samples, saturation, drift of the bias.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from holdfast.core.contract import FloatArray, IntArray, Json, channel_names
from holdfast.core.errors import DataError, HoldfastError
from holdfast.core.hand_card import HandCard, leave_empty
from holdfast.core.source import SourceReading
from holdfast.core.tactile_file import TactileFile
from holdfast.core.trial_layout import EVENTS, TACTILE, intent_path
from holdfast.edge_runtime.wearer import INTENT_HEADER, IntentMonitor, intent_row
from holdfast.sessions.recorder.folder import (
    FORMAT,
    INTERRUPTED,
    KEPT,
    RECORDING,
    write_meta,
    written,
)
from holdfast.sessions.recorder.labels import BY, truth_in, write_truth

REST_S = 0.3
"""Time at the start of a trial over which its bias is measured."""


@dataclass(frozen=True)
class QualityFigures:
    """Figures of a trial; None with too few samples. rate_hz: of the median step.

    jitter_p99_ms: 99 % of the distances from whole periods. why: reason -> readings. bias_drift:
    largest change of a resting channel since the bias was measured, in `unit`.
    """

    samples: int
    seconds: float
    rate_hz: float | None
    jitter_p99_ms: float | None
    lost: int
    invalid_readings: int
    saturated_readings: int
    why: dict[str, int]
    bias_drift: float | None
    bias_drift_channel: str | None
    unit: str

    def in_words(self) -> str:
        """One line for the operator."""
        # A rate needs two samples.
        if self.rate_hz is None or self.jitter_p99_ms is None:
            return f"too few samples for a rate ({self.samples})"

        drift = "not known"
        if self.bias_drift is not None:
            drift = f"{self.bias_drift:g} {self.unit} ({self.bias_drift_channel})"
        return (
            f"{self.seconds:g} s, {self.rate_hz:.2f} Hz, "
            f"jitter p99 {self.jitter_p99_ms:.2f} ms, {self.lost} lost, "
            f"{self.invalid_readings} invalid, {self.saturated_readings} saturated, "
            f"bias drift {drift}"
        )


@dataclass
class Quality:
    """Counts of the samples so far; bias [C]: measured before; period_ns: the period wanted."""

    bias: FloatArray
    period_ns: float
    unit: str
    lost: int = 0
    why: Counter[str] = field(default_factory=Counter)
    invalid: int = 0
    times_ns: list[int] = field(default_factory=list)
    rest: list[FloatArray] = field(default_factory=list)

    def take(self, t_ns: int, measured: SourceReading) -> None:
        """One sample that was written."""
        self.times_ns.append(t_ns)
        self.why.update(reason for reason in measured.why if reason)
        self.invalid += int(np.count_nonzero(~measured.valid))
        # Before the hand closes, a channel that moved since the bias shows its drift.
        spent_ns = t_ns - self.times_ns[0]
        if spent_ns < 1e9 * REST_S:
            valid = np.repeat(measured.valid, 3)
            self.rest.append(np.where(valid, measured.values, np.nan))

    def figures(self) -> QualityFigures:
        """Figures of the whole trial."""
        times_ns: IntArray = np.array(self.times_ns, dtype=np.int64)
        steps = times_ns[1:] - times_ns[:-1]
        rate_hz = None
        jitter_ms = None
        if len(steps):
            rate_hz = round(1e9 / float(np.median(steps)), 3)
            # A lost sample is no jitter: the distance is from the nearest whole period.
            periods = np.maximum(1, np.round(steps / self.period_ns))
            late_ms = 1e-6 * np.abs(steps - self.period_ns * periods)
            jitter_ms = round(float(np.percentile(late_ms, 99)), 3)

        drift, channel = self._drift()
        return QualityFigures(
            samples=len(self.times_ns),
            seconds=round(1e-9 * float(steps.sum()), 3),
            rate_hz=rate_hz,
            jitter_p99_ms=jitter_ms,
            lost=self.lost,
            invalid_readings=self.invalid,
            saturated_readings=self.why["saturated"],
            why=dict(sorted(self.why.items())),
            bias_drift=drift,
            bias_drift_channel=channel,
            unit=self.unit,
        )

    def _drift(self) -> tuple[float | None, str | None]:
        """(largest change of a resting channel since the bias was measured, its name)."""
        rows = np.ma.masked_invalid(np.reshape(self.rest, (-1, len(self.bias))))
        # The median, so that a single touch at the start is no drift.
        change = np.abs(np.ma.median(rows, axis=0) - np.ma.masked_invalid(self.bias))
        # A channel that was lost at rest, or had no bias, has no drift.
        if not change.count():
            return None, None
        worst = int(change.argmax())
        name = channel_names(len(self.bias) // 3)[worst]
        return round(float(change[worst]), 4), name


@dataclass(frozen=True)
class ClosedTrial:
    """How a trial ended. state: as in meta.json. why: of an interrupted trial, else empty."""

    quality: QualityFigures
    state: str
    why: str


class TrialRecorder:
    """Writes one trial's folder; about: content of meta.json besides state and quality.

    hand: its card; nan is written for what it does not measure.
    """

    def __init__(
        self,
        folder: Path,
        n_channels: int,
        about: Json,
        quality: Quality,
        host_after_ns: int,
        intent: IntentMonitor | None = None,
        hand: HandCard | None = None,
    ) -> None:
        self._hand = hand
        self.folder = folder
        self.about = about
        self.quality = quality
        self.intent = intent
        self._host_after_ns = host_after_ns
        self.t_s = 0.0
        # First of all, so that a trial that is killed before its first sample can be told.
        self._write_meta(RECORDING)
        self._file = TactileFile(folder / TACTILE, n_channels)
        # Line by line: what the operator marked is on the disk when the next sample comes.
        self._events = (folder / EVENTS).open("a", encoding="utf-8", buffering=1)
        self._intent_file: TextIO | None = None
        if intent is not None:
            path = intent_path(folder / TACTILE)
            self._intent_file = path.open("x", encoding="utf-8", buffering=1)
            _write_line(self._intent_file, INTENT_HEADER)

    @property
    def started(self) -> bool:
        """Whether there is a sample."""
        return self._file.rows > 0

    @property
    def span_ns(self) -> tuple[int, int]:
        """Times of the first and the last sample on the recorder's clock."""
        return self.quality.times_ns[0], self.quality.times_ns[-1]

    def write(self, t_ns: int, sequence: int, measured: SourceReading) -> None:
        """Write one sample. Raises OutputError."""
        # A camera stamps its frames with the host's clock; so both can be joined later.
        host_ns = t_ns + self._host_after_ns
        values = leave_empty(measured.values, self._hand)
        self.t_s = self._file.write(t_ns, host_ns, sequence, values, measured.valid)
        self.quality.take(t_ns, measured)

    def write_intent(self) -> None:
        """Look at the wearer's command, and write what came. Raises OutputError."""
        if self.intent is None or self._intent_file is None:
            return
        self.intent.look()
        # Times are from the first sample: before it there is none to count from.
        if self.started:
            first_ns = self.span_ns[0]
            for item in self.intent.fresh:
                row = intent_row(item, first_ns, self._host_after_ns)
                _write_line(self._intent_file, row)

    def mark(self, name: str, now_ns: int) -> float:
        """Note that the operator marked an event now; returns its time from the first sample, s."""
        at_s = round(1e-9 * (now_ns - self.span_ns[0]), 6)
        self.note({"t_s": at_s, "mark": name, "provenance": "key", "by": BY})
        return at_s

    def note(self, event: Json) -> None:
        """Write a line of events.jsonl. Raises OutputError."""
        _write_line(self._events, json.dumps(event))

    def close(
        self, state: str, over: str = "", *, why: str = "", camera: Json | None = None
    ) -> ClosedTrial:
        """Flush everything, write meta.json and, of a kept trial, its phases.

        over: why the samples ended, if not by the operator. Such a trial is interrupted, not kept,
        if it is incomplete; so is one that cannot be read again (a single row, most of it lost).
        why: of the state. camera: what the camera's process left. Raises OutputError.
        """
        figures = self.quality.figures()
        # Before meta.json says how it ended, the samples are on the disk.
        self._close_files()
        if state == KEPT:
            why = self._label(over)
            state = INTERRUPTED if why else KEPT
        # What meta.json says beyond the run's own description.
        more: Json = {"quality": asdict(figures)}
        if camera:
            more["camera"] = camera
        if why:
            more["why"] = why
        self._write_meta(state, **more)
        return ClosedTrial(figures, state, why)

    def _close_files(self) -> None:
        """Flush and close them; nothing where that was tried before. Raises OutputError."""
        if self._events.closed:
            return
        with ExitStack() as files:
            files.callback(self._events.close)
            if self._intent_file is not None:
                files.callback(self._intent_file.close)
            self._file.close()
            # The marks are labels: they must survive a power cut as the samples do.
            os.fsync(self._events.fileno())

    def _label(self, over: str) -> str:
        """Write the phases of a trial to keep; returns why it cannot be kept, or nothing."""
        unfinished = f"{over} before the trial was complete"
        try:
            # Read from the disk, as training will: what cannot be read there cannot be kept.
            truth = truth_in(self.folder)
        except DataError as error:
            return unfinished if over else str(error)
        if over and not truth.is_complete(self.about["action"]):
            return unfinished
        write_truth(self.folder, truth)
        return ""

    def give_up(self, why: str) -> None:
        """Close as interrupted as far as possible after an error, which the caller raises."""
        with suppress(HoldfastError, OSError):
            if not self._events.closed:  # the error may have come after they were
                self.note({"t_s": self.t_s, "event": INTERRUPTED, "why": why})
        with suppress(HoldfastError, OSError):
            self.close(INTERRUPTED, why=why)

    def _write_meta(self, state: str, **more: Any) -> None:
        meta = {"recorder": FORMAT, "state": state, **self.about, **more}
        write_meta(self.folder, meta)


def _write_line(file: TextIO, line: str) -> None:
    """Write a line. Raises OutputError."""
    with written(Path(file.name)):
        file.write(line + "\n")
