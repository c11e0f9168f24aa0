"""The column map (TOML): which columns of a foreign log, or of a live sender, are time and sensors.

    unit = "mN"                  # of all channels: N, mN, gf, uT, mT, T or count
    hand = "hand.toml"           # a hand card, where it is not the six fingertips; seen from here

    [time]
    column = "millis"
    unit = "ms"                  # s, ms, us or ns
    # instead of both: rate_hz = 100 (rows are counted), or arrival = true (a live sender)

    [[sensors]]                  # the thumb's side first, as in the hand card
    x = "thumb_x"
    y = "thumb_y"
    z = "-thumb_z"               # a leading "-" turns the sign

A message is flattened into columns: {"imu": {"f": [1, 2]}} has `imu.f.0` and `imu.f.1`.

Further tables (IMPORT_TABLES) say how files become trials; `holdfast import` reads them, and a live
source leaves them alone. Errors name the file, the line and the key.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from holdfast.core.contract import AXES, UNIT_OF, FloatArray, IntArray, Json, Unit
from holdfast.core.errors import CardError, ColumnError, NotANumber, listed
from holdfast.core.hand_card import HandCard, read_hand_card
from holdfast.core.reading import CardReader, read_toml
from holdfast.core.toml_lines import line_naming, line_of, table_lines, toml_text

NS_OF: Mapping[str, int] = MappingProxyType(
    {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
)
"""A unit of time -> nanoseconds."""
IMPORT_TABLES = ("table", "trials", "facts", "actions", "masses_g", "events")
"""What `holdfast import` reads besides."""
MAP_KEYS = ("unit", "hand", "time", "sensors", *IMPORT_TABLES)
MINUS = "-"
LATEST_NS = 1 << 62
"""Of a stamp: 146 years."""
RATES_HZ = (1e-3, 1e6)
MOST_SENSORS = 64
"""As in a trial file; a hand card has fewer."""
MOST_FIELDS = 4096
"""Columns of one message."""


@dataclass(frozen=True)
class TimeColumn:
    """Where the time of a sample comes from: one of column, rate_hz and arrival.

    unit: of the column, one of NS_OF; None where the map does not say (then it is seconds).
    """

    column: str = ""
    unit: str | None = None
    rate_hz: float | None = None
    arrival: bool = False

    @property
    def unit_ns(self) -> int:
        """Nanoseconds in a unit of the column."""
        return NS_OF[self.unit or "s"]


@dataclass(frozen=True)
class SensorColumns:
    """The columns of a sensor's axes as the map writes them, each with its sign."""

    x: str
    y: str
    z: str

    @property
    def axes(self) -> tuple[str, str, str]:
        """In the order of the channels."""
        return self.x, self.y, self.z


@dataclass(frozen=True)
class ColumnMap:
    """A checked map. sensors: in the order of the channels. unit: a key of UNIT_OF.

    hand: the name of a hand card or its path, seen from the map's folder; "" for none. tables: the
    tables of `holdfast import`, as they stand in the file. path, text: of the file; empty without.
    """

    unit: str
    time: TimeColumn
    sensors: tuple[SensorColumns, ...]
    hand: str = ""
    tables: Json = field(default_factory=dict)
    path: Path = Path()
    text: str = ""

    @property
    def unit_of_values(self) -> Unit:
        """The unit of what `values_of` gives: N, uT or count."""
        return UNIT_OF[self.unit][0]

    @property
    def signed(self) -> tuple[str, ...]:
        """[C] the columns as the map writes them."""
        return tuple(name for sensor in self.sensors for name in sensor.axes)

    @property
    def channels(self) -> tuple[str, ...]:
        """[C] the columns without their signs."""
        return tuple(name.removeprefix(MINUS) for name in self.signed)

    @property
    def factors(self) -> FloatArray:
        """[C] from a column to its channel: the sign, and the factor of the unit."""
        size = UNIT_OF[self.unit][1]
        return np.array([-size if _is_turned(name) else size for name in self.signed])

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns that must be there: of time, if it has one, and of the sensors."""
        return (*filter(None, [self.time.column]), *self.channels)

    def require_columns(
        self,
        there: Collection[str],
        where: str | Path,
        names: Collection[str] | None = None,
    ) -> None:
        """Raise ColumnError unless a table or a message has the columns, with the line of each.

        names: some of them; None for all.
        """
        wanted = self.columns if names is None else names
        missing = [name for name in wanted if name not in there]
        if missing:
            lines = [f"{name} ({self.place_of(name)})" for name in missing[:8]]
            raise ColumnError(
                f"no column {', '.join(lines)}" + _and_more(len(missing) - 8),
                where=where,
                cause=f"its columns are {listed(list(there), most=40)}",
                next_step="correct the column map",
            )

    def values_of(
        self, columns: Mapping[str, Any], where: str | Path = ""
    ) -> FloatArray:
        """[C] of one row or message, or [T, C] of arrays [T], in `unit_of_values`.

        None and an empty text are nan. Raises ColumnError or NotANumber.
        """
        self.require_columns(columns, where, self.channels)
        cells = [_numbers(columns[name], name, where) for name in self.channels]
        if len({cell.shape for cell in cells}) > 1:
            raise NotANumber("a list in a column of numbers", where=where)
        values: FloatArray = np.stack(cells, axis=-1) * self.factors
        return values

    def stamp_ns(
        self, row: Mapping[str, Any], number: int, where: str | Path = ""
    ) -> int | None:
        """The stamp of one row, ns on the sender's clock; None where that of arrival counts.

        number: how many rows came before. Raises ColumnError or NotANumber.
        """
        if self.time.arrival:
            return None
        if self.time.rate_hz is not None:
            return round(number * 1e9 / self.time.rate_hz)
        name = self.time.column
        self.require_columns(row, where, [name])
        return _stamp_ns(row[name], self.time.unit_ns, name, where)

    def stamps_ns(
        self, columns: Mapping[str, Any], rows: int, where: str | Path = ""
    ) -> IntArray:
        """[T] the same of a table with so many rows, as exact as its column.

        Raises ColumnError or NotANumber, and ColumnError for a map of arrival.
        """
        if self.time.rate_hz is not None:
            return np.round(np.arange(rows) * (1e9 / self.time.rate_hz)).astype(
                np.int64
            )
        if self.time.arrival:
            raise ColumnError(
                f"{self.place_of('time.arrival')}: a file has no times of arrival",
                where=where,
                next_step="name the column of time, or write rate_hz",
            )
        name = self.time.column
        self.require_columns(columns, where, [name])
        stamps = np.asarray(columns[name])
        if stamps.dtype.kind in "iu":
            _require_stamps(stamps.astype(np.float64) * self.time.unit_ns, name, where)
            return stamps.astype(np.int64) * self.time.unit_ns
        in_ns = _numbers(stamps, name, where) * self.time.unit_ns
        _require_stamps(in_ns, name, where)
        return np.round(in_ns).astype(np.int64)

    def hand_card(self) -> HandCard | None:
        """The hand card that the map names; None for none.

        Raises CardError, also where it has another number of sensors than the map.
        """
        if not self.hand:
            return None
        hand = read_hand_card(self.hand, self.path.parent)
        if hand.n_sensors != len(self.sensors):
            raise CardError(
                f"{self.place_of('hand')}: the hand {self.hand} has {hand.n_sensors} sensors, "
                f"the map {len(self.sensors)}",
                where=self.path,
                next_step="name another hand card, or correct [[sensors]]",
            )
        return hand

    def place_of(self, name: str) -> str:
        """Where the map speaks of a key, such as time.unit, or of a column: "line 7"."""
        number = line_of(self.text, name) or line_naming(self.text, name)
        return f"line {number}" if number else "the map"

    def to_toml(self) -> str:
        """The text of the file."""
        lines = [f"unit = {toml_text(self.unit)}"]
        if self.hand:
            lines.append(f"hand = {toml_text(self.hand)}")
        lines += ["", "[time]", *_time_lines(self.time)]
        for sensor in self.sensors:
            lines += ["", "[[sensors]]"]
            for axis, name in zip(AXES, sensor.axes, strict=True):
                lines.append(f"{axis} = {toml_text(name)}")
        for name, table in self.tables.items():
            lines += ["", *table_lines(name, table)]
        return "\n".join(lines) + "\n"


def read_column_map(path: str | Path) -> ColumnMap:
    """Read and check a map. Raises CardError, and FileNotFoundError where there is no file."""
    path = Path(path)
    text, raw = read_toml(path)
    return MapReader(path, text).column_map(raw)


def column_map_of(text: str, path: Path = Path("map.toml")) -> ColumnMap:
    """The map of a text, such as one that was proposed. Raises CardError."""
    return MapReader(path, text).column_map(tomllib.loads(text))


class MapReader(CardReader):
    """Checks a map's values; its errors name the line of the key."""

    def __init__(self, path: Path, text: str) -> None:
        super().__init__(path)
        self.text = text

    def refused(self, key: str, value: Any, allowed: str) -> CardError:
        """The error for a value that a key cannot have, with its line."""
        what = f"{self.line(key)}{key} = {repr(value)[:80]}"
        return CardError(what, where=self.path, next_step=f"allowed: {allowed}")

    def require_known(
        self, names: Collection[str], allowed: Collection[str], what: str
    ) -> None:
        """Raise CardError for a key that is not among those allowed. what: the table's name."""
        for name in names:
            if name not in allowed:
                key = f"{what}.{name}" if what else name
                raise CardError(
                    f"{self.line(key)}{key:.80} is not known",
                    where=self.path,
                    next_step=f"allowed: {', '.join(allowed)}",
                )

    def line(self, key: str) -> str:
        """ "line 7: ", or nothing for a key that is not there."""
        number = line_of(self.text, key)
        return f"line {number}: " if number else ""

    def column_map(self, raw: Json) -> ColumnMap:
        """The checked map. Raises CardError."""
        self.require_known(raw, MAP_KEYS, "")
        unit = raw.get("unit")
        if not isinstance(unit, str) or unit not in UNIT_OF:
            raise self.refused("unit", unit, ", ".join(UNIT_OF))
        tables = {name: raw[name] for name in IMPORT_TABLES if name in raw}
        for name, table in tables.items():
            self.require_table(name, table)
        return ColumnMap(
            unit=unit,
            time=self.time(self.table(raw, "time")),
            sensors=self.sensors(raw.get("sensors")),
            hand=self.name("hand", raw.get("hand", ""), empty=True),
            tables=tables,
            path=self.path,
            text=self.text,
        )

    def time(self, table: Json) -> TimeColumn:
        """The table [time]. Raises CardError."""
        self.require_known(table, TimeColumn.__dataclass_fields__, "time")
        given = [key for key in ("column", "rate_hz", "arrival") if key in table]
        one = "one of column, rate_hz and arrival"
        if len(given) != 1:
            raise self.refused("time", " and ".join(given) or None, one)
        if "unit" in table and (given != ["column"] or table["unit"] not in NS_OF):
            allowed = f"{', '.join(NS_OF)}, beside time.column"
            raise self.refused("time.unit", table["unit"], allowed)
        if given == ["arrival"] and table["arrival"] is not True:
            raise self.refused("time.arrival", table["arrival"], "true")
        rate_hz = table.get("rate_hz")
        if rate_hz is not None:
            rate_hz = self.number("time.rate_hz", rate_hz, *RATES_HZ)
        column = self.name("time.column", table.get("column", ""), empty=True)
        if given == ["column"] and not column:
            raise self.refused("time.column", column, "the name of a column")
        return TimeColumn(column, table.get("unit"), rate_hz, given == ["arrival"])

    def sensors(self, rows: Any) -> tuple[SensorColumns, ...]:
        """The tables [[sensors]]. Raises CardError."""
        if not isinstance(rows, list) or not 0 < len(rows) <= MOST_SENSORS:
            count = len(rows) if isinstance(rows, list) else rows
            allowed = f"1 to {MOST_SENSORS} tables [[sensors]], each with x, y and z"
            raise self.refused("sensors", count, allowed)
        sensors = []
        seen: dict[str, str] = {}
        for k, row in enumerate(rows):
            key = f"sensors[{k}]"
            self.require_known(self.require_table(key, row), AXES, key)
            names = [self.name(f"{key}.{axis}", row.get(axis)) for axis in AXES]
            for axis, name in zip(AXES, names, strict=True):
                before = seen.setdefault(name.removeprefix(MINUS), f"{key}.{axis}")
                if before != f"{key}.{axis}":
                    raise self.refused(f"{key}.{axis}", name, f"not that of {before}")
            sensors.append(SensorColumns(*names))
        return tuple(sensors)

    def name(self, key: str, value: Any, *, empty: bool = False) -> str:
        """A name of a column or a file. Raises CardError."""
        is_text = isinstance(value, str) and len(value) <= 200 and "\0" not in value
        if not is_text or not (empty or value.removeprefix(MINUS)):
            raise self.refused(key, value, "a name in quotes")
        return str(value)

    def number(self, key: str, value: Any, low: float, high: float) -> float:
        """A number within a range. Raises CardError."""
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        # nan fails both comparisons
        if not is_number or not low <= value <= high:
            raise self.refused(key, value, f"a number from {low:g} to {high:g}")
        return float(value)


def flat_fields(message: Any, prefix: str = "") -> dict[str, Any]:
    """The leaves of nested objects and lists by name, such as `imu.f.0`.

    Leaves are numbers, texts, true, false and None. Raises ColumnError for more than MOST_FIELDS.

    >>> flat_fields({"t": 1, "f": [{"x": 2.5}]})
    {'t': 1, 'f.0.x': 2.5}
    """
    fields: dict[str, Any] = {}
    for name, value in _leaves(message, prefix):
        fields[name] = value
        if len(fields) > MOST_FIELDS:
            raise ColumnError(
                f"more than {MOST_FIELDS} fields in a message",
                next_step="send only what is needed",
            )
    return fields


def _leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    if not isinstance(value, dict | list | tuple):
        yield name, value
        return
    inner = value.items() if isinstance(value, dict) else enumerate(value)
    for key, one in inner:
        yield from _leaves(one, f"{name}.{key}" if name else str(key))


def _is_turned(name: str) -> bool:
    return name.startswith(MINUS)


def _and_more(count: int) -> str:
    return f" and {count} more" if count > 0 else ""


def _numbers(cells: Any, name: str, where: str | Path) -> FloatArray:
    """A cell or a column as numbers; None and "" are nan. Raises NotANumber."""
    if isinstance(cells, str):
        cells = cells.strip() or None
    try:
        return np.asarray(cells, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise NotANumber(
            f"column {name}: {str(cells)!r:.40} is no number",
            where=where,
            cause="text in the data, a decimal comma, or another column",
            next_step="correct the column map",
        ) from None


def _stamp_ns(cell: Any, unit_ns: int, name: str, where: str | Path) -> int:
    """One stamp; a whole number keeps all its digits. Raises NotANumber."""
    text = cell.strip() if isinstance(cell, str) else cell
    if isinstance(text, str) and re.fullmatch("-?[0-9]{1,19}", text):
        text = int(text)
    if isinstance(text, int | np.integer) and abs(int(text) * unit_ns) < LATEST_NS:
        return int(text) * unit_ns
    in_ns = _numbers(text, name, where) * unit_ns
    _require_stamps(np.atleast_1d(in_ns), name, where)
    return round(float(in_ns))


def _require_stamps(in_ns: FloatArray, name: str, where: str | Path) -> None:
    """Raise NotANumber for a stamp that is none."""
    # nan fails the comparison
    bad = np.flatnonzero(~(np.abs(in_ns) < LATEST_NS))
    if len(bad):
        raise NotANumber(
            f"row {bad[0] + 1}, column {name}: no time, or impossibly large",
            where=where,
            cause="an empty cell, or another unit of time",
            next_step="correct the row, or [time] of the column map",
        )


def _time_lines(time: TimeColumn) -> list[str]:
    if time.arrival:
        return ["arrival = true"]
    if time.rate_hz is not None:
        return [f"rate_hz = {time.rate_hz:.10g}"]
    lines = [f"column = {toml_text(time.column)}"]
    return lines + ([f"unit = {toml_text(time.unit)}"] if time.unit else [])
