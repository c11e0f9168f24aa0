"""What columns hold: the time and its unit, sensors and their axes, the unit of the readings.

What a column holds is looked at before what it is called. A time rises in nearly even steps that
make the rate of a hand. Sensors are the columns whose names differ in an axis alone; without such
names three columns each, in their order.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.column_map import NS_OF, SensorColumns, TimeColumn
from holdfast.core.contract import AXES, NORMAL_AXIS, NORMAL_FLOOR, UNIT_OF, FloatArray
from holdfast.core.trial_file import FASTEST_HZ, SLOWEST_HZ, TimeUnit
from holdfast.interop.logs import counted
from holdfast.interop.streams import LOG_TIME, Column, Columns, is_text

TIME_WORDS = {
    "time", "timestamp", "stamp", "t", "clock", "elapsed", "when", "date", "datetime"
}  # fmt: skip
TIME_UNITS = {
    "s": "s|secs?|seconds?",
    "ms": "ms|msec|millis|milliseconds?",
    "us": "[uµμ]s|usec|micros|microseconds?",
    "ns": "ns|nsec|nanos|nanoseconds?",
}
SIGNAL_UNITS = {
    "N": "N|(?i:newtons?)",
    "mN": "(?i:mn|millinewtons?)",
    "gf": "g|(?i:gf|grams?)",
    "uT": "(?i:[uµμ]t|microteslas?)",
    "mT": "(?i:mt|milliteslas?)",
    "G": "G|(?i:gs|gauss)",
    "T": "T|(?i:teslas?)",
    "count": "(?i:counts?|raw|adc|lsb|digits)",
}
"""Unit -> its words; G is gauss and g is gram."""
NO_SENSOR = {
    "torque", "translation", "rotation", "quaternion", "orientation", "covariance", "gyro", "pose",
    "position", "pos", "angular", "velocity", "vel", "acc", "accel", "acceleration", "imu", "joint",
    "marker", "transform", "action", "state",
}  # fmt: skip
"""Words of three axes that are no reading of a fingertip."""
TOUCH = re.compile(
    r"(?i)tactile|force|touch|taxel|finger|pressure|hall|sensor|\bft(?![a-z])"
)
FIELD = re.compile(r"(?i)(?<![a-z])(b[xyz](?![a-z])|mag)")
FORCE = re.compile(r"(?i)force|(?<![a-z])f[xyz](?![a-z])")
AXIS_FORMS = (
    re.compile(r"(?i)(?<![a-z])[fb]?([xyz])(?![a-z])"),
    re.compile(r"(?<=[a-z0-9])([XYZ])(?![a-zA-Z])"),
    re.compile(r"(?i)[fb]?([xyz])(?![a-z])"),
    re.compile(r"(?i)(?<![a-z])[fb]?([xyz])"),
)
"""An axis in a name: a letter on its own, behind a small one, at the end of a word, before it."""
AXIS_WORDS = (
    (re.compile(r"(?i)normal"), " z "),
    (re.compile(r"(?i)(shear|tangential|lateral)[_ .]?[2yb](?![0-9])"), " y "),
    (re.compile(r"(?i)(shear|tangential|lateral)[_ .]?[1xa]?(?![0-9])"), " x "),
)
"""Words for axes."""
TOUCHED = 0.2
"""A hand touches something while its readings are so far from rest, of their 95 % quantile."""
FIRST_ROWS = 10
CLEARLY = 3.0
"""How much larger a change is that contradicts the names."""
PRESS_N = (0.2, 20.0)
"""Changes of readings in N: a grip of so little in grams holds nothing."""
TARED = 0.25
"""Of a change: readings that rest nearer to 0 were tared."""
PRELOAD_N = (18.0, 32.0)
"""At which the thesis' fingertips rest, N."""


def words_of(name: str) -> set[str]:
    """Lower-case words, also the parts of `thumbX`: thumb and x."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return {word.lower() for word in re.findall(r"[^\W\d_]+", f"{name} {parted}")}


def _unit_in(words: Iterable[str], units: Mapping[str, str]) -> str | None:
    """The unit that words name."""
    for unit, form in units.items():
        if any(re.fullmatch(form, word) for word in words):
            return unit

    return None


# -- time

Candidate = tuple[tuple[float, ...], str, TimeUnit | None, float]


@dataclass(frozen=True)
class FoundTime:
    """A column of time, or one that counts samples at a rate. why: in words."""

    time: TimeColumn
    why: str


def find_time(columns: Columns, rate_hz: float | None = None) -> FoundTime | None:
    """The time of a table; None where nothing runs like one and no rate is given."""
    if LOG_TIME in columns:
        return FoundTime(TimeColumn(LOG_TIME, "ns"), "stamps of the log")

    found: list[Candidate] = []
    for name, column in columns.items():
        if not is_text(column):
            found += _times_of(name, column)

    _, name, unit, hz = min(found, default=((), "", None, 0.0))
    if unit:
        why = f"{name}, {hz:.4g} Hz, in {unit} by its steps"
        return FoundTime(TimeColumn(name, unit), why)
    if rate_hz:
        what = f"{name} counts samples" if name else "rows are counted"
        time = TimeColumn(name, None, rate_hz)
        return FoundTime(time, f"{what}, {rate_hz:g} Hz as given")

    return None


def _times_of(name: str, column: Column) -> Iterator[Candidate]:
    """(rank, name, unit, rate) of a column that rises in steps of a hand's rate.

    The unit is None where it counts samples.
    """
    first = column[:50_000].astype(np.float64)
    values = first[np.isfinite(first)]
    steps = np.diff(values)
    if len(values) < 0.9 * len(first) or not steps.any():
        return
    step = usual_step(values)
    if np.mean(steps < 0) > 0.05 or step <= 0.0:
        return
    even = float(np.mean(np.abs(steps - step) <= 0.6 * step))
    named = unit_of_time(name)
    is_named = bool(named or words_of(name) & TIME_WORDS)
    # counts of trials and the like rise too, but rarely
    if even < 0.6 and not is_named and len(np.unique(values)) < len(values) / 50:
        return
    if np.mean(steps == 1.0) > 0.9 and not named:
        yield (2.0, -even), name, None, 0.0
        return
    for unit in filter(None, (named, *NS_OF)):
        hz = 1e9 / (step * NS_OF[unit])
        if SLOWEST_HZ <= hz <= FASTEST_HZ:
            yield (not is_named, -even), name, unit, hz  # type: ignore[misc]
            return


def unit_of_time(name: str) -> str | None:
    """The unit that a name of time has."""
    return _unit_in(words_of(name), TIME_UNITS)


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


# -- sensors


def find_sensors(
    columns: Columns, taken: Collection[str]
) -> tuple[list[SensorColumns], str]:
    """(the sensors of a table, why), in the order in which people count; none for another table."""
    names = []
    for name, column in columns.items():
        is_free = name != LOG_TIME and name not in taken
        # an IMU beside the fingers has axes too
        if is_free and not is_text(column) and not words_of(name) & NO_SENSOR:
            names.append(name)

    sensors = _by_axes(names)
    if sensors:
        return sensors, "by the axes in their names"
    rest = _by_count(names, columns)
    if not rest:
        return [], ""
    order = _order(
        np.stack([columns[name].astype(np.float64) for name in rest], axis=1)
    )
    is_plain = (np.diff(order.ravel()) == 1).all()
    by = "three columns each" if is_plain else "by the touch"
    found = [SensorColumns(*(rest[k] for k in row)) for row in order.tolist()]
    return found, f"no axes in the names: x, y, z {by}, {rest[0]} to {rest[-1]}"


def _by_axes(names: Sequence[str]) -> list[SensorColumns]:
    best: list[SensorColumns] = []
    for form in AXIS_FORMS:
        groups: dict[str, dict[str, str]] = {}
        for name in names:
            # what stands in brackets is a unit
            bare = re.sub(r"[\[(].*?[\])]", "", name)
            for word, axis in AXIS_WORDS:
                bare = word.sub(axis, bare)
            *_, at = [None, *form.finditer(bare)]
            if at:
                key = f"{bare[: at.start()]}*{bare[at.end() :]}"
                groups.setdefault(key, {}).setdefault(at[1].lower(), name)

        whole = [key for key, group in groups.items() if set(group) == set(AXES)]
        if len(whole) > len(best):
            best = [
                SensorColumns(**groups[key])  # type: ignore[arg-type]
                for key in _as_counted(whole)
            ]

    return best


def _as_counted(keys: Sequence[str]) -> list[str]:
    """Names as people count, 2 before 10; those of a thumb first, other words as they stand."""
    texts = [re.sub(r"\d+", "#", key) for key in keys]

    def place(key: str) -> tuple[Any, ...]:
        is_thumb = "thumb" in words_of(key)
        return not is_thumb, texts.index(re.sub(r"\d+", "#", key)), counted(key)

    return sorted(keys, key=place)


def _by_count(names: Sequence[str], columns: Columns) -> Sequence[str]:
    """The columns of readings, 3 n of them: the longest series, all, or those that change.

    A series are columns that differ in a number; those of touch come first.
    """
    series: dict[str, list[str]] = {"": []}
    for name in sorted(names, key=counted):
        series.setdefault(re.sub(r"\d+", "#", name), []).append(name)
    moving = [name for name in names if len(np.unique(np.diff(columns[name]))) > 1]

    longest = max(series, key=lambda one: (bool(TOUCH.search(one)), len(series[one])))
    for chosen in (series[longest], names, moving):
        if chosen and len(chosen) % 3 == 0:
            return chosen

    return []


def _order(values: FloatArray) -> np.ndarray:
    """[S, 3] places of x, y and z of columns without names [T, 3 S]: sensor by sensor.

    Or axis by axis, where a touch moves one of three columns only then.
    """
    by_sensor = np.arange(values.shape[1]).reshape(-1, 3)
    by_axis = by_sensor.reshape(3, -1).T
    change = touch(values).effects[1]
    shares = [_leading(change[order])[1] for order in (by_sensor, by_axis)]
    return by_axis if shares[1] > max(0.8, shares[0] + 0.2) else by_sensor


def _leading(changes: FloatArray) -> tuple[int, float]:
    """(the axis that a touch moves most, of how large a share of the sensors); changes [S, 3]."""
    change = np.abs(changes)
    change = change[change.sum(axis=1) > TOUCHED * change.sum(axis=1).max()]
    _, second, most = np.sort(change, axis=1).T
    axes = np.bincount(change.argmax(axis=1)[most > CLEARLY * second], minlength=3)
    axis = int(axes.argmax()) if axes.any() else NORMAL_AXIS
    return axis, axes[axis] / max(1, len(change))


# -- what a touch does


@dataclass(frozen=True)
class Touch:
    """effects [2, C]: the readings at rest, and their usual change while something is touched.

    rows [T]: where something is touched. returns: whether the readings end near their rest.
    """

    effects: FloatArray
    rows: np.ndarray
    returns: bool


NO_TOUCH = Touch(np.zeros((2, 0)), np.zeros(0, dtype=np.bool_), returns=True)
"""Of a table without readings."""


def touch(values: FloatArray) -> Touch:
    """What a hand that begins open reads while it touches something; values [T, C]."""
    rest = _middle(values[:FIRST_ROWS])
    load = np.zeros(len(values))
    for channel, at_rest in zip(values.T, rest, strict=True):
        load += np.abs(np.nan_to_num(channel - at_rest))
    rows = load > TOUCHED * max(np.quantile(load, 0.95), 1e-300)
    where = np.flatnonzero(rows)
    pressed = _middle(values[where[:: max(1, len(where) // 5000)]])
    effects = np.stack([rest, pressed - rest])
    return Touch(effects, rows, not rows[-FIRST_ROWS:].any())


def _middle(values: FloatArray) -> FloatArray:
    """[C] medians over the rows with a value; 0 without one."""
    middles: FloatArray = np.ma.median(np.ma.masked_invalid(values), axis=0).filled(0.0)
    return middles


def normal_axis(found: Touch) -> int:
    """The axis that most sensors clearly change along when they are touched; 2 where none is."""
    axis, share = _leading(found.effects[1].reshape(-1, 3))
    return axis if share >= 0.8 else NORMAL_AXIS


def oriented(
    sensors: Sequence[SensorColumns], found: Touch, unit: str, axis: int = NORMAL_AXIS
) -> list[SensorColumns]:
    """The sensors with signs and zeros such that a press raises their prepared normal.

    Preparation turns a sensor round whose normal rests below 0. Where all must be turned, the log
    has its z the other way; where some must be, their magnets are upside down. axis: the normal one
    of what was found.
    """
    ours, size = UNIT_OF[unit]
    rest, pressed = size * found.effects[:, axis::3]
    is_far = np.abs(rest) > NORMAL_FLOOR[ours]
    is_turned_later = is_far & (rest < 0.0)
    touched = np.abs(pressed) > TOUCHED * np.abs(pressed).max()
    wrong = touched & (np.where(is_turned_later, -pressed, pressed) < 0.0)
    # a press raises a field whatever its sign; counts above 0 hide the sign
    is_hidden = ours == "count" and bool((rest >= 0).all()) and found.returns
    wrong &= (np.abs(rest) < np.abs(pressed)) | is_hidden
    turned = list(sensors)
    for k in np.flatnonzero(wrong).tolist():
        axes = list(sensors[k].axes)
        first = NORMAL_AXIS if wrong.all() else 0
        if not is_turned_later[k]:
            axes[first:] = [f"-{name}" for name in axes[first:]]
        zero = [float(f"{2.0 * rest[k] / size:.4g}")] if is_far[k] else []
        turned[k] = SensorColumns(*axes, *zero)  # type: ignore[arg-type]

    return turned


# -- units


def unit_of(names: Sequence[str], values: FloatArray, found: Touch) -> tuple[str, str]:
    """(unit, why) of channels [T, C] by their names, such as `thumb_x [mN]`, else by their sizes.

    The unit is "" where several are as likely.
    """
    units = set()
    for name in names:
        # in brackets, or behind the axis
        behind = re.split(r"(?i)[xyz](?![a-z])", name)[-1]
        texts = [*re.findall(r"[\[(](.*?)[\])]", name), behind]
        units.add(_unit_in(re.findall(r"[^\W\d_]+", " ".join(texts)), SIGNAL_UNITS))
    named = units.pop()
    if named and not units:
        return named, "by the names"

    rests = np.abs(found.effects[0]).reshape(-1, 3)
    normal = rests[:, NORMAL_AXIS]
    rest = float(np.median(normal))
    change = float(np.nanquantile(np.abs(values[::7] - found.effects[0]), 0.99))
    sizes = f"at rest {rest:.3g}, changes of {change:.3g}"
    is_whole = all((np.nan_to_num(one) % 1 == 0).all() for one in values.T)
    if FIELD.search(names[0]):
        return ("uT" if rest >= 1500.0 else ""), f"a field, {sizes}"
    if is_whole and np.nanmin(values) >= 0 and rest > change:
        return "count", f"by size: {sizes}, whole numbers above 0"
    # the thesis' fingertips rest under a load on the normal alone
    loaded = (normal > PRELOAD_N[0]) & (normal < PRELOAD_N[1])
    loaded &= rests[:, :NORMAL_AXIS].max(axis=1) < 0.2 * normal
    is_tared = rest < TARED * change
    is_force = FORCE.search(names[0]) or is_tared or np.mean(loaded) >= 0.5
    is_press = PRESS_N[0] < change < PRESS_N[1] and not is_whole
    return ("N" if is_force and is_press else ""), f"by size: {sizes}"


def channels(
    columns: Mapping[str, Column], sensors: Sequence[SensorColumns]
) -> FloatArray:
    """[T, C] the readings of the sensors, without signs."""
    names = [name.removeprefix("-") for sensor in sensors for name in sensor.axes]
    return np.stack([np.asarray(columns[name], float) for name in names], axis=1)
