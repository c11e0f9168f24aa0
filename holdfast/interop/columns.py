"""What columns hold: the time, the unit of the readings.

A time is what a heading calls so, or what rises in steps that are alike; a column of few values, a
counter or a flag is none. A unit is what the names say, or what a press of people would be in.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from holdfast.core.column_map import LATEST_NS, NS_OF, TimeColumn
from holdfast.core.contract import NORMAL_AXIS, FloatArray
from holdfast.core.trial_file import FASTEST_HZ, SLOWEST_HZ
from holdfast.interop.evidence import Evidence, best
from holdfast.interop.formats.streams import (
    LOG_TIME,
    Column,
    Columns,
    is_text,
    unwrapped,
)
from holdfast.interop.words import (
    NO_CLOCK,
    NO_UNIT,
    SIGNAL_UNITS,
    TIME,
    UNIT_WORD,
    meaning,
    says,
    unit_of_time,
)

JUMP = 2.0**16
"""Of a reading of 16 bits that goes over its end."""
JUDGED_ROWS = 50_000
FEWEST_STAMPS = 20
"""A column with fewer values is no clock."""
FASTEST_UNNAMED_HZ = 2000.0
"""Where no name says the unit: 4 rows a second in s are 4000 in ms."""
SECOND_NS = NS_OF["s"]
CLOCK_NS = 10 * SECOND_NS
"""Dates and times of day are whole numbers of ns, and larger."""
ALIKE, EVENLY = 0.6, 0.9
"""So large a share of a clock's steps are alike; of one without a name."""
AS_HEAD = 0.1
"""So near to the rate in the head of a log is that of its clock, of it."""
BRACKETS = re.compile(rf"[\[(](?!(?:{NO_UNIT})[\])])(.+?)[\])]")
"""What stands in the brackets of a name, but for words that are no unit."""
UNITS_FIRST = {None: 1, "count": 2}
"""Of what stands in brackets; 0 for units of force and of field."""
FIELD = re.compile(r"(?i)(?<![a-z])(b[xyz](?![a-z])|mag)")
"""A name of a field, whose size is no press."""
PRESS_N = (0.2, 60.0)
"""A press of people, N."""
TARED = 0.25
"""Of a change: readings that rest nearer to 0 were tared."""
PRELOAD_N, PRELOAD_RANGE_N = 25.0, 7.0
"""At which the thesis' fingertips rest, N."""


# -- time


def find_time(
    columns: Columns, given_hz: float | None = None, head_hz: float | None = None
) -> Evidence[TimeColumn] | None:
    """The time of a table; None where it must be asked.

    given_hz: of the command line, which wins over all columns. head_hz: as the lines above say.
    """
    counter = ""
    rising = []
    for name, column in columns.items():
        step, alike, counts = rise_of(column)
        if counts and not unit_of_time(name):
            # one that begins anew, but for that of 8, 16 or 32 bits, counts no rows
            signs = np.sign(np.diff(unwrapped(column, 1.0)))
            if not counter and np.ptp(signs) < 2:
                counter = name
        elif step:
            rising.append((name, column, step, alike))
    if given_hz:
        return _counted(counter, given_hz, "as given")
    if LOG_TIME in columns:
        return Evidence(TimeColumn(LOG_TIME, "ns"), "stamps of the log")
    found = best(*(_clock(*one, head_hz) for one in rising))
    # the rate of a head that a clock contradicts may be that of a camera
    if head_hz and found is None and not any(_clock(*one) for one in rising):
        return _counted(counter, head_hz, "by the head of the log")
    return found


def _counted(counter: str, hz: float, why: str) -> Evidence[TimeColumn]:
    """Rows at a rate; counter: a column that counts them, "" for none."""
    text = f"{counter} counts samples" if counter else "rows are counted"
    return Evidence(TimeColumn(counter, None, hz), f"{text}, {hz:g} Hz, {why}")


def _clock(
    name: str, column: Column, step: float, alike: float, head_hz: float | None = None
) -> Evidence[TimeColumn] | None:
    """A column that rises by a step as a clock; None where it is none, or its unit not clear.

    One that is called so, or has no name: another quantity may rise evenly, too. head_hz: the rate
    that a clock without a unit must have.
    """
    is_date = column.dtype.kind == "i" and column.max() > CLOCK_NS
    named = unit_of_time(name)
    is_named = named or says(name, TIME)
    falls = np.count_nonzero(np.diff(column) < 0) > 1
    is_part = falls and is_part_of_second(column, NS_OF.get(named or "", 0))
    if is_part or (NO_CLOCK.search(name) and not is_date):
        return None
    judged = column[:JUDGED_ROWS]
    n_values = len(np.unique(judged))
    if is_named or is_date:
        is_clock = alike > ALIKE and (n_values >= FEWEST_STAMPS or is_date)
    else:
        # an unnamed one has a value for each row
        share = min(alike, n_values / len(judged))
        is_clock = name.startswith("column") and share > EVENLY
    if not is_clock:
        return None
    units = [named] if named else [*NS_OF]
    slowest, fastest = SLOWEST_HZ, FASTEST_HZ if named else FASTEST_UNNAMED_HZ
    check = "rises in steps that are alike"
    if named or (is_named and is_date):
        check = ""
    elif head_hz:
        slowest, fastest = (1.0 - AS_HEAD) * head_hz, (1.0 + AS_HEAD) * head_hz
        check = "as fast as the head of the log says"
    for unit in units:
        hz = 1e9 / (step * NS_OF[unit])
        is_late = column[0] > LATEST_NS / NS_OF[unit]
        if slowest <= hz <= fastest and not is_late:
            why = f"{name}, {hz:.4g} Hz, in {unit}"
            return Evidence(TimeColumn(name, unit), why, check)  # type: ignore[arg-type]

    return None


def rise_of(column: Column) -> tuple[float, float, bool]:
    """(the usual step of a column that rises, the share of such steps, whether it counts by 1).

    The step is 0.0 for a column that does not rise.
    """
    if is_text(column):
        return 0.0, 0.0, False
    first = column[:JUDGED_ROWS].astype(np.float64)
    values = first[np.isfinite(first)]
    if len(values) and values[-1] < values[0] and np.median(np.diff(values)) < 0:
        # the newest row may stand first
        values = values[::-1]
    steps = np.diff(values)
    if len(values) < 0.9 * len(first) or not steps.any() or np.mean(steps < 0) > 0.05:
        return 0.0, 0.0, False
    step = max(0.0, usual_step(values))
    # of stamps that arrive in bursts, or have whole seconds, sums of steps are alike
    n_equal = len(values) // len(np.unique(values))
    lag = min(max(50, 3 * n_equal), len(values) // 2)
    sums = (values[lag:] - values[:-lag]) / lag
    alike = max(np.mean(np.abs(one - step) <= 0.6 * step) for one in (steps, sums))
    return step, float(alike), bool(np.mean(steps == 1.0) > 0.9)


def is_part_of_second(column: Column, unit_ns: int) -> bool:
    """Whether whole numbers in a unit of time stay below a second."""
    is_within = (column >= 0) & (column * unit_ns < SECOND_NS)
    return 0 < unit_ns < SECOND_NS and bool(is_within.all())


def usual_step(values: FloatArray) -> float:
    """The usual step of stamps [T], also of stamps that arrive in bursts; 0 for none."""
    lag = max(1, min(len(values) // 10, 50))
    step = float(np.median(values[lag:] - values[:-lag])) / lag
    steps = np.diff(values)
    changes = np.flatnonzero(steps) + 1
    if np.mean(steps == 0) > 0.2 and len(changes) > 1:
        first, last = changes[0], changes[-1]
        step = float(values[last] - values[first]) / float(last - first)

    return step


# -- units


def unit_of(
    names: Sequence[str], values: FloatArray, effects: FloatArray, head: str
) -> Evidence[str]:
    """The unit of channels [T, C] by their names, such as `x [mN]`; "" where it must be asked.

    By the size of a press, where no unit is written and a press of people fits one unit only.
    effects [2, C]: of a touch. head: words for it in the head of the log, and beside the readings.
    """
    written = {*map(_unit_behind, names)}
    if written == {""}:
        # also the units of other quantities stand in a head
        written = {word for word in head.split() if not unit_of_time(word)}
    elif len(written) > 1 and not any(map(unit_named, written)):
        # words that differ from name to name may be those of sensors
        written = set()
    if written:
        unit, *others = {*map(unit_named, written)}
        words = ", ".join(sorted(written))
        if others or unit is None:
            return Evidence("", f"the log says {words}")
        return Evidence(unit, f"{words} in names, head or beside them")

    rest = np.abs(effects[0]).reshape(-1, 3)
    normal, shear = rest[:, NORMAL_AXIS], rest[:, :NORMAL_AXIS]
    middle = float(np.median(normal))
    change = float(np.nanquantile(np.abs(values[::7] - effects[0]), 0.99))
    sizes = f"at rest {middle:.3g}, changes of {change:.3g}"
    if (np.nan_to_num(values[::7]) % 1 == 0).all():
        return Evidence("", f"whole numbers, {sizes}")
    for unit, size in (("N", 1.0), ("mN", 1e3)):
        # the thesis' fingertips rest under a load on the normal alone
        is_loaded = np.abs(normal / size - PRELOAD_N) < PRELOAD_RANGE_N
        is_loaded &= shear.max(axis=1) < 0.2 * normal
        is_at_rest = middle < TARED * change or is_loaded.mean() >= 0.5
        is_press = PRESS_N[0] < change / size < PRESS_N[1]
        if is_at_rest and is_press and not FIELD.search(names[0]):
            bounds = f"a press lies between {PRESS_N[0]:g} and {PRESS_N[1]:g} N"
            return Evidence(unit, f"by size, {sizes}", bounds)
    return Evidence("", sizes)


def unit_named(text: str) -> str | None:
    """The unit that a text is as a whole, as `lb-f` is pounds; None for another one."""
    return meaning(re.sub(r"[\s._()\[\]-]", "", text), SIGNAL_UNITS)


def _unit_behind(name: str) -> str:
    """What stands in brackets, else a unit, else the last word behind the axis; "" for none.

    Of two brackets the one that is a unit; `raw` and the like stand beside one.
    """
    phrases = BRACKETS.findall(name)
    if phrases:
        return min(phrases, key=lambda one: UNITS_FIRST.get(unit_named(one), 0))
    _, *behind = re.split(r"(?i)[xyz](?![a-z])", name)
    words = re.findall(r"[^\W\d_]+", behind[-1]) if behind else []
    last = words[-1] if words else ""
    unit = UNIT_WORD.search(name)
    if unit and not unit_named(last):
        return unit[0]
    return "" if re.fullmatch(NO_UNIT, last) else last


def channels(columns: Mapping[str, Column], names: Sequence[str]) -> FloatArray:
    """[T, C] columns as numbers."""
    return np.stack([np.asarray(columns[name], float) for name in names], axis=1)


def without_codes(values: FloatArray) -> FloatArray:
    """Readings [T, C]; what is the same on all axes of a sensor and larger than all else is nan.

    As -9999 is, for a missing reading.
    """
    for sensor in np.split(values, values.shape[1] // 3, axis=1):
        same = (sensor == sensor[:, :1]).all(axis=1)
        if same.any() and not same.all():
            largest = np.nanmax(np.abs(sensor[~same]), initial=0.0)
            sensor[same & (np.abs(sensor[:, 0]) > largest)] = np.nan
    return values


def without_jumps(values: FloatArray, size: float = 1.0) -> FloatArray:
    """Readings [T, C] of 16 bits that went over their end, on one line; size: of a bit."""
    for channel in values.T:
        # a missing reading would make all behind it missing
        there = np.isfinite(channel)
        channel[there] = np.unwrap(channel[there], period=JUMP * size)
    return values
