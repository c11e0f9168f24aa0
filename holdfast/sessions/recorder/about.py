"""What the meta.json of every trial of a run says, besides its state and quality.

The quality of a recording: rate, jitter, lost samples, saturation, drift of the bias.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import platform
from collections import Counter
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray, channel_names
from holdfast.core.reading import Json
from holdfast.core.source import Source, SourceReading
from holdfast.drivers.calibration import read_calibration
from holdfast.drivers.hand import LiveHand
from holdfast.live.bias import MeasuredBias
from holdfast.sessions.recorder.plan import Plan


def about(
    args: argparse.Namespace,
    source: Source,
    measured: MeasuredBias,
    plan: Plan,
    rate_hz: float,
    *,
    real_time: bool,
) -> Json:
    """A JSON object; of paths only the last part, because folders can name people."""
    configuration = {
        name: _plain(value)
        for name, value in vars(args).items()
        if name not in ("person", "object", "action")
    }
    return {
        "unit": source.unit,
        "rate_hz": rate_hz,
        "hand": source.about() if isinstance(source, LiveHand) else None,
        "calibration": _calibration(args.calibration),
        "bias": _bias(measured),
        "protocol": _protocol(plan, args.seed),
        "versions": {
            **{name: version(name) for name in ("holdfast", "numpy")},
            "python": platform.python_version(),
            "machine": platform.machine(),
        },
        "real_time_priority": real_time,
        "configuration": configuration,
    }


def _bias(measured: MeasuredBias) -> Json:
    bias = measured.bias
    return {
        "values": bias.values.tolist(),
        "spread": bias.spread.tolist(),
        "n": bias.n,
        "unit": bias.unit,
        "reversed": bias.reversed.tolist(),
        "warnings": list(measured.warnings),
        "good": measured.good,
    }


def _protocol(plan: Plan, seed: int) -> Json | None:
    card = plan.protocol
    if card is None:
        return None
    return {
        "card": card.name,
        "sha256": card.sha256,
        "seed": seed,
        "done_before": plan.done,
    }


def _calibration(path: Path | None) -> Json | None:
    if path is None:
        return None
    meta = read_calibration(path).meta
    return {
        "file": path.name,
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "source": meta.source,
        "date": meta.date,
        "n": meta.n,
        "content": json.loads(path.read_text("utf-8")),
    }


def _plain(value: Any) -> Any:
    """A path, or a URL with paths, without the folders."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, str) and "/" in value:
        scheme, mark, name = value.rpartition("://")
        return f"{scheme}{mark}{'&'.join(_last(part) for part in name.split('&'))}"
    return value


def _last(part: str) -> str:
    key, mark, path = part.rpartition("=")
    head, question, key = key.rpartition("?")
    return f"{head.rpartition('/')[2]}{question}{key}{mark}{path.rpartition('/')[2]}"


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
        self.why.update(word for word in measured.why if word)
        self.invalid += int(np.size(measured.valid) - np.count_nonzero(measured.valid))
        if t_ns - self.times_ns[0] < 1e9 * REST_S:
            self.rest.append(
                np.where(np.repeat(measured.valid, 3), measured.values, np.nan)
            )

    def figures(self) -> QualityFigures:
        """Figures of the whole trial."""
        times = np.array(self.times_ns, dtype=np.int64)
        steps = np.diff(times)
        late_ms = 1e-6 * np.abs(
            steps - self.period_ns * np.maximum(1, np.round(steps / self.period_ns))
        )
        drift, channel = self._drift()
        return QualityFigures(
            samples=len(times),
            seconds=round(1e-9 * float(times[-1] - times[0]), 3) if len(times) else 0.0,
            rate_hz=round(1e9 / float(np.median(steps)), 3) if len(steps) else None,
            jitter_p99_ms=round(float(np.percentile(late_ms, 99)), 3)
            if len(steps)
            else None,
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
        rows = np.array(self.rest).reshape(-1, len(self.bias))
        known = np.isfinite(rows).any(axis=0) & np.isfinite(self.bias)
        if not known.any():
            return None, None
        change = np.abs(np.nanmedian(rows[:, known], axis=0) - self.bias[known])
        worst = int(np.argmax(change))
        return round(float(change[worst]), 4), channel_names(len(self.bias) // 3)[
            int(np.flatnonzero(known)[worst])
        ]


def in_words(of: QualityFigures) -> str:
    """One line for the operator."""
    if of.rate_hz is None or of.jitter_p99_ms is None:
        return f"too few samples for a rate ({of.samples})"
    drift = "not known"
    if of.bias_drift is not None:
        drift = f"{of.bias_drift:g} {of.unit} ({of.bias_drift_channel})"
    return (
        f"{of.seconds:g} s, {of.rate_hz:.2f} Hz, jitter p99 {of.jitter_p99_ms:.2f} ms, "
        f"{of.lost} lost, {of.invalid_readings} invalid, {of.saturated_readings} saturated, "
        f"bias drift {drift}"
    )
