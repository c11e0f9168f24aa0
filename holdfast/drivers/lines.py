"""Lines of any program as a live source: one JSON object each, or the rows of a table.

    {"Time": 12.34, "X1": 0.1, "Y1": 0.0, "Z1": 2.5, ..}

    Time,X1,Y1,Z1,..
    12.34,0.1,0.0,2.5,..

A column map says which columns are sensors and time (core/column_map.py). Without one the columns
are called X1, Y1, Z1, .. and, for the time, Time or t_s (in s), t_ms, t_us or t_ns. valid1, .. are
0 where a sensor is not valid. Other columns are left alone. None, an empty cell, NaN and infinity
make a sensor invalid at this sample, in whichever way a program writes them.

A line counts where its time, and its `sequence` if it has one, are above those of the line before,
or where none has counted for 300 ms (core/hand_lines.py). The time of a sample is that of its
arrival: a sender's clock is another one.

The source waits for the next sample, so the sender paces the loop. What waited while nothing was
read, as between two trials, has no known time of arrival, and is dropped. Dropped samples are
counted.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from holdfast.core.column_map import ColumnMap, SensorColumns, TimeColumn, flat_fields
from holdfast.core.contract import (
    RATE_TOLERANCE,
    BoolArray,
    FloatArray,
    Unit,
    channel_names,
)
from holdfast.core.errors import (
    ColumnError,
    DataError,
    DeviceNotFound,
    RateError,
    listed,
)
from holdfast.core.hand_card import MOST_SENSORS, HandCard, too_many
from holdfast.core.hand_lines import (
    LONGEST_LINE,
    NOT_RISING,
    NOT_UNDERSTOOD,
    LineRefused,
    RisingRule,
    fields_of,
    printable,
    sequence_of,
)
from holdfast.core.schema import NO_NUMBER
from holdfast.core.source import SourceReading
from holdfast.core.trial_file import TIME_COLUMNS, Zero, prepared_by, says_no
from holdfast.drivers.arrivals import Arrivals
from holdfast.drivers.line_feeds import BITS_A_BYTE, Feed

ToForce = Callable[[FloatArray], FloatArray]
"""Field [S, 3] in uT -> force [S, 3] in N."""
SEPARATORS = (",", ";", "\t")
CHANNEL = re.compile(r"[XYZ]([1-9][0-9]{0,3})")
EMPTY = re.compile(NO_NUMBER, re.IGNORECASE)
"""A cell that counts as an empty one."""
NOT_VALID = "not valid"
SAME_STAMP = "stamped like the line before"
NAME_A_MAP = (
    "describe the columns in a map, and add it to the URL: ?map=FILE (for - : "
    '"stdin://?map=FILE")'
)
"""What to do about columns that are not those of a trial."""


def map_of_names(
    names: Collection[str], unit: Unit, hand: HandCard | None = None
) -> ColumnMap:
    """The map of columns that are called X1, Y1, Z1, ..; Raises ColumnError.

    hand: the columns of what it does not measure are left alone.
    """
    numbers = [int(found[1]) for found in map(CHANNEL.fullmatch, names) if found]
    n_sensors = max(numbers, default=0)
    channels = channel_names(min(n_sensors, MOST_SENSORS + 1))
    if too_many(n_sensors):
        raise ColumnError(
            too_many(n_sensors), next_step=f"send those that matter, or {NAME_A_MAP}"
        )
    absent = hand.unmeasured_names if hand else ()
    needed = set(channels).difference(absent)
    is_hand = hand is None or hand.n_sensors == n_sensors
    if n_sensors == 0 or not needed <= set(names) or not is_hand:
        raise ColumnError(
            f"no columns X1, Y1, Z1 to Xn, Yn, Zn among {listed(list(names))}",
            next_step=f"{NAME_A_MAP}; what a hand does not measure: ?hand=CARD",
        )
    channels = tuple("" if name in absent else name for name in channels)
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
    on. unit: of their values, where the lines themselves name none. to_force: a calibration, for
    lines in uT. zero: what was removed from them by the run that wrote them (core/trial_file.py),
    None for nothing. hand: the card of the hand, where one is named.
    """

    def __init__(
        self,
        column_map: ColumnMap | None = None,
        unit: Unit = "N",
        to_force: ToForce | None = None,
        hand: HandCard | None = None,
    ) -> None:
        self.map = column_map
        self.hand = hand
        self.to_force = to_force
        self.zero: Zero | None = None
        self._unit: Unit = unit
        self._rule = RisingRule()
        self._stamp_ns: int | None = None
        self._names: list[str] = []
        self._separator = ""

    def take(self, line: bytes, now_ns: int) -> SourceReading | None:
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
        # not tabs: at the end of a row of these stands an empty cell
        line = line.strip(b" \r\n")
        if line.startswith(b"{"):
            return flat_fields(fields_of(line))
        text = line.decode("utf-8").lstrip("\ufeff")
        if not text.strip() or text.startswith("#"):
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
        cells = ["" if EMPTY.fullmatch(cell) else cell for cell in cells]
        return dict(zip(self._names, cells, strict=True))

    def _known_map(self, names: Collection[str]) -> ColumnMap:
        return self.map or map_of_names(names, self._unit, self.hand)

    # -- a sample

    def _sample(self, columns: dict[str, Any], now_ns: int) -> SourceReading:
        self.zero, unit = prepared_by(columns)
        self._unit = unit or self._unit
        column_map = self._known_map(columns)
        stamp_ns = column_map.stamp_ns(columns)
        sequence = columns.get("sequence")
        # cells of a table are texts
        if isinstance(sequence, str) and sequence.isdecimal():
            sequence = int(sequence)
        values = column_map.values_of(columns)
        valid = _valid(values, columns)
        if not self._rule.obeys(now_ns, sequence_of(sequence), stamp_ns):
            is_same = stamp_ns is not None and stamp_ns == self._stamp_ns
            raise LineRefused(SAME_STAMP if is_same else NOT_RISING)
        self.map, self._stamp_ns = column_map, stamp_ns
        if self.to_force is not None:
            values = self.to_force(values.reshape(-1, 3)).reshape(-1)
        why = tuple("" if one else NOT_VALID for one in valid)
        return SourceReading(now_ns, values, valid, why)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _valid(values: FloatArray, columns: dict[str, Any]) -> BoolArray:
    """[S] whether all axes are finite and the line does not say otherwise."""
    finite = np.isfinite(values).reshape(-1, 3)
    valid: BoolArray = np.logical_and.reduce(finite, axis=1)
    if "valid1" in columns:
        for k in range(len(valid)):
            flag = columns.get(f"valid{k + 1}", 1)
            # an empty flag says nothing good; nan is unequal to itself
            said = flag not in (None, "") and flag == flag
            valid[k] &= said and not says_no(flag)
    return valid


# -- the source

FIRST_S = 10.0
"""An opened source must send within this time."""
LOOK_S = 0.05
SETTLE_S, MEASURE_S = 0.2, 0.5
MEASURE_LINES = 20
"""The rate is measured over so many samples, and for so long; not over the first ones, because a
sender that was held up sends all that it has at once."""
FULL = 0.8
"""A serial port that carries a larger share of what it can has no room for more."""
PAUSE_PERIODS = 3.0
"""Where nothing was read for longer, what waits has no known time of arrival."""
MOST_DROPPED = 4096
"""Pulls after which a sender that never pauses is not waited for."""


class LineSource(Arrivals):
    """The lines of a feed as a source. clock: has now_ns and wait_until.

    report: receives what a person should know. rate_hz: None where it is measured. Raises
    DeviceNotFound where no sample comes, RateError where a rate is not to be had.
    """

    def __init__(
        self,
        feed: Feed,
        reader: SampleReader,
        clock: Any,
        report: Callable[[str], object],
        rate_hz: float | None = None,
    ) -> None:
        super().__init__(feed.name, clock, report)
        self._n_lines = self._n_bytes = 0
        self._feed = feed
        self._reader = reader
        self._report = report
        # what waited before this program began has no known time
        dropped = self._drop_waiting()
        self._collect_first(rate_hz)
        self.rate_hz = rate_hz or self._measured_hz()
        dropped += self.begin()
        assert reader.map is not None
        self.unit: Unit = "N" if reader.to_force else reader.map.unit_of_values
        self.n_channels = 3 * len(reader.map.sensors)
        self.hand = reader.hand
        self.zero = reader.zero
        self._looked_ns = clock.now_ns()
        report(
            f"{feed.name}: {self.n_channels // 3} sensors in {self.unit} at "
            f"{self.rate_hz:.4g} Hz, stamps of arrival"
            + (f"; {dropped:,} samples before that are dropped" if dropped else "")
            + (f"; {self.losses}" if self.losses else "")
        )

    @property
    def losses(self) -> str:
        """What makes its rate smaller than that of its sender, in words; "" for nothing."""
        found = []
        # dropped samples had come
        kinds = (NOT_UNDERSTOOD, SAME_STAMP, NOT_RISING)
        skipped = {kind: self.skipped.total[kind] for kind in kinds}
        # fewer cannot bring a rate out of its tolerance
        if sum(skipped.values()) > 0.5 * RATE_TOLERANCE * self._n_lines:
            each = [f"{n:,} {kind}" for kind, n in skipped.items() if n]
            what = f"{sum(skipped.values()):,} of {self._n_lines:,} lines were skipped"
            found.append(f"{what}: {', '.join(each)}")
        port = self._feed.bytes_per_s
        if port and self._n_lines and self.rate_hz:
            # with its line end
            length = self._n_bytes / self._n_lines + 1.0
            if self.rate_hz * length > FULL * port:
                found.append(
                    f"the port is full: at {port * BITS_A_BYTE:.0f} baud it carries "
                    f"{port / length:.3g} lines of {length:.0f} bytes a second"
                )
        return "; ".join(found)

    def _collect_first(self, rate_hz: float | None) -> None:
        """Wait for one sample, or for enough of them to measure the rate. Raises DeviceNotFound."""
        came = self.waiting
        enough = 1 if rate_hz else MEASURE_LINES
        least_ns = 0 if rate_hz else round(1e9 * (SETTLE_S + MEASURE_S))
        until_ns = self.clock.now_ns() + round(1e9 * FIRST_S)
        while not self.ended and self.clock.now_ns() < until_ns:
            self.collect(LOOK_S)
            if len(came) >= enough and came[-1].t_ns - came[0].t_ns >= least_ns:
                return
        if not came:
            raise self._no_sample()

    def _no_sample(self) -> DeviceNotFound:
        cause = "its sender does not run, or its lines had come before this program ran"
        next_step = "start the sender; docs/on-a-hand.md shows the lines"
        if refused := self.skipped.total.most_common(1):
            kind, count = refused[0]
            cause = f"{count:,} lines were {kind}, as the message above shows"
            next_step = f"correct the lines, or {NAME_A_MAP}"
        elif self._feed.unfinished:
            cause = f"{self._feed.unfinished:,} bytes came, and no end of a line"
            next_step = "baud= as its sender has it, and a line end after each sample"
        elif self.ended:
            cause = "its input is at its end (</dev/null, or a sender that failed)"
        return DeviceNotFound(
            "it ended before a sample came"
            if self.ended
            else f"no sample came in {FIRST_S:g} s",
            where=self._feed.name,
            cause=cause,
            next_step=next_step,
        )

    def _measured_hz(self) -> float:
        """Of the arrivals. Raises RateError."""
        came_ns = np.array([one.t_ns for one in self.waiting])
        steps = np.diff(came_ns[came_ns >= came_ns[0] + 1e9 * SETTLE_S])
        if not steps.sum() > 0:
            raise RateError(
                "its rate cannot be measured",
                where=self._feed.name,
                cause="too few samples",
                next_step="add rate_hz=150 to the URL",
            )
        return float(1e9 / steps.mean())

    def read(self) -> SourceReading | None:
        """The next sample, or the last reading again with no sensor valid; None at the end."""
        paused_ns = self.clock.now_ns() - self._looked_ns
        if paused_ns > self.periods_ns(PAUSE_PERIODS):
            self.count_dropped(self._drop_waiting(), "nothing was read")
        reading = super().read()
        self._looked_ns = self.clock.now_ns()
        return reading

    def close(self) -> None:
        if self.ended:
            self._report(f"{self._feed.name}: its lines ended")
        self.skipped.close()
        self._feed.close()

    def _drop_waiting(self) -> int:
        """Drop what came while nothing was read; headers count. Returns how many samples."""
        dropped = 0
        for _ in range(MOST_DROPPED):
            pulled = self.collect(0.0)
            dropped += len(self.waiting)
            self.waiting.clear()
            if not pulled:
                break
        return dropped

    def collect(self, timeout_s: float) -> bool:
        """Take what comes; wait at most so long for the first bytes. Whether a line came."""
        lines = self._feed.pull(timeout_s)
        self.ended = self._feed.ended
        arrived_ns = self.clock.now_ns()
        for text in lines:
            self._n_lines += 1
            self._n_bytes += len(text)
            try:
                reading = self._reader.take(text, arrived_ns)
            except LineRefused as error:
                shown = f"{printable(text)} is skipped: {error}"
                self.skipped.count(error.kind, shown)
                continue
            if reading is not None:
                self.waiting.append(reading)
        return bool(lines)
