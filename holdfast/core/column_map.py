"""The column map (TOML): which columns of a foreign log, or of a live sender, are time and sensors.

    unit = "mN"    # of all channels: N, mN, cN, dN, kN, gf, kgf, lbf, ozf, uT, mT, G, T or count
    hand = "hand.toml"           # a hand card, where it is not the six fingertips; seen from here

    [time]
    column = "millis"
    unit = "ms"                  # s, ms, us or ns
    # instead of both: rate_hz = 100 (rows are counted), or arrival = true (a live sender)
    # column with rate_hz: a column that counts the samples

    [[sensors]]                  # the thumb's side first, as in the hand card
    x = "thumb_x"
    y = "thumb_y"
    z = "-thumb_z"               # a leading "-" turns the sign
    z_zero = 4096                # taken from z first, where a reading rests far from 0

A sensor that measures one axis of the shear has no x, or no y; its hand card says so (`measures`).
A message is flattened into columns: {"imu": {"f": [1, 2]}} has `imu.f.0` and `imu.f.1`.

Further tables say how files become trials; `holdfast import` reads them, and a live
source leaves them alone. Errors name the file and the key.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from holdfast.core.contract import (
    UNIT_OF,
    BoolArray,
    FloatArray,
    IntArray,
    Unit,
    channel_names,
)
from holdfast.core.errors import CardError, ColumnError, NotANumber, listed
from holdfast.core.hand_card import HandCard, fill_unmeasured, read_hand_card
from holdfast.core.schema import read
from holdfast.core.tactile_file import MOST_FILE_SENSORS
from holdfast.core.trial_file import TimeUnit

NS_OF = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""A unit of time -> nanoseconds."""
MINUS = "-"
LATEST_NS = 1 << 62
"""Of a stamp: 146 years."""
MOST_FIELDS = 4096
"""Columns of one message."""
MapUnit = Literal[
    "N", "mN", "cN", "dN", "kN", "gf", "kgf", "lbf", "ozf", "uT", "mT", "G", "T", "count"
]  # fmt: skip
Rate = Annotated[float, Meta(ge=1e-3, le=1e6)]
Name = Annotated[str, Meta(max_length=200)]


class TimeColumn(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True
):
    """Where the time of a sample comes from: a column, a rate or the arrival.

    unit: of the column; None where the map does not say (then it is seconds). rate_hz beside a
    column: the column counts samples.
    """

    column: Name = ""
    unit: TimeUnit | None = None
    rate_hz: Rate | None = None
    arrival: bool = False

    def __post_init__(self) -> None:
        if bool(self.column or self.rate_hz) == self.arrival:
            raise ValueError("no time; allowed: one of column, rate_hz and arrival")
        if self.unit and (not self.column or self.rate_hz):
            raise ValueError("a unit without its column; allowed: unit beside column")

    @property
    def unit_ns(self) -> float:
        """Nanoseconds in a unit of the column; a whole number but for a counter."""
        return 1e9 / self.rate_hz if self.rate_hz else NS_OF[self.unit or "s"]


class SensorColumns(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True
):
    """The columns of a sensor's axes as the map writes them, each with its sign.

    x, y: one of them may be "", for an axis that is not measured. z_zero: what is taken from the
    column of z before its sign, in the map's unit.
    """

    x: Name = ""
    y: Name = ""
    z: Name = ""
    z_zero: float = 0.0

    def __post_init__(self) -> None:
        missing = "" if self.x or self.y else "x or y"
        missing = missing if self.z else "z"
        if missing:
            raise ValueError(f"{missing} is missing; allowed: z, and x, y or both")

    @property
    def axes(self) -> tuple[str, str, str]:
        """In the order of the channels."""
        return self.x, self.y, self.z

    @property
    def measured(self) -> tuple[bool, bool, bool]:
        """Which axes have a column."""
        return bool(self.x), bool(self.y), True


class ColumnMap(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True
):
    """A checked map. sensors: in the order of the channels. unit: a key of UNIT_OF.

    hand: the name of a hand card or its path, seen from the map's folder; "" for none. The tables
    of `holdfast import` follow, as they stand in the file.
    """

    unit: MapUnit
    time: TimeColumn
    sensors: Annotated[
        tuple[SensorColumns, ...], Meta(min_length=1, max_length=MOST_FILE_SENSORS)
    ]
    hand: Name = ""
    trials: Any = None
    facts: Any = None
    actions: Any = None
    masses_g: Any = None
    events: Any = None

    def __post_init__(self) -> None:
        names = self.channels
        for name in names:
            if names.count(name) > 1:
                raise ValueError(
                    f"sensors: {name!r} stands twice; allowed: each column once"
                )

    @property
    def unit_of_values(self) -> Unit:
        """The unit of what `values_of` gives: N, uT or count."""
        return UNIT_OF[self.unit][0]

    @property
    def signed(self) -> tuple[str, ...]:
        """The columns of what is measured, as the map writes them."""
        return tuple(name for sensor in self.sensors for name in sensor.axes if name)

    @property
    def channels(self) -> tuple[str, ...]:
        """The columns of what is measured, without their signs."""
        return tuple(name.removeprefix(MINUS) for name in self.signed)

    @property
    def measured(self) -> BoolArray:
        """[C] which channels have a column."""
        flags = [has for sensor in self.sensors for has in sensor.measured]
        return np.array(flags, dtype=np.bool_)

    @property
    def unmeasured_names(self) -> tuple[str, ...]:
        """The channels without a column, such as X1."""
        if len(self.signed) == 3 * len(self.sensors):
            return ()
        names = np.array(channel_names(len(self.sensors)))
        return tuple(names[~self.measured].tolist())

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns that must be there: of time, if it has one, and of the sensors."""
        return (*filter(None, [self.time.column]), *self.channels)

    def require_columns(
        self,
        there: Collection[str],
        where: str | Path,
        names: Iterable[str] | None = None,
    ) -> None:
        """Raise ColumnError unless a table or a message has the columns.

        names: some of them; None for all.
        """
        needed = self.columns if names is None else names
        missing = [name for name in needed if name not in there]
        if missing:
            raise ColumnError(
                f"no column {listed(missing, most=8)}",
                where=where,
                cause=f"its columns are {listed(list(there), most=40)}",
                next_step="correct the column map",
            )

    def values_of(
        self, columns: Mapping[str, Any], where: str | Path = ""
    ) -> FloatArray:
        """[C] of one row or message, or [T, C] of arrays [T], in `unit_of_values`.

        None and an empty text are nan; 0.0 stands for what is not measured. Raises ColumnError or
        NotANumber.
        """
        self.require_columns(columns, where, self.channels)
        cells = [_numbers(columns[name], name, where) for name in self.channels]
        read: FloatArray = np.stack(cells, axis=-1)
        size = UNIT_OF[self.unit][1]
        signs = [-size if name[0] == MINUS else size for name in self.signed]
        values = read
        if self.unmeasured_names:
            # zero and sign of a channel without a column do not matter
            values = np.full((*read.shape[:-1], 3 * len(self.sensors)), np.nan)
            values[..., self.measured] = read
            every_sign = np.ones(values.shape[-1])
            every_sign[self.measured] = signs
            signs = every_sign.tolist()
        # in place: a long log is large
        values[..., 2::3] -= [sensor.z_zero for sensor in self.sensors]
        values *= signs
        return fill_unmeasured(values, self)

    def stamp_ns(self, row: Mapping[str, Any]) -> int | None:
        """The time of a row or message; None where no column has it.

        Raises ColumnError or NotANumber.
        """
        name = self.time.column
        if not name:
            return None
        self.require_columns(row, "", [name])
        cell = row[name]
        if isinstance(cell, str) and re.fullmatch(r"\s*-?[0-9]+\s*", cell):
            # all digits of a whole number, which a float has not
            cell = int(cell)
        return int(self.stamps_ns({name: [cell]}, 1, "")[0])

    def stamps_ns(
        self, columns: Mapping[str, Any], rows: int, where: str | Path = ""
    ) -> IntArray:
        """[T] the times of a table with so many rows, as exact as its column.

        Raises ColumnError or NotANumber, and ColumnError for a map of arrival.
        """
        if self.time.arrival:
            raise ColumnError(
                "time.arrival: a file has no times of arrival",
                where=where,
                next_step="name the column of time, or write rate_hz",
            )
        name, unit_ns = self.time.column, self.time.unit_ns
        self.require_columns(columns, where, filter(None, [name]))
        stamps = np.asarray(columns[name]) if name else np.arange(rows)
        in_ns = _numbers(stamps, name, where) * unit_ns
        # nan fails the comparison
        bad = np.flatnonzero(~(np.abs(in_ns) < LATEST_NS))
        if len(bad):
            raise NotANumber(
                f"row {bad[0] + 1}, column {name}: no time, or impossibly large",
                where=where,
                cause="an empty cell, or another unit of time",
                next_step="correct the row, or [time] of the column map",
            )
        if stamps.dtype.kind in "iu" and not self.time.rate_hz:
            return stamps.astype(np.int64) * int(unit_ns)
        return np.round(in_ns).astype(np.int64)

    def hand_card(self, folder: Path) -> HandCard | None:
        """The hand card that the map names; None for none. folder: of the map.

        Raises CardError, also where it has another number of sensors than the map, or measures
        other axes.
        """
        if not self.hand:
            self._require_same_axes(None, folder)
            return None
        hand = read_hand_card(self.hand, folder)
        if hand.n_sensors != len(self.sensors):
            raise CardError(
                f"the hand {self.hand} has {hand.n_sensors} sensors, "
                f"the map {len(self.sensors)}",
                where=folder,
                next_step="name another hand card, or correct [[sensors]]",
            )
        self._require_same_axes(hand, folder)
        return hand

    def _require_same_axes(self, hand: HandCard | None, folder: Path) -> None:
        """Raise CardError where the card measures other axes than the map, or too few for uT."""
        promised = hand.unmeasured_names if hand else ()
        lacks = [name for name in self.unmeasured_names if name not in promised]
        denied = [name for name in promised if name not in self.unmeasured_names]
        card = f"the hand card {self.hand}" if hand else "no hand card"
        if denied:
            what = (
                f"columns for {', '.join(denied)}, which {card} says are not measured"
            )
            next_step = "take them out of [[sensors]], or correct measures of the card"
        elif lacks:
            what = f"no columns for {', '.join(lacks)}, and {card} says they are not measured"
            next_step = (
                'write measures = "yz" (or "xz") for these sensors in the hand card'
            )
        elif promised and self.unit_of_values == "uT":
            what = f"{card} leaves out {', '.join(promised)}, and a field needs all three axes"
            next_step = "use forces, or counts"
        else:
            return
        raise CardError(what, where=folder, next_step=next_step)


def read_column_map(path: str | Path) -> ColumnMap:
    """Read and check a map. Raises CardError, and FileNotFoundError where there is no file."""
    return read(Path(path), ColumnMap)


def flat_fields(message: Any, prefix: str = "") -> dict[str, Any]:
    """The leaves of nested objects and lists by name, such as `imu.f.0`.

    Leaves are numbers, texts, true, false and None. Raises ColumnError for more than MOST_FIELDS.

    >>> flat_fields({"t": 1, "f": [{"x": 2.5}]})
    {'t': 1, 'f.0.x': 2.5}
    """
    if not isinstance(message, dict | list | tuple):
        return {prefix: message}
    inner = message.items() if isinstance(message, dict) else enumerate(message)
    fields: dict[str, Any] = {}
    for key, value in inner:
        fields |= flat_fields(value, f"{prefix}.{key}" if prefix else str(key))
        if len(fields) > MOST_FIELDS:
            raise ColumnError(
                f"more than {MOST_FIELDS} fields in a message",
                next_step="send only what is needed",
            )

    return fields


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
