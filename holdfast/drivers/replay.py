"""A recorded trial as a source: the same samples, at the times they were recorded at.

A recording replayed in real time: each row comes at the time at which it was recorded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from holdfast.core.contract import (
    BoolArray,
    FloatArray,
    IntArray,
    Sample,
    Unit,
    averaged_by,
    averaged_in_words,
)
from holdfast.core.errors import DataNotFound, UnitError
from holdfast.core.hand_card import HandCard, hand_card_near
from holdfast.core.schema import read
from holdfast.core.source import SelfPacedSource, Source, SourceReading
from holdfast.core.trial_file import Zero, block_means, read_trial
from holdfast.core.trial_layout import TACTILE
from holdfast.edge_runtime.preparation import Preparation

META = "meta.json"
DEFAULT_UNIT: Unit = "N"
"""As in the thesis."""
META_LEVELS = 3
"""A meta.json is in the trial's folder, or this many folders up (<set>/<object>/<action>/)."""


class TrialMeta(msgspec.Struct, frozen=True):
    """What a replay takes of a meta.json."""

    unit: Unit | None = None


@dataclass(frozen=True)
class Replay:
    """A recorded stream: t_ns [T] from zero, values [T, C], valid [T, C/3], one rate, one unit.

    zero: what was removed from its values already, None for nothing. rows: which rows are samples;
    the others were lost, None for all. hand: its card, None where none lies beside it.
    """

    t_ns: np.ndarray[tuple[int], np.dtype[np.int64]]
    values: FloatArray
    valid: BoolArray
    rate_hz: float
    unit: Unit
    zero: Zero | None = None
    rows: IntArray | None = None
    hand: HandCard | None = None

    def prepared(self, preparation: Preparation) -> Replay:
        """The same stream with its bias removed, as the model's card says."""
        if self.zero is not None:
            return self
        values = preparation.apply(self.values, self.valid)
        return replace(self, values=values, zero="first samples")

    def at_rate(self, rate_hz: float, report: Callable[[str], object]) -> Replay:
        """The same stream, averaged where a whole number of its samples makes one of a rate.

        report: receives what was done.
        """
        n = averaged_by(self.rate_hz, rate_hz)
        if n < 2:
            return self
        report(averaged_in_words(self.rate_hz, n))
        t_ns, values, valid = block_means(self.t_ns, self.values, self.valid, n)
        of_n = replace(self, t_ns=t_ns, values=values, valid=valid, rows=None)
        return replace(of_n, rate_hz=self.rate_hz / n)

    def __iter__(self) -> Iterator[Sample]:
        """Every sample in turn, without waiting."""
        rows = range(len(self.values)) if self.rows is None else self.rows.tolist()
        for row in rows:
            yield Sample(int(self.t_ns[row]), self.values[row], self.valid[row], row)


def open_replay(path: str | Path) -> Replay:
    """Open a trial's CSV file, or a trial folder that holds tactile.csv. Raises a DataError."""
    path = Path(path)
    file = path / TACTILE if path.is_dir() else path
    if path.is_dir() and not file.is_file():
        raise DataNotFound(
            f"no {TACTILE} in this folder",
            where=path,
            next_step="name a trial's CSV file",
        )
    hand = hand_card_near(file)
    trial = read_trial(file, hand)
    # whole nanoseconds, as a live source has them
    t_ns = np.round(trial.t_s * 1e9).astype(np.int64)
    unit = trial.unit
    for folder in list(file.resolve().parents)[: META_LEVELS + 1]:
        unit = unit or _meta(folder / META).unit
    return Replay(
        t_ns,
        trial.raw,
        trial.valid,
        trial.rate_hz,
        unit or DEFAULT_UNIT,
        trial.zero,
        trial.rows,
        hand,
    )


def _meta(path: Path) -> TrialMeta:
    """Of a trial, a set, or a folder between; without a file it says nothing. Raises UnitError."""
    try:
        return read(path, TrialMeta, UnitError)
    except FileNotFoundError:
        return TrialMeta()


class PacedReplay:
    """A stream [T] as a live source. A late reader gets the newest row, as it would on a hand."""

    def __init__(self, replay: Replay, now_ns: Callable[[], int]) -> None:
        self.replay = replay
        self.now_ns = now_ns
        self._start_ns: int | None = None
        self.unit: Unit = replay.unit
        self.n_channels = replay.values.shape[1]
        self.rate_hz: float | None = replay.rate_hz
        self.zero = replay.zero
        self.hand = replay.hand

    def read(self) -> SourceReading | None:
        """The row whose time has come; None after the last."""
        now_ns = self.now_ns()
        if self._start_ns is None:
            self._start_ns = now_ns
        # by its own rate: recorded stamps jitter, and the reader expects steady rows
        row = round((now_ns - self._start_ns) * 1e-9 * self.replay.rate_hz)
        if row >= len(self.replay.values):
            return None
        return SourceReading(now_ns, self.replay.values[row], self.replay.valid[row])

    def begin_anew(self) -> None:
        """The next reading is the first row again."""
        self._start_ns = None

    def close(self) -> None:
        """Nothing is open."""


class AveragedSource(SelfPacedSource):
    """Every n samples of a source that paces itself, as one at the time of the last."""

    def __init__(self, source: Source, n: int) -> None:
        self._source = source
        self._n = n
        self.unit = source.unit
        self.n_channels = source.n_channels
        self.zero = zero_of(source)
        self.hand = hand_of(source)
        rate_hz = source.rate_hz
        self.rate_hz: float | None = None if rate_hz is None else rate_hz / n

    def read(self) -> SourceReading | None:
        """The mean of the next samples; None where the source has ended."""
        readings = []
        for _ in range(self._n):
            reading = self._source.read()
            if reading is None:
                return None
            readings.append(reading)
        times_ns = np.array([one.t_ns for one in readings], dtype=np.int64)
        values = np.stack([one.values for one in readings])
        valid = np.stack([one.valid for one in readings])
        t_ns, mean, usable = block_means(times_ns, values, valid, self._n)
        why = next((one.why for one in readings if not one.valid.all()), ())
        return SourceReading(int(t_ns[0]), mean[0], usable[0], why)

    def close(self) -> None:
        self._source.close()


def at_rate(source: Source, rate_hz: float, report: Callable[[str], object]) -> Source:
    """A source, averaged where a whole number of its samples makes one of a model's rate."""
    if source.rate_hz is None:
        return source
    if isinstance(source, PacedReplay):
        averaged = source.replay.at_rate(rate_hz, report)
        return PacedReplay(averaged, source.now_ns)
    n = averaged_by(source.rate_hz, rate_hz)
    if n < 2 or not isinstance(source, SelfPacedSource):
        return source
    report(averaged_in_words(source.rate_hz, n))
    return AveragedSource(source, n)


def hand_of(source: Source) -> HandCard | None:
    """The hand card of a source, where it has one: of a set, a scene or a column map."""
    hand: HandCard | None = getattr(source, "hand", None)
    return hand


def zero_of(source: Source) -> Zero | None:
    """What was removed from the samples of a source already: a run's own, replayed or as lines."""
    zero: Zero | None = getattr(source, "zero", None)
    return zero
