"""Events of a log as intervals: from a table beside it, or from a column of labels.

All times become ns from the log's first row. An event without an end lasts to the next one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import IntArray
from holdfast.core.errors import (
    ColumnError,
    DataError,
    DataNotFound,
    LabelError,
    NotANumber,
    listed,
)
from holdfast.interop.import_map import ROW, EventRules
from holdfast.interop.logs.find import LogPlace, find_logs, read_log
from holdfast.interop.logs.layout import TableFormat
from holdfast.interop.logs.log import (
    LOG_TIME,
    Column,
    Columns,
    ForeignLog,
    is_text,
    text_cells,
)

FOR_EVER_NS = 1 << 61
"""The end of a last event without one."""


@dataclass(frozen=True)
class Event:
    """[start, end) in units of the table, or ns; label: as the table has it.

    trial: what it says of the log or trial it belongs to; "" for all. line: of the table, 0 for
    none.
    """

    start: float
    end: float
    label: str
    trial: str = ""
    line: int = 0


class EventTables:
    """The tables of events of a source, each read once."""

    def __init__(self, rules: EventRules, source: Path, form: TableFormat) -> None:
        self.rules = rules
        self._root = source if source.is_dir() else source.parent
        self._form = TableFormat(
            form.separator,
            form.decimal,
            form.comment,
            form.encoding,
            rules.sheet or None,
        )
        self._read: dict[Path, list[Event]] = {}
        self._known: set[str] = set()
        self._met: set[tuple[Path, int]] = set()
        self._missed: dict[tuple[Path, int], tuple[Event, str]] = {}

    def path_of(self, log: LogPlace) -> Path:
        """The table of a log."""
        if "{name}" in self.rules.file:
            return log.path.parent / self.rules.file.replace("{name}", log.path.stem)
        return self._root / self.rules.file

    def strangers(self) -> list[tuple[Path, Event]]:
        """The first event of each name that no log and no trial has, with its table."""
        found: dict[tuple[Path, str], tuple[Path, Event]] = {}
        for path, events in self._read.items():
            for event in events:
                if event.trial and event.trial.casefold() not in self._known:
                    found.setdefault((path, event.trial), (path, event))
        return list(found.values())

    def in_ns(
        self,
        path: Path,
        events: Sequence[Event],
        stamps: IntArray,
        zero_ns: int,
        rows: IntArray,
    ) -> list[Event]:
        """Events of a table on the clock of a log or a trial; those outside of it are noted.

        rows: stamps of the rows of the trial, which an event of it shares.
        """
        moved = events_in_ns(events, self.rules, stamps, zero_ns)
        for event, there in zip(events, moved, strict=True):
            if _labels_a_row(there, rows):
                self._met.add((path, event.line))
            elif self.rules.labels.get(event.label) != "":
                within = _is_within(there, stamps)
                why = "" if within else _outside(event, self.rules, stamps)
                self._missed[path, event.line] = event, why
        return moved

    def outside(self) -> list[tuple[Path, Event, str]]:
        """Events that label no row, each with its table and with what is wrong.

        That is "" for one that lies in its log.
        """
        missed = [key for key in self._missed if key not in self._met]
        return [(key[0], *self._missed[key]) for key in missed]

    def labels_rows(self, path: Path) -> bool:
        """Whether an event of a table labels a row of a trial."""
        return any(met == path for met, _ in self._met)

    def know(self, keys: Sequence[str]) -> None:
        """Names of a log or a trial that events may have."""
        self._known |= {key.casefold() for key in keys}

    def of(self, log: LogPlace) -> list[Event]:
        """The events of a log's table, of all trials. Raises a DataError."""
        path = self.path_of(log)
        if path not in self._read:
            self._read[path] = self._events(path)
        return self._read[path]

    def _events(self, path: Path) -> list[Event]:
        if not path.is_file():
            raise DataNotFound(
                "no such table of events",
                where=path,
                next_step="correct events.file in the column map",
            )
        place = LogPlace(path, path.stem, path.suffix.lower())
        if not place.is_table:
            place = find_logs(path)[0]
        form = self._form
        log = read_log(place, form)
        columns = log.streams[0].columns if log.streams else {}
        return _rows(columns, self.rules, log.first_line, path)


def _rows(
    columns: Columns, rules: EventRules, first_line: int, path: Path
) -> list[Event]:
    """The events of a table, sorted by trial and start. Raises ColumnError or NotANumber."""
    for key in ("start", "end", "label", "trial"):
        name = getattr(rules, key)
        if name and name not in columns:
            raise ColumnError(
                f"no column {name} (events.{key})",
                where=path,
                cause=f"its columns are {listed(list(columns), most=40)}",
                next_step="correct [events] of the column map",
            )
    starts = _times(columns[rules.start], rules.start, first_line, path, empty=True)
    ends = np.full(len(starts), np.nan)
    if rules.end:
        ends = _times(columns[rules.end], rules.end, first_line, path, empty=True)
    blank = [""] * len(starts)
    labels = text_cells(columns[rules.label]) if rules.label else blank
    trials = text_cells(columns[rules.trial]) if rules.trial else blank
    rows = zip(starts.tolist(), ends.tolist(), labels, trials, strict=True)
    found = []
    for k, (start, end, label, trial) in enumerate(rows):
        event = Event(start, end, label.strip(), trial.strip(), first_line + k)
        if np.isnan(start) and np.isnan(end) and not event.label:
            continue  # a trial without an event
        if np.isnan(start):
            raise LabelError(
                f"line {event.line}: an event without a start",
                where=path,
                next_step="correct that line",
            )
        if rules.unit == ROW and start < 0:
            raise LabelError(
                f"line {event.line}: an event in row {start:g}; the first row is 0",
                where=path,
                next_step="correct that line, or events.unit",
            )
        if end < start:
            raise LabelError(
                f"line {event.line}: an event ends at {end:g} before it begins at {start:g}",
                where=path,
                next_step="correct that line",
            )
        found.append(event)
    return with_ends(sorted(found, key=lambda event: (event.trial, event.start)))


def with_ends(events: Sequence[Event]) -> list[Event]:
    """Each event without an end lasts to the next one of its trial."""
    whole: list[Event] = []
    later: Event | None = None
    for event in reversed(events):
        end = event.end
        if np.isnan(end):
            follows = later is not None and later.trial == event.trial
            end = later.start if later and follows else float(FOR_EVER_NS)
        whole.append(Event(event.start, end, event.label, event.trial, event.line))
        later = event
    return whole[::-1]


def _times(
    column: Column, name: str, first_line: int, path: Path, *, empty: bool = False
) -> np.ndarray:
    """A column of times. empty: whether a cell may be empty. Raises NotANumber."""
    cells = column.tolist()
    times = np.full(len(cells), np.nan)
    for k, cell in enumerate(cells):
        try:
            text = str(cell).strip()
            times[k] = float(text) if text else np.nan
        except ValueError:
            times[k] = np.inf
        wrong = np.isinf(times[k]) or (np.isnan(times[k]) and not empty)
        if wrong or abs(times[k]) > 1e18:
            raise NotANumber(
                f"line {first_line + k}, column {name}: {str(cell)!r:.40} is no time",
                where=path,
                next_step="write a number, in events.unit of the column map",
            )
    return times


def events_in_ns(
    events: Sequence[Event], rules: EventRules, stamps: IntArray, zero_ns: int
) -> list[Event]:
    """The events with times on the log's clock, ns. stamps [T]: of its rows.

    zero_ns: of the times of the table; of rows, the first of `stamps` is row 0.
    """
    moved = []
    for event in events:
        start, end = (
            _in_ns(t, rules, stamps, zero_ns) for t in (event.start, event.end)
        )
        moved.append(Event(start, end, event.label, event.trial, event.line))
    return moved


def _in_ns(time: float, rules: EventRules, stamps: IntArray, zero_ns: int) -> float:
    if time >= FOR_EVER_NS:
        return float(FOR_EVER_NS)
    if rules.unit != ROW:
        return zero_ns + time * NS_OF[rules.unit]
    row = int(time)
    return float(stamps[row]) if row < len(stamps) else float(stamps[-1] + 1)


def _is_within(event: Event, stamps: IntArray) -> bool:
    """Whether an event, ns, and rows [T] have a moment in common."""
    return bool(event.start <= stamps[-1] and event.end >= stamps[0])


def _labels_a_row(event: Event, stamps: IntArray) -> bool:
    """Whether an event, ns, lasts while a trial with these rows does."""
    if not len(stamps):
        return False
    return bool(max(event.start, stamps[0]) < min(event.end, stamps[-1] + 1))


def _outside(event: Event, rules: EventRules, stamps: IntArray) -> str:
    """What is wrong with an event outside its log, and which unit and zero would mend it."""
    lasts_s = 1e-9 * float(stamps[-1] - stamps[0])
    what = (
        f"{event.label or 'an event'!r:.60} begins at {event.start:g} {rules.unit}, outside its "
        f"log of {lasts_s:.1f} s (events.unit = {rules.unit!r}, zero = {rules.zero!r})"
    )
    zeros = dict.fromkeys((rules.zero, "log", "clock"))
    # the largest unit that fits: in a smaller one every event is near the beginning
    for unit in dict.fromkeys((rules.unit, *NS_OF)):
        for zero in zeros:
            zero_ns = 0 if zero == "clock" else int(stamps[0])
            (there,) = events_in_ns([event], replace(rules, unit=unit), stamps, zero_ns)
            if _is_within(there, stamps) and (unit, zero) != (rules.unit, rules.zero):
                return f'{what}: looks like unit = "{unit}", zero = "{zero}"'
    return what


def events_of_column(
    log: ForeignLog, name: str, table: Columns, stamps: IntArray, rows: slice
) -> list[Event]:
    """Events of a column of labels: runs of rows, or the texts of a topic of their own.

    table: of the signals, with `stamps` [T] on the log's clock. rows: those of the trial. Raises
    ColumnError.
    """
    stream = log.stream_of(name)
    if stream is None:
        raise ColumnError(
            f"no column {name} (events.column)",
            where=log.path,
            cause=f"its columns are {listed(log.names, most=40)}",
            next_step="correct [events] of the column map",
        )
    cells = text_cells(stream.columns[name])
    if len(cells) == len(stamps) and (
        stream.t_ns is None or np.array_equal(stream.t_ns, table.get(LOG_TIME, []))
    ):
        cells, times = cells[rows], stamps[rows].astype(np.float64)
    elif stream.t_ns is not None and LOG_TIME in table:
        # labels have stamps of the log, the samples perhaps those of the sender
        apart = stamps - table[LOG_TIME]
        times = stream.t_ns + np.interp(stream.t_ns, table[LOG_TIME], apart)
    else:
        raise ColumnError(
            f"column {name} (events.column) has other rows than the sensors",
            where=log.path,
            next_step="name a column beside the sensors",
        )
    starts = [k for k, cell in enumerate(cells) if not k or cell != cells[k - 1]]
    events = [Event(float(times[k]), np.nan, cells[k]) for k in starts]
    return with_ends(events)


def matching(events: Sequence[Event], keys: Sequence[str]) -> list[Event]:
    """The events that belong to a trial: those that name it by one of its keys, or none."""
    plain = {key.casefold() for key in keys}
    return [one for one in events if not one.trial or one.trial.casefold() in plain]


def at_event(error: DataError, path: Path, event: Event) -> DataError:
    """The error of an event, with its line."""
    where = f"{path}, line {event.line}" if event.line else str(path)
    return type(error)(
        error.what, where=where, cause=error.cause, next_step=error.next_step
    )


def is_event_table(columns: Columns) -> bool:
    """Whether a table can be one of events: it has texts beside numbers."""
    return any(map(is_text, columns.values()))
