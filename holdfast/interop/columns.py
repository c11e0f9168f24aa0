"""What columns hold: the time and its unit, sensors and their axes, the unit of the readings.

What a column holds is looked at before what it is called. A time rises in nearly even steps that
make the rate of a hand. Sensors are the columns whose names differ in an axis alone; without such
names three columns each, in their order.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.core.column_map import NS_OF, SensorColumns, TimeColumn
from holdfast.core.contract import AXES, NORMAL_AXIS, NORMAL_FLOOR, UNIT_OF, FloatArray
from holdfast.core.trial_file import FASTEST_HZ, SLOWEST_HZ, TimeUnit
from holdfast.interop.streams import LOG_TIME, Column, Columns, counted, is_text

TIME_WORDS = {
    "time", "timestamp", "stamp", "t", "clock", "elapsed", "when", "date", "datetime"
}  # fmt: skip
TIME_UNITS = {
    "s": "s|secs?|seconds?",
    "ms": "ms|msec|millis|milliseconds?",
    "us": "[uµμ]s|usec|micros|microseconds?",
    "ns": "ns|nsec|nanos|nanoseconds?",
}
FEWEST_STAMPS = 20
FASTEST_UNNAMED_HZ = 2000.0
"""Where no name says the unit: 4 rows a second in s are 4000 in ms."""
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
BESIDE_FORCE = set("mtag")
"""Letters before an axis beside a force: of moments, torques, an accelerometer, a gyro."""
TOUCH = re.compile(
    r"(?i)tactile|force|touch|taxel|finger|pressure|hall|sensor|\bft(?![a-z])"
)
FIELD = re.compile(r"(?i)(?<![a-z])(b[xyz](?![a-z])|mag)")
FORCE = re.compile(r"(?i)force|(?<![a-z])f[xyz](?![a-z])")
NORMAL = re.compile(r"(?i)(?<![a-z])[fb]?z(?![a-z])|normal")
SHEAR = "(shear|tangential|lateral)([_ .]?force)?[_ .]?"
AXIS_WORDS = (
    (re.compile(r"(?i)normal([_ .]?force)?"), " z "),
    (re.compile(rf"(?i){SHEAR}[2yb](?![0-9])"), " y "),
    (re.compile(rf"(?i){SHEAR}[1xa]?(?![0-9])"), " x "),
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
PRELOAD_N, PRELOAD_RANGE_N = 25.0, 7.0
"""At which the thesis' fingertips rest, N."""


def words_of(name: str) -> set[str]:
    """Lower-case words, also the parts of `thumbX`: thumb and x."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    return {word.lower() for word in _words(f"{name} {parted}")}


def _words(text: str) -> list[str]:
    return re.findall(r"[^\W\d_]+", text)


def _unit_in(words: Collection[str], units: Mapping[str, str]) -> str | None:
    """The unit that words name."""
    for unit, form in units.items():
        if any(re.fullmatch(form, word) for word in words):
            return unit

    return None


# -- time


def find_time(columns: Columns, rate_hz: float | None = None) -> TimeColumn | None:
    """The time of a table; None where nothing runs like one and no rate is given."""
    if LOG_TIME in columns:
        return TimeColumn(LOG_TIME, "ns")
    found: list[tuple[bool, float, str, TimeUnit | None]] = []
    for name, column in columns.items():
        step, even, is_counter = rise_of(column)
        named = unit_of_time(name)
        is_named = bool(named or words_of(name) & TIME_WORDS)
        # counts of trials and the like rise too, but rarely; a few rows may do so by chance
        is_rare = 0.0 < even < 0.6 and len(set(column)) < len(column) / 50
        if not step or ((is_rare or len(column) < FEWEST_STAMPS) and not is_named):
            continue
        if is_counter and not named:
            found += [(True, 1.0, name, None)] if rate_hz else []
            continue
        fastest = FASTEST_HZ if named else FASTEST_UNNAMED_HZ
        for unit in (named,) if named else NS_OF:
            if SLOWEST_HZ <= 1e9 / (step * NS_OF[unit]) <= fastest:
                found.append((not is_named, -even, name, unit))  # type: ignore[arg-type]
                break

    if found:
        _, _, name, best = min(found, key=lambda one: one[:3])
        return TimeColumn(name, best, None if best else rate_hz)
    return TimeColumn("", None, rate_hz) if rate_hz else None


def rise_of(column: Column) -> tuple[float, float, bool]:
    """(the usual step of a column that rises, the share of such steps, whether it counts by 1).

    The step is 0.0 for a column that does not rise.
    """
    first = np.zeros(2) if is_text(column) else column[:50_000].astype(np.float64)
    values = first[np.isfinite(first)]
    steps = np.diff(values)
    if len(values) < 0.9 * len(first) or not steps.any() or np.mean(steps < 0) > 0.05:
        return 0.0, 0.0, False
    step = max(0.0, usual_step(values))
    even = np.mean(np.abs(steps - step) <= 0.6 * step)
    return step, float(even), bool(np.mean(steps == 1.0) > 0.9)


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
    columns: Columns, longest: Columns, marks: Collection[str]
) -> tuple[list[SensorColumns], str]:
    """(the sensors of a log, why), in the order in which people count; none for another table.

    By the names of all its columns, else by the count of those of its longest stream. marks: the
    columns that may hold labels.
    """
    names = []
    for name, column in columns.items():
        is_free = name != LOG_TIME and name not in marks
        # an IMU beside the fingers has axes too
        if is_free and not is_text(column) and not words_of(name) & NO_SENSOR:
            names.append(name)

    sensors = _by_axes(names)
    if sensors:
        return sensors, "by the axes in their names"
    names = [name for name in names if name in longest]
    rest = _by_count([one for one in names if not rise_of(longest[one])[0]], longest)
    if not rest:
        return [], ""
    order = _order(channels(longest, rest))
    is_plain = (np.diff(order.ravel()) == 1).all()
    by = "three columns each" if is_plain else "by the touch"
    found = [SensorColumns(*(rest[k] for k in row)) for row in order.tolist()]
    return found, f"no axes in the names: x, y, z {by}, {rest[0]} to {rest[-1]}"


def _by_axes(names: Sequence[str]) -> list[SensorColumns]:
    """The sensors whose three names differ in one letter alone: x, y or z, in any place."""
    groups: dict[str, dict[str, str]] = {}
    for name in names:
        text = name
        for word, axis in AXIS_WORDS:
            text = word.sub(axis, text)
        for at in re.finditer("(?i)[xyz]", text):
            key = f"{text[: at.start()]}*{text[at.end() :]}"
            groups.setdefault(key, {}).setdefault(at[0].lower(), name)

    letters = {}
    for key, group in groups.items():
        if len(group) == len(AXES):
            before = re.search(r"(?<![a-z])[a-z]?(?=\*)", key.lower())
            letters[key] = before[0] if before else ""
    # a force and its moments, such as Fx .. Mz, or readings and an IMU
    if {*letters.values()} - BESIDE_FORCE <= {"", "f"}:
        forces = {key: letter for key, letter in letters.items() if letter in ("", "f")}
        letters = forces or letters
    texts = [re.sub(r"\d+", "#", key) for key in letters]

    def place(key: str) -> tuple[Any, ...]:
        """As people count, 2 before 10; a thumb first, other words as they stand."""
        is_thumb = "thumb" in words_of(key)
        return not is_thumb, texts.index(re.sub(r"\d+", "#", key)), counted(key)

    keys = sorted(letters, key=place)
    return [SensorColumns(**groups[key]) for key in keys]  # type: ignore[arg-type]


def _by_count(names: Sequence[str], columns: Columns) -> Sequence[str]:
    """The columns of readings, 3 n of them: the longest series, all, or those that change.

    A series are columns that differ in a number; series of one length are readings together, and
    those of touch come first.
    """
    texts = [re.sub(r"\d+", "#", name) for name in names]
    kinds = [(bool(TOUCH.search(text)), texts.count(text)) for text in texts]
    best = max(kinds, key=lambda kind: (kind[0], kinds.count(kind)), default=(False, 0))
    longest = [name for name, kind in zip(names, kinds, strict=True) if kind == best]
    # of thumb1, thumb2, thumb3, index1, .. the number is an axis
    if best[1] != len(AXES):
        longest.sort(key=lambda name: [*map(int, re.findall(r"\d+", name))])
    moving = [name for name in longest if len(np.unique(np.diff(columns[name]))) > 1]
    # sensors of the normal alone have no shear
    if all(map(NORMAL.search, longest)):
        return []
    return next((one for one in (longest, moving) if len(one) % len(AXES) == 0), [])


def _order(values: FloatArray) -> np.ndarray:
    """[S, 3] places of x, y and z of columns without names [T, 3 S]: sensor by sensor.

    Or axis by axis, where a touch moves one of three columns only then.
    """
    by_sensor = np.arange(values.shape[1]).reshape(-1, 3)
    by_axis = by_sensor.reshape(3, -1).T
    change = touch(values)[0][1]
    shares = [normal_axis(change[order])[1] for order in (by_sensor, by_axis)]
    return by_axis if shares[1] > max(0.8, shares[0] + 0.2) else by_sensor


# -- what a touch does


def touch(values: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """What a hand that begins open reads while it touches something; values [T, C].

    ([2, C] the readings at rest, and their usual change while something is touched; [T] the rows in
    which something is).
    """
    rest = _middle(values[:FIRST_ROWS])
    load = np.zeros(len(values))
    for channel, at_rest in zip(values.T, rest, strict=True):
        load += np.abs(np.nan_to_num(channel - at_rest))
    rows = load > TOUCHED * max(np.quantile(load, 0.95), 1e-300)
    where = np.flatnonzero(rows)
    pressed = _middle(values[where[:: max(1, len(where) // 5000)]])
    return np.stack([rest, pressed - rest]), rows


def _middle(values: FloatArray) -> FloatArray:
    """[C] medians over the rows with a value; 0 without one."""
    middles: FloatArray = np.ma.median(np.ma.masked_invalid(values), axis=0).filled(0.0)
    return middles


def normal_axis(changes: FloatArray) -> tuple[int, float]:
    """(the axis that a touch moves most, and clearly in how large a share of the sensors).

    changes [S, 3]: what a touch changes.
    """
    change = np.abs(changes)
    change = change[change.sum(axis=1) > TOUCHED * change.sum(axis=1).max()]
    clearly = np.sort(change, axis=1)[:, 1:2] * CLEARLY
    shares = (change > clearly).sum(axis=0) / max(1, len(change))
    return int(shares.argmax()), float(shares.max())


def oriented(
    sensors: Sequence[SensorColumns],
    effects: FloatArray,
    unit: str,
    axis: int,
    *,
    returns: bool,
) -> list[SensorColumns]:
    """The sensors with signs and zeros such that a press raises their prepared normal.

    Preparation turns a sensor round whose normal rests below 0. Where all must be turned, the log
    has its z the other way; where some must be, their magnets are upside down. effects: of a touch.
    axis: the normal one in them. returns: whether the readings end near their rest.
    """
    ours, size = UNIT_OF[unit]
    rest, pressed = size * effects[:, axis::3]
    is_far = np.abs(rest) > NORMAL_FLOOR[ours]
    is_turned_later = is_far & (rest < 0.0)
    touched = np.abs(pressed) > TOUCHED * np.abs(pressed).max()
    wrong = touched & (np.where(is_turned_later, -pressed, pressed) < 0.0)
    # a press raises a field whatever its sign; counts above 0 hide the sign
    is_hidden = ours == "count" and bool((rest >= 0).all()) and returns
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


def unit_of(
    names: Sequence[str], values: FloatArray, at_rest: FloatArray
) -> tuple[str, str]:
    """(unit, why) of channels [T, C] by their names, such as `thumb_x [mN]`, else by their sizes.

    The unit is "" where several are as likely.
    """
    units = set()
    for name in names:
        # in brackets, or behind the axis
        behind = re.split(r"(?i)[xyz](?![a-z])|[\[(]", name)[-1]
        units.add(_unit_in(_words(behind), SIGNAL_UNITS))
    named = units.pop()
    if named and not units:
        return named, "by the names"

    rest = np.abs(at_rest).reshape(-1, 3)
    normal, shear = rest[:, NORMAL_AXIS], rest[:, :NORMAL_AXIS]
    middle = float(np.median(normal))
    change = float(np.nanquantile(np.abs(values[::7] - at_rest), 0.99))
    sizes = f"at rest {middle:.3g}, changes of {change:.3g}"
    is_whole = all((np.nan_to_num(one) % 1 == 0).all() for one in values.T)
    if FIELD.search(names[0]):
        return ("uT" if middle >= 1500.0 else ""), f"a field, {sizes}"
    if is_whole and np.nanmin(values) >= 0 and middle > change:
        return "count", f"by size: {sizes}, whole numbers above 0"
    # the thesis' fingertips rest under a load on the normal alone
    is_loaded = np.abs(normal - PRELOAD_N) < PRELOAD_RANGE_N
    is_loaded &= shear.max(axis=1) < 0.2 * normal
    is_force = (
        FORCE.search(names[0]) or middle < TARED * change or is_loaded.mean() >= 0.5
    )
    is_press = PRESS_N[0] < change < PRESS_N[1] and not is_whole
    return ("N" if is_force and is_press else ""), f"by size: {sizes}"


def channels(columns: Mapping[str, Column], names: Sequence[str]) -> FloatArray:
    """[T, C] columns as numbers."""
    return np.stack([np.asarray(columns[name], float) for name in names], axis=1)
