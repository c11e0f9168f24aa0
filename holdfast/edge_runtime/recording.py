"""A whole recording at once: arrays in, arrays out, with the answers of `GripMonitor.feed`.

A recording brings its own times, so no answer of it is late.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    CLASSES,
    RATE_TOLERANCE,
    UNIT_OF,
    BoolArray,
    FloatArray,
    IntArray,
    Prediction,
    Sample,
    Unit,
)
from holdfast.core.errors import ChannelError, RateError, TimeError, UnitError
from holdfast.edge_runtime.model_file import ModelCard

TextArray = npt.NDArray[np.str_]
LATEST_S = 9e9
"""A stamp in whole nanoseconds fits in 64 bits up to here; Unix times are far below."""
WHERE = "replay"


@dataclass(frozen=True)
class Answers:
    """The answers at T samples of a recording, one array a quantity; the order is that of time.

    t_s: [T] as given. values: [T, C] as the model saw them: without bias, in `unit`. valid:
    [T, C/3]. state, why, weight: [T] of text, as in Prediction; weight is "" where it is None.
    p_situation: [T, 4], columns as in core.contract.SITUATIONS. p_class: [T, 8], columns as in
    CLASSES, NaN where it is None. extra, detectors: [T] by name. The others: [T] as in Prediction.
    """

    t_s: FloatArray
    values: FloatArray
    valid: BoolArray
    unit: Unit
    state: TextArray
    why: TextArray
    p_situation: FloatArray
    p_risky: FloatArray
    p_class: FloatArray
    weight: TextArray
    arm: BoolArray
    act: BoolArray
    settled: BoolArray
    degraded: BoolArray
    extra: dict[str, FloatArray]
    detectors: dict[str, BoolArray]
    model_id: str


@dataclass(frozen=True)
class PreparedRecording:
    """Arrays that a model can be fed with: as in Answers, without bias and in a unit of ours."""

    t_s: FloatArray
    values: FloatArray
    valid: BoolArray
    unit: Unit

    @property
    def rate_hz(self) -> float:
        """The rate of the median step between two rows."""
        return 1.0 / float(np.median(np.diff(self.t_s)))

    def __iter__(self) -> Iterator[Sample]:
        t_ns: IntArray = np.round(self.t_s * 1e9).astype(np.int64)
        for row in range(len(t_ns)):
            yield Sample(int(t_ns[row]), self.values[row], self.valid[row], row)


def prepared_recording(
    card: ModelCard,
    values: npt.ArrayLike,
    t_s: npt.ArrayLike | None,
    *,
    valid: npt.ArrayLike | None,
    unit: str | None,
    bias: npt.ArrayLike | None,
) -> PreparedRecording:
    """The arguments of GripMonitor.replay, checked, in a unit of ours and without bias."""
    raw = _table(values, card)
    times_s = _times(t_s, len(raw), card)
    ours, factor = _unit(unit, card)
    raw = card.filler()(raw)
    usable = _usable(raw, valid)
    raw = raw * factor
    # the first valid rows decide, or one row: what the unloaded hand reads
    if bias is None:
        sign, offset = card.preparation.learn(raw, usable)
    else:
        resting = card.filler()(_resting(bias, card))
        sign, offset = card.preparation.learn(resting[None] * factor)
    recording = PreparedRecording(times_s, raw * sign - offset, usable, ours)
    # times in another unit than seconds: the error names the likely one
    rate_hz = recording.rate_hz
    for name, per_s in (("milliseconds", 1e3), ("microseconds", 1e6)):
        if abs(rate_hz * per_s / card.rate_hz - 1.0) <= RATE_TOLERANCE:
            raise RateError(
                f"t_s gives {rate_hz:.4g} Hz: these times look like {name}, not seconds",
                where=WHERE,
                next_step=f"divide them by {per_s:g}",
            )
    return recording


def _table(values: npt.ArrayLike, card: ModelCard) -> FloatArray:
    """[T, C] of float64. Raises ChannelError."""
    table = np.asarray(values, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != card.n_channels or len(table) < 2:
        raise ChannelError(
            f"values of shape {table.shape}, the model needs [T, {card.n_channels}], T from 2 on",
            where=WHERE,
            cause="a column of times among the values, or rows and columns swapped",
            next_step="pass the channels X1, Y1, Z1, X2, .. alone, one row a sample",
        )
    return table


def _times(t_s: npt.ArrayLike | None, n_rows: int, card: ModelCard) -> FloatArray:
    """[T] in seconds that grow; at the model's rate where none are given. Raises TimeError."""
    if t_s is None:
        return np.arange(n_rows) / card.rate_hz

    times_s = np.asarray(t_s, dtype=np.float64)
    if times_s.shape != (n_rows,):
        raise TimeError(
            f"t_s of shape {times_s.shape} for {n_rows} rows of values",
            where=WHERE,
            next_step="pass one time a row, in seconds",
        )

    inside = np.abs(times_s) < LATEST_S  # False for NaN
    good = inside & np.append(True, np.diff(times_s) > 0.0)
    if not good.all():
        row = int(np.argmin(good))
        next_step = "replay each recording on its own"
        n_equal = int((np.diff(times_s) == 0.0).sum())
        if n_equal:
            next_step = (
                f"{n_equal} rows have the time of the row before: pass finer times, or none for "
                "the model's rate"
            )
        raise TimeError(
            f"t_s stands still, runs backwards or is no number at row {row}",
            where=WHERE,
            next_step=next_step,
        )
    return times_s


def _unit(unit: str | None, card: ModelCard) -> tuple[Unit, float]:
    """(unit of ours, factor to it). Raises UnitError."""
    if unit is None:
        return card.unit, 1.0
    if unit not in UNIT_OF:
        raise UnitError(
            f"unit {unit!r:.40} is not known",
            where=WHERE,
            next_step=f"choose from {', '.join(UNIT_OF)}",
        )
    return UNIT_OF[unit]


def _usable(raw: FloatArray, valid: npt.ArrayLike | None) -> BoolArray:
    """[T, C/3] as given, else where a sensor's reading is finite. Raises ChannelError."""
    numbers = np.isfinite(raw).reshape(len(raw), -1, 3)
    finite: BoolArray = np.asarray(numbers.all(axis=2))
    flags = finite if valid is None else np.asarray(valid, dtype=np.bool_)
    if flags.shape != finite.shape:
        raise ChannelError(
            f"valid of shape {flags.shape}, the values need {finite.shape}",
            where=WHERE,
            next_step="pass one flag a sensor and row",
        )
    return flags


def _resting(bias: npt.ArrayLike, card: ModelCard) -> FloatArray:
    """[C] what the unloaded hand reads. Raises ChannelError."""
    resting = np.asarray(bias, dtype=np.float64)
    if resting.shape not in ((), (card.n_channels,)) or not np.isfinite(resting).all():
        raise ChannelError(
            f"bias of shape {resting.shape}, the model needs [{card.n_channels}] finite numbers",
            where=WHERE,
            next_step="pass what the unloaded hand reads, or 0 where it is removed already",
        )
    return np.broadcast_to(resting, (card.n_channels,))


def answers_of(recording: PreparedRecording, predictions: list[Prediction]) -> Answers:
    """One array a quantity. predictions: of all samples of the recording."""

    def column(name: str) -> Any:
        return np.array([getattr(one, name) for one in predictions])

    def of_names(name: str) -> dict[str, Any]:
        tables = [getattr(one, name) for one in predictions]
        return {key: np.array([table[key] for table in tables]) for key in tables[0]}

    unknown = dict.fromkeys(CLASSES, np.nan)
    p_class = [list((one.p_class or unknown).values()) for one in predictions]

    return Answers(
        t_s=recording.t_s,
        values=recording.values,
        valid=recording.valid,
        unit=recording.unit,
        state=column("state"),
        why=column("why"),
        p_situation=np.array([list(one.p_situation.values()) for one in predictions]),
        p_risky=column("p_risky"),
        p_class=np.array(p_class),
        weight=np.array([one.weight or "" for one in predictions]),
        arm=column("arm"),
        act=column("act"),
        settled=column("settled"),
        degraded=column("degraded"),
        extra=of_names("extra"),
        detectors=of_names("detectors"),
        model_id=predictions[0].model_id,
    )
