"""Lines that are samples: one JSON object each, or the rows of a table below its header.

    {"Time": 12.34, "X1": 0.1, "Y1": 0.0, "Z1": 2.5, ..}

    Time,X1,Y1,Z1,..
    12.34,0.1,0.0,2.5,..

A column map says which columns are sensors and time (core/column_map.py). Without one the columns
are called X1, Y1, Z1, .. and, for the time, Time or t_s (in s), t_ms, t_us or t_ns. valid1, .. are
0 where a sensor is not valid. Other columns are left alone. None, an empty cell and nan make a
sensor invalid at this sample.

A line counts where its time, and its `sequence` if it has one, are above those of the line before,
or where none has counted for 300 ms (core/hand_lines.py).
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.column_map import (
    ColumnMap,
    SensorColumns,
    TimeColumn,
    flat_fields,
)
from holdfast.core.contract import BoolArray, FloatArray, Unit, channel_names
from holdfast.core.errors import ColumnError, DataError, listed
from holdfast.core.hand_card import MOST_SENSORS
from holdfast.core.hand_lines import (
    LONGEST_LINE,
    NOT_RISING,
    NOT_UNDERSTOOD,
    LineRefused,
    RisingRule,
    fields_of,
    sequence_of,
)
from holdfast.core.trial_file import TIME_COLUMNS, Zero, prepared_by

SEPARATORS = (",", ";", "\t")
CHANNEL = re.compile(r"[XYZ]([1-9][0-9]{0,3})")
NOT_VALID = (0, "0", "false")


@dataclass(frozen=True)
class SampleLine:
    """One line: values [C] in the map's unit, valid [S].

    stamp_ns: on the sender's clock, None without a column of time.
    """

    stamp_ns: int | None
    values: FloatArray
    valid: BoolArray


NAME_A_MAP = (
    "describe the columns in a map, and add it to the URL: ?map=FILE (for - : "
    '"stdin://?map=FILE")'
)
"""What to do about columns that are not those of a trial."""


def map_of_names(names: Collection[str], unit: Unit) -> ColumnMap:
    """The map of columns that are called X1, Y1, Z1, ..; Raises ColumnError."""
    numbers = [int(found[1]) for found in map(CHANNEL.fullmatch, names) if found]
    n_sensors = max(numbers, default=0)
    channels = channel_names(min(n_sensors, MOST_SENSORS + 1))
    if not 0 < n_sensors <= MOST_SENSORS or not set(channels) <= set(names):
        raise ColumnError(
            f"no columns X1, Y1, Z1 to Xn, Yn, Zn among {listed(list(names))}",
            next_step=NAME_A_MAP,
        )
    axes = zip(channels[::3], channels[1::3], channels[2::3], strict=True)
    sensors = [SensorColumns(x, y, z) for x, y, z in axes]
    time = TimeColumn(arrival=True)
    for name, time_unit in TIME_COLUMNS.items():
        if name in names:
            time = TimeColumn(name, time_unit)
            break
    return ColumnMap(unit=unit, time=time, sensors=tuple(sensors))


class SampleReader:
    """Reads the lines of one source, line by line.

    column_map: None for columns with the project's names; then `map` is known from the first line
    on. unit: of their values, where the lines themselves name none. zero: what was removed from
    them by the run that wrote them (core/trial_file.py), None for nothing.
    """

    def __init__(self, column_map: ColumnMap | None = None, unit: Unit = "N") -> None:
        self.map = column_map
        self.zero: Zero | None = None
        self._unit: Unit = unit
        self._rule = RisingRule()
        self._names: list[str] = []
        self._separator = ""

    def take(self, line: bytes, now_ns: int) -> SampleLine | None:
        """The sample of a line; None for a header, a comment or an empty line.

        line: without its line end. Raises LineRefused.
        """
        try:
            columns = self._columns(line)
            return None if columns is None else self._sample(columns, now_ns)
        except LineRefused:
            raise
        except (ValueError, DataError) as error:
            raise LineRefused(NOT_UNDERSTOOD, str(error)) from None

    # -- columns of a line

    def _columns(self, line: bytes) -> dict[str, Any] | None:
        if len(line) > LONGEST_LINE:
            raise ValueError(f"longer than {LONGEST_LINE} bytes")
        line = line.strip()
        if line.startswith(b"{"):
            return flat_fields(fields_of(line))
        text = line.decode("utf-8").lstrip("\ufeff")
        if not text or text.startswith("#"):
            return None
        return self._cells(text)

    def _cells(self, text: str) -> dict[str, Any] | None:
        """A row by the names of its header, None for the header itself."""
        separator = self._separator or max(SEPARATORS, key=text.count)
        cells = [cell.strip(' "') for cell in text.split(separator)]
        if not any(map(_is_number, cells)):
            if len(set(cells)) != len(cells):
                raise ValueError("a name stands twice in the header")
            self._known_map(cells).require_columns(cells, "the header")
            self._names, self._separator = cells, separator
            return None
        if len(cells) != len(self._names):
            raise ValueError(f"{len(cells)} cells, the header has {len(self._names)}")
        if separator == ";":
            cells = [cell.replace(",", ".") for cell in cells]
        return dict(zip(self._names, cells, strict=True))

    def _known_map(self, names: Collection[str]) -> ColumnMap:
        if self.map is None:
            return map_of_names(names, self._unit)
        return self.map

    # -- a sample

    def _sample(self, columns: dict[str, Any], now_ns: int) -> SampleLine:
        self.zero, unit = prepared_by(columns)
        self._unit = unit or self._unit
        column_map = self._known_map(columns)
        stamp_ns = column_map.stamp_ns(columns)
        sequence = _sequence(columns)
        values = column_map.values_of(columns)
        valid = _valid(values, columns)
        if not self._rule.obeys(now_ns, sequence, stamp_ns):
            raise LineRefused(NOT_RISING)
        self.map = column_map
        return SampleLine(stamp_ns, values, valid)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _sequence(columns: dict[str, Any]) -> int | None:
    """`sequence` of a line, None where it has none. Raises ValueError."""
    value = columns.get("sequence")
    # cells of a table are texts
    if isinstance(value, str) and value.isdecimal():
        value = int(value)
    return sequence_of(value)


def _valid(values: FloatArray, columns: dict[str, Any]) -> BoolArray:
    """[S] whether all axes are finite and the line does not say otherwise."""
    finite = np.isfinite(values).reshape(-1, 3)
    valid: BoolArray = np.logical_and.reduce(finite, axis=1)
    if "valid1" in columns:
        for k in range(len(valid)):
            flag = columns.get(f"valid{k + 1}", 1)
            valid[k] &= flag not in NOT_VALID
    return valid
