"""One trial as a CSV file: `Time` in seconds first, then X1,Y1,Z1 .. Xn,Yn,Zn.

The recorder adds columns of its own (host_ns, device_us, sequence, valid1 .. validn). A run adds
prepared_N (or another unit): sign and zero are removed, the zero being that of the first samples
(1) or a measured one (2). Any other column is an error, because it may be a mistake. An axis that
the hand card says is not measured has no column, or empty cells; it is read as 0.0. If there is a
column `sequence`, the samples that it skips were lost; they become invalid rows instead of a gap.
"""

from __future__ import annotations

import csv
import re
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO, TypeVar

import numpy as np

from holdfast.core.contract import (
    UNITS,
    BoolArray,
    FloatArray,
    IntArray,
    Unit,
    channel_names,
    is_rate,
    valid_names,
)
from holdfast.core.errors import (
    ChannelError,
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    TimeError,
    command,
    count_of,
    listed,
)
from holdfast.core.trial_layout import HAND_FILE, TACTILE

if TYPE_CHECKING:
    from holdfast.core.hand_card import HandCard

TimeUnit = Literal["s", "ms", "us", "ns"]
TIME_COLUMN = "Time"
TIME_COLUMNS: dict[str, TimeUnit] = {
    TIME_COLUMN: "s",
    "t_s": "s",
    "t_ms": "ms",
    "t_us": "us",
    "t_ns": "ns",
}
"""The name of a column of time -> its unit."""
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_CHANNEL = re.compile("[XYZ][0-9]{1,3}")
Zero = Literal["first samples", "measured"]
PREPARED: dict[str, Unit] = {f"prepared_{unit}": unit for unit in UNITS}
"""The column of a file whose values have lost sign and zero -> their unit."""
RECORDER_COLUMNS = ("host_ns", "device_us", "sequence", *PREPARED)
ZEROS: tuple[Zero, ...] = ("first samples", "measured")
"""What the zero of such a file is, by the number in that column, from 1."""
MIN_ROWS = 2
LONGEST_S, LATEST_S = 1e6, 1e12
SLOWEST_HZ, FASTEST_HZ = 5.0, 5000.0
"""Of a hand: slip is not seen more slowly, and no such sensor is faster."""
UNITS_OF_TIME_S = {
    "milliseconds": 1e-3,
    "microseconds": 1e-6,
    "nanoseconds": 1e-9,
    "minutes": 60.0,
    "days": 86400.0,
}
"""What a time that should be in seconds may be in."""
MOST_ROWS = 2_000_000
"""A gap that makes more of them is no loss of samples."""
Times = TypeVar("Times", FloatArray, IntArray)


def block_means(
    times: Times, values: FloatArray, valid: BoolArray, n: int
) -> tuple[Times, FloatArray, BoolArray]:
    """times [T], values [T, C] and valid [T, S] of every n samples as one, at the last one's time.

    What is left over is dropped. A mean of whole blocks, so that little folds back. A sensor is
    valid where more than half of its samples are, and its mean is of these.
    """
    blocks = len(values) // n
    by_sensor = values[: blocks * n].reshape(blocks, n, -1, 3)
    usable = np.isfinite(by_sensor).all(axis=3)
    usable &= valid[: blocks * n].reshape(blocks, n, -1)
    count = usable.sum(axis=1)
    total = np.where(usable[..., None], by_sensor, 0.0).sum(axis=1)
    means = total / np.maximum(count, 1)[..., None]
    return times[n - 1 :: n], means.reshape(blocks, -1), 2 * count > n


@dataclass(frozen=True)
class Trial:
    """A trial file as read: t_s [T] from zero, raw [T, C] in the file's unit, valid [T, C/3].

    rows: which of them stand in the file, the others were lost; None for all. zero: what was
    removed from raw, None for nothing. unit: where the file itself names it. denied: columns with
    numbers other than 0, of axes that the hand card says are not measured; raw has 0.0 there.
    """

    path: Path
    t_s: FloatArray
    raw: FloatArray
    valid: BoolArray
    rows: IntArray | None = None
    zero: Zero | None = None
    unit: Unit | None = None
    denied: tuple[str, ...] = ()

    @property
    def rate_hz(self) -> float:
        """Sampling rate by the median time of a tenth of the trial.

        Single steps are rounded or late.
        """
        # over a tenth of the trial, rounding and jitter of single steps average out
        lag = 1 + len(self.t_s) // 10
        return lag / float(np.median(self.t_s[lag:] - self.t_s[:-lag]))

    def averaged(self, n: int) -> Trial:
        """The same trial with the mean of every n samples, at the time of the last of them."""
        t_s, raw, valid = block_means(self.t_s, self.raw, self.valid, n)
        return replace(self, t_s=t_s, raw=raw, valid=valid, rows=None)


def line_of_row(row: int) -> str:
    """Where a row from 0 stands in a trial file, whose first line is the header."""
    return f"line {row + 2}"


def implausible_rate(rate_hz: float) -> str:
    """What a rate that no hand has looks like; "" for one that a hand may have.

    >>> implausible_rate(0.1)
    'runs at 0.1 Hz: looks like milliseconds (100 Hz)'
    """
    if SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        return ""
    runs = f"runs at {rate_hz:.4g} Hz"
    for unit, seconds in UNITS_OF_TIME_S.items():
        truly_hz = rate_hz / seconds
        if SLOWEST_HZ <= truly_hz <= FASTEST_HZ:
            return f"{runs}: looks like {unit} ({truly_hz:.4g} Hz)"
    return f"{runs}: no time in seconds"


def read_trial(path: str | Path, hand: HandCard | None = None) -> Trial:
    """Read and check one trial file.

    hand: its card, which says what is not measured; None where all is. Raises DataNotFound,
    EmptyRecording, ColumnError, ChannelError, NotANumber or TimeError; each names the place.
    """
    path = Path(path)
    header = _header(path)
    absent = hand.unmeasured_names if hand else ()
    n_sensors = check_columns(header, path, absent)
    if hand and absent and hand.n_sensors != n_sensors:
        raise ChannelError(
            f"{n_sensors} sensors, and the hand card has {hand.n_sensors}",
            where=path,
            cause=f"{HAND_FILE} is the card of another hand",
            next_step="put the card back with which the set was recorded",
        )
    table = table_of(path, header, path, absent)
    if len(table) < MIN_ROWS:
        raise EmptyRecording(
            f"{count_of(len(table), 'row')} of data",
            where=path,
            cause="the recording stopped at once",
            next_step="record it again",
        )
    t_s = _check_time(SECONDS[TIME_COLUMNS[header[0]]] * table[:, 0], path)
    raw, denied = _channels(table, header, n_sensors, hand)
    valid = np.ones((len(table), n_sensors), dtype=np.bool_)
    # a sensor without such a column is valid
    for k, name in enumerate(valid_names(n_sensors)):
        if name in header:
            valid[:, k] = table[:, header.index(name)] != 0.0
    zero, unit = prepared_by(dict(zip(header, table[0], strict=True)))
    trial = Trial(path, t_s, raw, valid, zero=zero, unit=unit, denied=denied)
    # the counter of the recorder knows exactly what was lost; time alone only guesses
    if "sequence" in header:
        counted = table[:, header.index("sequence")]
        return _with_lost_rows(trial, _places_by_sequence(counted, path))
    return _with_lost_rows(trial, places_by_time(t_s))


def _channels(
    table: FloatArray, header: list[str], n_sensors: int, hand: HandCard | None
) -> tuple[FloatArray, tuple[str, ...]]:
    """([T, C] of a table, columns with numbers on axes that the card says are not measured)."""
    if hand is None or not hand.unmeasured_names:
        return table[:, 1 : 1 + 3 * n_sensors], ()
    # late, because most trials need none
    from holdfast.core.hand_card import fill_unmeasured

    raw = np.full((len(table), 3 * n_sensors), np.nan)
    for channel, name in enumerate(channel_names(n_sensors)):
        if name in header:
            raw[:, channel] = table[:, header.index(name)]
    has_numbers = (np.nan_to_num(raw) != 0.0).any(axis=0) & ~hand.measured
    names = np.array(channel_names(n_sensors))[has_numbers]
    return fill_unmeasured(raw, hand), tuple(names.tolist())


def prepared_by(row: Mapping[str, Any]) -> tuple[Zero | None, Unit | None]:
    """What was removed from the values of a row by its columns, and their unit; None for nothing.

    Raises ValueError for a cell that is no number.
    """
    for column, unit in PREPARED.items():
        if column in row:
            return ZEROS[float(str(row[column])) > 1.0], unit
    return None, None


def places_by_time(t_s: FloatArray) -> IntArray:
    """[T] the index of every row in a stream with the usual step."""
    steps = np.diff(t_s)
    places: IntArray = np.zeros(len(t_s), dtype=np.int64)
    # a step of two periods is one lost row
    places[1:] = np.cumsum(np.maximum(1, np.round(steps / np.median(steps))))
    return places


def _places_by_sequence(counted: FloatArray, path: Path) -> IntArray:
    """[T] the same from the column `sequence`, which counts every lost sample. Raises TimeError."""
    finite = (np.abs(counted) < LATEST_S).all()
    if not finite or (np.diff(counted) < 1.0).any() or (counted % 1.0).any():
        raise TimeError(
            "the column sequence does not count up",
            where=path,
            cause="lines were moved, or the file holds two recordings",
            next_step="record again",
        )
    place: IntArray = (counted - counted[0]).astype(np.int64)
    return place


def _with_lost_rows(trial: Trial, place: IntArray) -> Trial:
    """The trial with a row of nan, marked invalid, for every sample that never came.

    No later stage then takes the rows around a gap for neighbours in time. Raises TimeError.
    """
    if place[-1] == len(place) - 1:
        return trial
    if place[-1] >= MOST_ROWS:
        at = int(np.argmax(np.diff(place)))
        raise TimeError(
            f"a gap of {trial.t_s[at + 1] - trial.t_s[at]:.6g} s after {at + 1} rows",
            where=trial.path,
            cause="the file holds two recordings, or the clock was set",
            next_step="split the file there",
        )
    rows = np.arange(place[-1] + 1)
    raw = np.full((len(rows), trial.raw.shape[1]), np.nan)
    valid = np.zeros((len(rows), trial.valid.shape[1]), dtype=np.bool_)
    # rows that never came stay nan and invalid
    raw[place], valid[place] = trial.raw, trial.valid
    t_s = np.interp(rows, place, trial.t_s)
    return replace(trial, t_s=t_s, raw=raw, valid=valid, rows=place)


def _header(path: Path) -> list[str]:
    """The names of the columns. Raises DataNotFound, EmptyRecording or NotANumber."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as lines:
            header = next(csv.reader(lines), [])
    except FileNotFoundError:
        raise DataNotFound(
            "no such file", where=path, next_step="check the path"
        ) from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise NotANumber(
            f"cannot be read as a CSV text file ({type(error).__name__})",
            where=path,
            cause="it is a binary file or a folder, not a trial",
            next_step="give a CSV file in the layout Time,X1,Y1,Z1,..",
        ) from None
    if not header:
        raise EmptyRecording(
            "the file is empty",
            where=path,
            cause="the copy was interrupted",
            next_step="record or copy it again",
        )
    return [name.strip() for name in header]


def check_columns(header: list[str], path: Path, absent: Collection[str] = ()) -> int:
    """Number of sensors, or a ColumnError that names the columns. absent: these may be missing."""
    numbers = [int(name[1:]) for name in header if _CHANNEL.fullmatch(name)]
    n_sensors = max(numbers, default=1)
    time = header[0] if header[0] in TIME_COLUMNS else TIME_COLUMN
    optional = set(absent).difference(header)
    expected = [time]
    expected += [one for one in channel_names(n_sensors) if one not in optional]
    known = {*expected, *RECORDER_COLUMNS, *valid_names(n_sensors)}
    missing = [name for name in expected if name not in header]
    unknown = [name for name in header if name not in known]
    if missing:
        what = f"columns missing: {listed(missing)}"
    elif unknown:
        what = f"unknown columns: {listed(unknown)}"
    elif header[: len(expected)] != expected or len(set(header)) < len(header):
        what = "columns are out of order, or one occurs twice"
    else:
        return n_sensors
    fix = "the layout is Time,X1,Y1,Z1,X2,.. with three columns a sensor, and no others"
    if missing and not any(name.startswith("Z") for name in [*missing, *unknown]):
        fix += f"; an axis that no sensor measures: say so in {HAND_FILE} (docs/scenes.md, hands)"
    raise ColumnError(what, where=path, next_step=fix)


def says_no(cell: object) -> bool:
    """Whether a cell of a column valid1, valid2, .. means that the sensor is not valid.

    >>> [says_no(cell) for cell in (0, "0.0", "False", False, 1, "True", "")]
    [True, True, True, True, False, False, False]
    """
    word = str(cell).strip().lower()
    try:
        return word == "false" or float(word) == 0.0
    except ValueError:
        return False


def _flag(cell: str) -> float:
    """A cell of a column valid1, valid2, .. as a number. Raises ValueError."""
    return float({"true": "1", "false": "0"}.get(cell.strip().lower(), cell))


def table_of(
    lines: Path | TextIO, header: list[str], path: Path, absent: Collection[str] = ()
) -> FloatArray:
    """[T, columns] of numbers in lines below a header; absent: columns that may have empty cells.

    Raises NotANumber or ColumnError.
    """
    may_be_empty = [k for k, name in enumerate(header) if name in absent]
    cells: dict[int, Any] = dict.fromkeys(may_be_empty, _number_or_nan)
    try:
        with warnings.catch_warnings():
            # numpy warns about a table without rows; its reader says it better
            warnings.simplefilter("ignore", UserWarning)
            read = partial(
                np.loadtxt,
                lines,
                delimiter=",",
                skiprows=1,
                ndmin=2,
                comments=None,
                quotechar='"',
                encoding="utf-8-sig",
                converters=cells or None,
            )
            try:
                table = read()
            except ValueError:
                flags = [k for k, name in enumerate(header) if name.startswith("valid")]
                if not flags or not isinstance(lines, Path):
                    raise
                # True and False; read apart, because a function for each cell costs time
                table = read(converters=cells | dict.fromkeys(flags, _flag))
    except ValueError as error:
        raise _bad_table(str(error), header, path) from None
    if table.size and table.shape[1] != len(header):
        raise _other_count(f"each line has {table.shape[1]} cells", header, path)
    return table


def _number_or_nan(cell: str) -> float:
    return float(cell.strip() or "nan")


def _bad_table(said: str, header: list[str], path: Path) -> NotANumber | ColumnError:
    """The error for a table that numpy does not read; said: numpy's own message."""
    found = re.search(
        r"(?:string (.+) to float\d+|to (\d+)) at row (\d+)(?:, column (\d+))?", said
    )
    if found is None:
        what = "the table cannot be read"
    elif found[2]:
        # numpy counts these rows from 1
        line = line_of_row(int(found[3]) - 1)
        return _other_count(f"{line} has {found[2]} cells", header, path)
    else:
        column = dict(enumerate(header, 1)).get(int(found[4]), found[4])
        line = line_of_row(int(found[3]))
        what = f"{line}, column {column}: {found[1]:.42} is not a number"
    return NotANumber(
        what,
        where=path,
        cause="text or an empty cell in the data",
        next_step=_repair(
            path, "write plain decimal numbers, and nan for a value that was lost"
        ),
    )


def _other_count(what: str, header: list[str], path: Path) -> ColumnError:
    return ColumnError(
        f"{what}, the header has {len(header)}",
        where=path,
        cause="the line was cut off while it was written",
        next_step=_repair(path, "remove that line"),
    )


def _repair(path: Path, otherwise: str) -> str:
    """What to do about a bad line: where the last line is torn, a recording can be repaired."""
    if path.is_file() and not path.read_bytes().endswith(b"\n"):
        if path.name == TACTILE:
            return command("check", path.parent, "--repair")
        return "remove the last line, which was cut off"
    return otherwise


def _check_time(time_s: FloatArray, path: Path) -> FloatArray:
    """Time from zero, or a TimeError that names the row."""
    impossible = np.flatnonzero(~(np.abs(time_s) < LATEST_S))
    if len(impossible):
        raise TimeError(
            f"{line_of_row(impossible[0])}: time is not finite, or impossibly large",
            where=path,
            next_step="remove that line",
        )
    steps = np.diff(time_s)
    backwards = np.flatnonzero(steps <= 0.0)
    if len(backwards):
        at = backwards[0]
        word = f"runs backwards by {-steps[at]:.6g} s" if steps[at] else "stands still"
        cause = "the clock was set, or the file holds two recordings"
        next_step = "split the file there"
        n_equal = int((steps == 0.0).sum())
        if n_equal > 1:
            word += f", as in {n_equal} lines"
            cause = "its clock ticks too seldom, or its times have too few digits"
            next_step = "write finer times, or import it with rate_hz in its map"
        raise TimeError(
            f"{line_of_row(at + 1)}: time {word}",
            where=path,
            cause=cause,
            next_step=next_step,
        )
    median = float(np.median(steps))
    from_zero: FloatArray = time_s - time_s[0]
    if not is_rate(1.0 / median) or from_zero[-1] > LONGEST_S:
        raise TimeError(
            f"{from_zero[-1]:.4g} s in steps of {median:.4g} s",
            where=path,
            next_step="give the column Time in seconds",
        )
    return from_zero
