"""Lines that are samples: one JSON object each, or the rows of a table below its header.

    {"Time": 12.34, "X1": 0.1, "Y1": 0.0, "Z1": 2.5, ..}

    Time,X1,Y1,Z1,..
    12.34,0.1,0.0,2.5,..

A column map says which columns are sensors and time (core/column_map.py). Without one the columns
are called X1, Y1, Z1, .. and, for the time, Time or t_s (in s), t_ms, t_us or t_ns. valid1, .. are
0 where a sensor is not valid. Other columns are left alone. None, an empty cell and nan make a
sensor invalid at this sample.

Which lines count is the rule of core/line_session.py, with the columns `session` and `sequence`.
Without a session its sender's address or connection stands for it, and without a sequence the time.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.column_map import ColumnMap, SensorColumns, TimeColumn, flat_fields
from holdfast.core.contract import BoolArray, FloatArray, Unit, channel_names
from holdfast.core.errors import ColumnError, DataError, listed
from holdfast.core.hand_card import MOST_SENSORS
from holdfast.core.line_key import LinkKey
from holdfast.core.line_session import (
    LONGEST_LINE,
    NOT_RISING,
    NOT_SEALED,
    NOT_UNDERSTOOD,
    LineRefused,
    SessionRule,
    fields_of,
    number_of,
)

TIME_COLUMNS = {"Time": "s", "t_s": "s", "t_ms": "ms", "t_us": "us", "t_ns": "ns"}
"""The name of a column of time -> its unit."""
SEPARATORS = (",", ";", "\t")
CHANNEL = re.compile(r"[XYZ]([1-9][0-9]{0,3})")
MOST_HEADERS = 8
"""Senders whose header is remembered; only one of them is obeyed."""
SECOND = 1_000_000_000
MILLI = 1_000_000
"""A step of a sequence on the scale of the rule: so at most a thousand lines ahead."""
NOT_VALID = (0, "0", "false")


@dataclass(frozen=True)
class SampleLine:
    """One line: values [C] in the map's unit, valid [S].

    stamp_ns: on the sender's clock, None without a column of time. begins: whether it is the first
    of a session.
    """

    stamp_ns: int | None
    values: FloatArray
    valid: BoolArray
    begins: bool


@dataclass(frozen=True)
class _Header:
    names: tuple[str, ...]
    separator: str


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
    sensors = [SensorColumns(*channels[k : k + 3]) for k in range(0, len(channels), 3)]
    time = TimeColumn(arrival=True)
    for name, time_unit in TIME_COLUMNS.items():
        if name in names:
            time = TimeColumn(name, time_unit)
            break
    return ColumnMap(unit=unit, time=time, sensors=tuple(sensors))


class SampleReader:
    """Reads the lines of one source, line by line.

    column_map: None for columns with the project's names; then `map` is known from the first line
    on. unit: of their values. key: of the source, None without one. began: called with the number
    of a new session.
    """

    def __init__(
        self,
        column_map: ColumnMap | None = None,
        unit: Unit = "N",
        *,
        key: LinkKey | None = None,
        began: Callable[[int], object] | None = None,
    ) -> None:
        self.map = column_map
        self._unit: Unit = unit
        self._key = key
        self._began = began
        after = None if key is None else (key.newest_seen(), -1)
        self._rule = SessionRule(SECOND, after=after)
        self._headers: dict[Hashable, _Header] = {}
        self._position = 0
        self._stamp_ns: int | None = None

    def take(self, line: bytes, peer: Hashable, now_ns: int) -> SampleLine | None:
        """The sample of a line; None for a header, a comment or an empty line.

        line: without its line end. peer: its sender's address, or the number of its connection.
        Raises LineRefused.
        """
        try:
            columns = self._columns(line, peer)
            return None if columns is None else self._sample(columns, peer, now_ns)
        except LineRefused:
            raise
        except (ValueError, DataError) as error:
            raise LineRefused(NOT_UNDERSTOOD, str(error)) from None

    # -- columns of a line

    def _columns(self, line: bytes, peer: Hashable) -> dict[str, Any] | None:
        if len(line) > LONGEST_LINE:
            raise ValueError(f"longer than {LONGEST_LINE} bytes")
        line = line.strip()
        if self._key is not None:
            line = self._opened(line, self._key)
        if line.startswith(b"{"):
            return flat_fields(fields_of(line))
        if self._key is not None:
            # an old header, sent again, would give the columns other names
            raise ValueError("with a key, lines are JSON objects")
        text = line.decode("utf-8").lstrip("\ufeff")
        if not text or text.startswith("#"):
            return None
        return self._cells(text, peer)

    def _opened(self, line: bytes, key: LinkKey) -> bytes:
        try:
            return key.opened(line)
        except ValueError as error:
            raise LineRefused(NOT_SEALED, str(error)) from None

    def _cells(self, text: str, peer: Hashable) -> dict[str, Any] | None:
        """A row by the names of its header, None for the header itself."""
        header = self._headers.get(peer)
        separator = (
            max(SEPARATORS, key=text.count) if header is None else header.separator
        )
        cells = [cell.strip(' "') for cell in text.split(separator)]
        if not any(map(_is_number, cells)):
            separator = max(SEPARATORS, key=text.count)
            names = tuple(cell.strip(' "') for cell in text.split(separator))
            self._take_header(_Header(names, separator), peer)
            return None
        if header is None:
            raise ValueError("no header has come before this row")
        if len(cells) != len(header.names):
            raise ValueError(f"{len(cells)} cells, the header has {len(header.names)}")
        if separator == ";":
            cells = [cell.replace(",", ".") for cell in cells]
        return dict(zip(header.names, cells, strict=True))

    def _take_header(self, header: _Header, peer: Hashable) -> None:
        if len(set(header.names)) != len(header.names):
            raise ValueError("a name stands twice in the header")
        self._known_map(header.names).require_columns(header.names, "the header")
        # the oldest one goes, so that senders that are not obeyed take no memory
        if peer not in self._headers and len(self._headers) >= MOST_HEADERS:
            del self._headers[next(iter(self._headers))]
        self._headers[peer] = header

    def _known_map(self, names: Collection[str]) -> ColumnMap:
        if self.map is None:
            return map_of_names(names, self._unit)
        return self.map

    # -- a sample

    def _sample(
        self, columns: dict[str, Any], peer: Hashable, now_ns: int
    ) -> SampleLine:
        column_map = self._known_map(columns)
        stamp_ns = None
        if column_map.time.column:
            stamp_ns = column_map.stamp_ns(columns, 0)
        session = _number(columns, "session")
        sequence = _number(columns, "sequence")
        if self._key is not None and (session is None or sequence is None):
            raise ValueError("with a key, lines have a session and a sequence")

        number = _number_of_peer(peer) if session is None else session
        position = self._position + 1 if stamp_ns is None else stamp_ns
        if sequence is not None:
            position = MILLI * sequence
        begins = not self._rule.lives(now_ns)
        if kind := self._rule.refusal(number, position, now_ns):
            raise LineRefused(kind)
        if not begins and not _rises(stamp_ns, self._stamp_ns):
            raise LineRefused(NOT_RISING)

        values = column_map.values_of(columns)
        valid = _valid(values, columns)
        is_new = begins and number != self._rule.session
        self._rule.obeyed(number, position, now_ns)
        self.map = column_map
        self._position = position
        self._stamp_ns = stamp_ns
        if is_new and session is not None and self._began is not None:
            self._began(session)
        return SampleLine(stamp_ns, values, valid, begins)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _number(columns: dict[str, Any], name: str) -> int | None:
    """`session` or `sequence` of a line, None where it has none. Raises ValueError."""
    value = columns.get(name)
    if value is None:
        return None
    # cells are texts; the length first, because Python takes long to read many digits
    if isinstance(value, str) and value.isdecimal() and len(value) <= 16:
        value = int(value)
    return number_of({name: value}, name)


def _number_of_peer(peer: Hashable) -> int:
    """A number below all sessions for lines that name none, another one for each sender."""
    return -int.from_bytes(repr(peer).encode(), "big")


def _rises(stamp_ns: int | None, before_ns: int | None) -> bool:
    return stamp_ns is None or before_ns is None or stamp_ns > before_ns


def _valid(values: FloatArray, columns: dict[str, Any]) -> BoolArray:
    """[S] whether all axes are finite and the line does not say otherwise."""
    finite = np.isfinite(values).reshape(-1, 3)
    valid: BoolArray = np.logical_and.reduce(finite, axis=1)
    if "valid1" in columns:
        for k in range(len(valid)):
            flag = columns.get(f"valid{k + 1}", 1)
            valid[k] &= flag not in NOT_VALID
    return valid
