"""A column map that is proposed for foreign logs: from names, rates and sizes, to be looked at.

What nothing says stays a hole in the map, which reading it then refuses with its line.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.column_map import ColumnMap, SensorColumns, TimeColumn
from holdfast.core.contract import UNIT_OF, Json
from holdfast.core.errors import (
    ColumnError,
    DataError,
    DataNotFound,
    EmptyRecording,
    listed,
)
from holdfast.interop.column_names import (
    counted_sensors,
    guess_sensors,
    guess_time,
    guess_unit,
    longest_stream,
    turned_normals,
    unit_of_signals,
    words_of,
)
from holdfast.interop.import_map import gaps_of
from holdfast.interop.logs.find import LogPlace, find_logs, read_log
from holdfast.interop.logs.layout import TableFormat
from holdfast.interop.logs.log import LOG_TIME, Columns, ForeignLog, numeric
from holdfast.interop.proposed_trials import (
    Example,
    propose_events,
    propose_facts,
    propose_path,
    propose_split,
)

HOLE = SensorColumns("", "", "")
FINGERS = {"thumb", "index", "middle", "ring", "little", "pinky", "daumen", "finger"}
"""Words of a file that holds one finger of several."""
READ_FIRST = 4
"""Logs that are read for a proposal; the others are taken to be alike."""


@dataclass(frozen=True)
class Proposal:
    """A map as text, what it was taken from, and what is left to be written, a line each."""

    text: str
    reasons: tuple[str, ...]
    gaps: tuple[str, ...]


def propose(source: Path) -> Proposal:
    """A map for the logs of a source. Raises a DataError where no log can be read at all."""
    places = find_logs(source)
    logs, tables = _examples(places)
    first = logs[0]
    reasons: list[str] = []
    time, table = _time(first, reasons)
    sensors = _sensors(first, table, time, reasons)
    unit, sensors = _unit(first, sensors, reasons)

    hidden = {log.path for log in tables}
    left = [place for place in places if place.path not in hidden]
    example = Example(source, first, logs[1:], left, time, sensors)
    columns = ColumnMap(unit, time, tuple(sensors or [HOLE]), tables={})
    parts: Json = {}
    _add(parts, "trials", propose_split(example, reasons))
    events = propose_events(example, tables, parts.get("trials", {}), reasons)
    path = propose_path(left, reasons)
    skip = _skipped(source, tables, events)
    _add(parts, "trials", {**path, **parts.get("trials", {}), **skip})
    actions, facts = propose_facts(example, parts, events, reasons)
    _add(parts, "facts", facts)
    _add(parts, "actions", actions)
    _add(parts, "events", events)
    reasons += _remarks(example, parts)
    head = [f"# Proposed by holdfast import for {source.name}: check every line."]
    head += [f"# {reason}" for reason in reasons]
    text = "\n".join([*head, "", replace(columns, tables=parts).to_toml()])
    return Proposal(text, tuple(reasons), tuple(gaps_of(text)))


def _remarks(example: Example, parts: Json) -> list[str]:
    """What nothing in the logs says, and what it means, a line each."""
    trials, facts = parts.get("trials", {}), parts.get("facts", {})
    known = {*trials, *facts, *example.log.about}
    path = str(trials.get("path", ""))
    lines = []
    if "person" not in known and "{person}" not in path:
        lines.append(
            "person: nothing says it; with facts.person, trials.person or {person} in "
            "trials.path, a model is judged on people that it has not seen"
        )
    if "object" not in known and "{object}" not in path:
        lines.append(
            'object: nothing says it; the folder is named "object" (facts.object, '
            "trials.object or {object} in trials.path)"
        )
    one_each = [place for place in example.places if words_of(place.name) & FINGERS]
    if len(one_each) > 1:
        lines.append(
            f"{one_each[0].path.name} looks like one finger of several: a log holds all sensors of "
            "a trial; put files of the same rows side by side first"
        )
    return lines


def _skipped(source: Path, tables: Sequence[ForeignLog], events: Json) -> Json:
    """[trials] skip: tables without sensors that hold no events."""
    root = source if source.is_dir() else source.parent
    file = str(events.get("file", ""))
    names = []
    for table in tables:
        name = table.path.relative_to(root)
        if "{name}" not in file and name.as_posix() != file:
            names.append(name.with_suffix("").as_posix())
    return {"skip": names} if names else {}


def _add(parts: Json, name: str, table: Json) -> None:
    if table:
        parts[name] = table


def _examples(places: Sequence[LogPlace]) -> tuple[list[ForeignLog], list[ForeignLog]]:
    """(logs with sensors, tables without), of the first of them and of what may be events."""
    logs: list[ForeignLog] = []
    tables: list[ForeignLog] = []
    fault: DataError | None = None
    for place in places:
        is_candidate = place.is_table and _may_be_events(place, places)
        if len(logs) >= READ_FIRST and not is_candidate:
            continue
        try:
            log = read_log(place, TableFormat())
        except DataError as error:
            fault = fault or error
            continue
        if not log.streams:
            fault = fault or EmptyRecording("no stream with a sample", where=place.path)
            continue
        has_sensors = bool(guess_sensors(numeric(longest_stream(log))))
        is_table = place.is_table and is_candidate and not has_sensors
        (tables if is_table and len(places) > 1 else logs).append(log)
    if not logs:
        raise fault or DataNotFound(
            "no log with sensors", where=places[0].path, next_step="give the logs"
        )
    logs.sort(key=lambda log: not guess_sensors(numeric(longest_stream(log))))
    return logs, tables


def _may_be_events(place: LogPlace, places: Sequence[LogPlace]) -> bool:
    """By its name, or because no other file is of its kind or in its folder."""
    words = r"event|label|marker|annot|phase|slip|onset|trials|meta|notes|ereig|notiz"
    if re.search(words, place.path.stem.lower()):
        return True
    # a name that is built in another way than those of most logs
    forms = Counter(len(re.split("[/_]", one.name)) for one in places)
    if forms[len(re.split("[/_]", place.name))] == 1 < len(places):
        return True
    alike = [one for one in places if one.kind == place.kind]
    beside = [one for one in places if one.path.parent == place.path.parent]
    return len(places) > 1 and (len(alike) == 1 or len(beside) == 1 or len(places) <= 3)


def _time(log: ForeignLog, reasons: list[str]) -> tuple[TimeColumn, Columns]:
    """Where the time comes from; a rate of 0 is a hole."""
    columns = longest_stream(log)
    guess = None if log.stamped else guess_time(columns)
    if log.stamped:
        reasons.append("time: the stamps of the log")
        return TimeColumn(LOG_TIME, "ns"), columns
    if guess is None:
        reasons.append(
            "time: no column runs like a clock; write rate_hz, rows a second"
        )
        return TimeColumn(rate_hz=0.0), columns
    reasons.append(f"time: {guess.column}, {guess.why}")
    return TimeColumn(guess.column, guess.unit), columns


def _sensors(
    log: ForeignLog, columns: Columns, time: TimeColumn, reasons: list[str]
) -> list[SensorColumns]:
    """The sensors by their names; none is a hole."""
    names = [name for name in numeric(columns) if name != time.column]
    sensors = guess_sensors(names)
    if sensors:
        reasons.append(f"sensors: {len(sensors)}, by the axes in their names")
        return sensors
    sensors = counted_sensors(columns, {time.column})
    if sensors:
        reasons.append(
            f"sensors: {len(sensors)}, three numbered columns each, taken to be x, y, z"
        )
        return sensors
    there = listed(names, most=40)
    reasons.append(
        f"sensors: no names with x, y and z; write the columns of each, out of {there}"
    )
    return []


def _unit(
    log: ForeignLog, sensors: Sequence[SensorColumns], reasons: list[str]
) -> tuple[str, list[SensorColumns]]:
    """The unit by the file, by the names, else by size; normals with signs where it is a force."""
    said = log.about.get("unit")
    unit = said if isinstance(said, str) and said in UNIT_OF else None
    why = "by the file"
    if unit is None:
        unit = unit_of_signals([s.x for s in sensors] + [s.z for s in sensors])
        why = "by the names"
    names = [name for sensor in sensors for name in sensor.axes]
    try:
        table: dict[str, Any] = log.table(names) if names else {}
    except ColumnError:
        table = {}
    if not names or not all(name in table for name in names):
        return unit or "N", list(sensors)
    if unit is None:
        values = np.stack([table[name].astype(np.float64) for name in names], axis=-1)
        unit, why = guess_unit(values)
    reasons.append(f"unit: {unit}, {why}")
    if UNIT_OF[unit][0] != "N":
        return unit, list(sensors)
    turned = turned_normals(sensors, table)
    if turned != list(sensors):
        reasons.append('sensors with "-": a press makes their Z negative')
    return unit, turned
