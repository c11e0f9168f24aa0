"""The rows of a log by a map: samples in the model's unit, a trial of them, and its phases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holdfast.core.column_map import NS_OF, ColumnMap
from holdfast.core.contract import FloatArray, IntArray, channel_names
from holdfast.core.errors import ColumnError, EmptyRecording, LabelError, TimeError
from holdfast.core.trial_file import TIME_COLUMN, Trial, implausible_rate, trial_of
from holdfast.interop.events import FOR_EVER_NS, Event, at_event
from holdfast.interop.import_map import ImportMap
from holdfast.interop.logs.log import Columns, ForeignLog, text_cells
from holdfast.training.datasets.thesis import prepared
from holdfast.training.timeline import contact


@dataclass(frozen=True)
class Phase:
    """[t0_s, t1_s) from the first row of a trial, in a situation."""

    t0_s: float
    t1_s: float
    label: str


@dataclass(frozen=True)
class Cut:
    """Rows [first, stop) of a log that are a trial. key: how events name it."""

    first: int
    stop: int
    key: str = ""
    action_word: str = ""


@dataclass(frozen=True)
class LogRows:
    """A log by the map: stamps [T] ns on its clock, values [T, C] in the model's unit."""

    log: ForeignLog
    table: Columns
    stamps: IntArray
    values: FloatArray


def _with_rest(
    phases: Sequence[Phase], trial: Trial, rest: str, columns: ColumnMap
) -> list[Phase]:
    """The phases, and `rest` between them while the hand is closed on something."""
    samples = prepared(trial, columns.unit_of_values, "").samples
    first, stop = contact(trial.t_s, samples)
    at_s, end_s = (
        float(trial.t_s[first]),
        float(trial.t_s[stop - 1]) + 1 / trial.rate_hz,
    )
    whole: list[Phase] = []
    for phase in phases:
        if phase.t0_s > at_s:
            whole.append(Phase(at_s, min(phase.t0_s, end_s), rest))
        whole.append(phase)
        at_s = max(at_s, phase.t1_s)
    if at_s < end_s:
        whole.append(Phase(at_s, end_s, rest))
    return [phase for phase in whole if phase.t1_s > phase.t0_s]


def by_map(log: ForeignLog, plan: ImportMap) -> LogRows:
    """The samples of a log. Raises ColumnError or NotANumber."""
    columns, rules = plan.columns, plan.trials
    wanted = {*columns.columns, *rules.columns.values()}
    if rules.by == "column":
        wanted.add(rules.column)
    # labels of a topic of their own are not joined to the samples
    if plan.events is not None and plan.events.column and not log.stamped:
        wanted.add(plan.events.column)
    table = log.table(wanted)
    values = columns.values_of(table, log.path)
    stamps = columns.stamps_ns(table, len(values), log.path)
    return LogRows(log, table, stamps, values)


def checked(rows: LogRows, cut: Cut, columns: ColumnMap, where: Path) -> Trial:
    """The trial of a cut, checked as a file of its own is. Raises EmptyRecording or TimeError."""
    stamps = rows.stamps[cut.first : cut.stop]
    if not len(stamps):
        raise EmptyRecording("no row of the log lies in it", where=where)
    t_s = 1e-9 * (stamps - stamps[0])
    values = np.where(np.isfinite(rows.values), rows.values, np.nan)
    table = np.column_stack([t_s, values[cut.first : cut.stop]])
    header = [TIME_COLUMN, *channel_names(len(columns.sensors))]
    at = rows.log.first_line + cut.first
    _require_time(t_s, columns, where)
    return trial_of(header, table, where, lambda row: f"row {at + row}")


def _require_time(t_s: FloatArray, columns: ColumnMap, where: Path) -> None:
    """Raise TimeError for a rate that no hand has, by what it looks like.

    A time without a unit is also one that makes a trial longer than an hour.
    """
    steps = np.diff(t_s)
    if not len(steps) or not np.median(steps) > 0.0:
        return
    rate_hz = 1.0 / float(np.median(steps))
    time = columns.time
    if time.unit is None and time.rate_hz is None:
        wrong = implausible_rate(rate_hz, float(t_s[-1]))
        said = "time.unit of no column"
    else:
        wrong = implausible_rate(rate_hz) and f"runs at {rate_hz:.4g} Hz"
        said = f"time.rate_hz = {time.rate_hz}"
    if wrong and time.unit is not None:
        said = f'time.unit = "{time.unit}"'
        for unit, unit_ns in NS_OF.items():
            then_hz = rate_hz * time.unit_ns / unit_ns
            if not implausible_rate(then_hz):
                wrong += f' (with unit = "{unit}": {then_hz:.4g} Hz)'
    if wrong:
        raise TimeError(
            f"{wrong}; the map gives {said}",
            where=where,
            next_step='write unit = "ms" (or s, us, ns), or the true rate_hz, to [time] of the map',
        )


def texts_of(table: Columns, name: str, key: str, path: Path) -> list[str]:
    """The cells of a column that the map names. Raises ColumnError."""
    if name not in table:
        raise ColumnError(
            f"no column {name} ({key})", where=path, next_step="correct the column map"
        )
    return text_cells(table[name])


def phases_of(
    plan: ImportMap,
    events: Sequence[Event],
    trial: Trial,
    begin: int,
    skipped: str,
    path: Path,
) -> tuple[Phase, ...]:
    """The phases of a trial by its events, and what a closed hand does outside them.

    begin: the trial's first stamp, ns. skipped: the label of the event that is the trial itself.
    path: what errors name. Raises LabelError.
    """
    rules = plan.events
    assert rules is not None
    lasts_s = float(trial.t_s[-1]) + 1.0 / trial.rate_hz
    phases: list[Phase] = []
    for event in events:
        t0_s = max(0.0, 1e-9 * (event.start - begin))
        t1_s = min(lasts_s, 1e-9 * (min(event.end, FOR_EVER_NS) - begin))
        if t1_s <= t0_s or (skipped and event.label == skipped):
            continue
        situation = rules.situation or plan.situation(event.label)
        if situation is None:
            unknown = LabelError(
                f"the label {event.label!r:.60} is no situation (events.labels)",
                next_step=f'add "{event.label:.60}" = .. to [events.labels] of the map: a '
                'situation, or "" for none',
            )
            raise at_event(unknown, path, event)
        if situation and phases and phases[-1].t1_s > t0_s + 1e-9:
            overlap = LabelError(
                f"{event.label!r:.60} begins at {t0_s:.3f} s, before the event above ends",
                next_step='correct one of them, or map one label to ""',
            )
            raise at_event(overlap, path, event)
        if situation:
            phases.append(Phase(t0_s, t1_s, situation))
    if rules.rest:
        phases = _with_rest(phases, trial, rules.rest, plan.columns)
    return tuple(phases)
