"""What columns hold: the time and its unit, sensors and their axes, the unit of the readings.

What a column holds is looked at before what it is called. A time rises in nearly even steps that
make the rate of a hand. Sensors are the columns whose names differ in an axis alone; without such
names three columns each, in their order.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.core.column_map import NS_OF, SensorColumns, TimeColumn
from holdfast.core.contract import AXES, NORMAL_AXIS, NORMAL_FLOOR, UNIT_OF, FloatArray
from holdfast.core.trial_file import FASTEST_HZ, SLOWEST_HZ
from holdfast.interop.logs import counted
from holdfast.interop.streams import LOG_TIME, Column, Columns, is_text

TIME_WORDS = {
    "time", "timestamp", "stamp", "t", "clock", "elapsed", "millis", "micros", "seconds", "secs",
    "sec", "ms", "us", "ns", "when", "date", "datetime",
}  # fmt: skip
UNIT_WORDS = {
    "s": {"s", "sec", "secs", "second", "seconds"},
    "ms": {"ms", "msec", "millis", "millisecond", "milliseconds"},
    "us": {"us", "usec", "micros", "microsecond", "microseconds", "µs", "μs"},
    "ns": {"ns", "nsec", "nanos", "nanosecond", "nanoseconds"},
}
SIGNAL_UNITS = {
    "N": {"N", "newton", "newtons"},
    "mN": {"mn", "millinewton", "millinewtons"},
    "gf": {"gf", "g", "gram", "grams"},
    "uT": {"ut", "µt", "μt", "microtesla"},
    "mT": {"mt", "millitesla"},
    "G": {"G", "gauss", "gs"},
    "T": {"T", "tesla"},
    "count": {"count", "counts", "raw", "adc", "lsb", "digits"},
}
NO_SENSOR = {
    "torque", "translation", "rotation", "quaternion", "orientation", "covariance", "gyro", "pose",
    "position", "pos", "angular", "velocity", "vel", "acc", "accel", "acceleration", "imu", "joint",
    "marker", "transform", "action", "state",
}  # fmt: skip
"""Words of three axes that are no reading of a fingertip."""
TOUCH_WORDS = {
    "tactile",
    "force",
    "touch",
    "taxel",
    "finger",
    "pressure",
    "hall",
    "ft",
    "sensor",
}
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
FIRST_ROWS, ONSET_ROWS = 10, 60
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


# -- time


@dataclass(frozen=True)
class FoundTime:
    """A column of time, or one that counts samples: then its rate is not known.

    rate_hz: 0 where it is not known. why: in words.
    """

    time: TimeColumn
    rate_hz: float
    why: str


def find_time(columns: Columns, rate_hz: float | None = None) -> FoundTime | None:
    """The time of a table; None where nothing runs like one and no rate is given."""
    if LOG_TIME in columns:
        hz = 1e9 / usual_step(columns[LOG_TIME].astype(np.float64))
        return FoundTime(TimeColumn(LOG_TIME, "ns"), hz, "stamps of the log")

    found = []
    for name, column in columns.items():
        candidate = None if is_text(column) else _time_of(name, column)
        if candidate is not None:
            found.append(candidate)

    if found:
        rank, best = min(found, key=lambda one: one[0])
        is_counter = rank[0] == 1
        if not is_counter:
            return best
        if rate_hz:
            why = f"{best.time.column} counts samples, {rate_hz:g} Hz as given"
            return FoundTime(TimeColumn(best.time.column, None, rate_hz), rate_hz, why)

    if rate_hz:
        why = f"rows are counted, {rate_hz:g} Hz as given"
        return FoundTime(TimeColumn(rate_hz=rate_hz), rate_hz, why)

    return None


def _time_of(name: str, column: Column) -> tuple[tuple[float, ...], FoundTime] | None:
    """(rank, time) of a column that rises in steps of a hand's rate, or counts; else None."""
    values = column[:50_000].astype(np.float64)
    values = values[np.isfinite(values)]
    steps = np.diff(values)
    if len(values) < 0.9 * len(column[:50_000]) or not len(steps) or not steps.any():
        return None
    step = usual_step(values)
    if np.mean(steps < 0) > 0.05 or step <= 0.0:
        return None
    even = float(np.mean(np.abs(steps - step) <= 0.6 * step))
    unit = unit_of_time(name)
    is_named = bool(unit or words_of(name) & TIME_WORDS)
    # counts of trials and the like rise too, but rarely
    if even < 0.6 and not is_named and len(np.unique(values)) < len(values) / 50:
        return None
    if float(np.mean(steps == 1.0)) > 0.9 and not unit:
        return (1.0, -even), FoundTime(TimeColumn(name), 0.0, "")
    if unit is None or not _fits(step, unit):
        unit = next((one for one in NS_OF if _fits(step, one)), None)
    if unit is None:
        return None
    hz = 1e9 / (step * NS_OF[unit])
    why = f"{name}, {hz:.4g} Hz, in {unit} by its steps"
    return (0.0, not is_named, -even), FoundTime(TimeColumn(name, unit), hz, why)  # type: ignore[arg-type]


def unit_of_time(name: str) -> str | None:
    """The unit that a name of time has."""
    return next(
        (unit for unit, words in UNIT_WORDS.items() if words_of(name) & words), None
    )


def _fits(step: float, unit: str) -> bool:
    """Whether steps in a unit make a rate that a hand has."""
    return SLOWEST_HZ <= 1e9 / (step * NS_OF[unit]) <= FASTEST_HZ


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
    names = [
        name for name in columns if name not in taken and not is_text(columns[name])
    ]
    names = [name for name in names if name != LOG_TIME]
    sensors = _by_axes(names)
    if sensors:
        return sensors, "by the axes in their names"
    rest = _by_count(names, columns)
    if len(rest) < 3:
        return [], ""
    values = np.stack([columns[name].astype(np.float64) for name in rest], axis=1)
    order = _order(values)
    found = [sensor_of([rest[k] for k in row]) for row in order.tolist()]
    by = (
        "three columns each"
        if (order.ravel() == np.arange(len(rest))).all()
        else "by the touch"
    )
    return found, f"no axes in the names: x, y, z {by}, {rest[0]} to {rest[-1]}"


def sensor_of(axes: Sequence[str], z_zero: float = 0.0) -> SensorColumns:
    """A sensor of the columns of its three axes."""
    x, y, z = axes
    return SensorColumns(x, y, z, z_zero) if z_zero else SensorColumns(x, y, z)


def _by_axes(names: Sequence[str]) -> list[SensorColumns]:
    best: list[SensorColumns] = []
    for form in AXIS_FORMS:
        groups: dict[str, dict[str, str]] = {}
        for name in names:
            # what stands in brackets is a unit
            bare = re.sub(r"[\[(].*?[\])]", "", name)
            for word, axis in AXIS_WORDS:
                bare = word.sub(axis, bare)
            match = list(form.finditer(bare))
            # an IMU beside the fingers has axes too
            if match and not words_of(name) & NO_SENSOR:
                at = match[-1]
                key = f"{bare[: at.start()]}*{bare[at.end() :]}"
                groups.setdefault(key, {}).setdefault(at[1].lower(), name)
        sensors = []
        for key in _as_counted(groups):
            if set(groups[key]) == set(AXES):
                sensors.append(sensor_of([groups[key][axis] for axis in AXES]))
        best = max(best, sensors, key=len)

    return best


def _as_counted(keys: Collection[str]) -> list[str]:
    """Names as people count, 2 before 10; those of a thumb first, other words as they stand."""
    texts = list(dict.fromkeys(re.sub(r"\d+", "#", key) for key in keys))

    def place(key: str) -> tuple[bool, int, list[tuple[int, int, str]]]:
        text = re.sub(r"\d+", "#", key)
        return "thumb" not in words_of(key), texts.index(text), counted(key)

    return sorted(keys, key=place)


def _by_count(names: Sequence[str], columns: Columns) -> list[str]:
    """The columns of readings, 3 n of them: the longest series, all, or those that change."""
    series: dict[str, list[str]] = {}
    for name in names:
        series.setdefault(re.sub(r"\d+", "#", name), []).append(name)
    all_series: list[list[str]] = [[], *series.values()]
    first: list[str] = max(all_series, key=_rank)
    longest = sorted(first, key=counted)
    moving = []
    for name in names:
        steps = np.diff(columns[name].astype(np.float64))
        if len(np.unique(steps[np.isfinite(steps)])) > 1:
            moving.append(name)

    for chosen in (longest, names, moving):
        if len(chosen) >= 3 and len(chosen) % 3 == 0:
            return list(chosen)

    return []


def _rank(series: list[str]) -> tuple[bool, int]:
    """Of columns that differ in a number: those of touch first, then the most."""
    return bool(words_of(" ".join(series)) & TOUCH_WORDS), len(series)


def _order(values: FloatArray) -> np.ndarray:
    """[S, 3] places of x, y and z of columns without names [T, 3 S], by what a touch moves."""
    by_sensor = np.arange(values.shape[1]).reshape(-1, 3)
    by_axis = by_sensor.reshape(3, -1).T
    change = touch(values).effects[2]
    best = (0.0, by_sensor)
    for order in (by_sensor, by_axis):
        axis, share = _leading(change[order])
        # z is the last of three columns unless a touch clearly moves another
        is_clear = share >= 0.8
        if is_clear and share > best[0] + 0.2:
            best = (share, np.roll(order, NORMAL_AXIS - axis, axis=1))

    return best[1]


def _leading(change: FloatArray) -> tuple[int, float]:
    """(the axis that a touch moves most, of how large a share of the sensors); change [S, 3]."""
    is_touched = change.sum(axis=1) > TOUCHED * change.sum(axis=1).max()
    change = change[is_touched]
    ordered = np.sort(change, axis=1)
    clear = ordered[:, 2] > CLEARLY * ordered[:, 1]
    axes = Counter(change.argmax(axis=1)[clear].tolist())
    if not axes:
        return NORMAL_AXIS, 0.0
    ((axis, count),) = axes.most_common(1)
    return axis, count / len(change)


# -- what a touch does


@dataclass(frozen=True)
class Touch:
    """effects [3, C]: the readings at rest; their usual change while touched; its size at first.

    rows [T]: where something is touched. returns: whether the readings end near their rest.
    """

    effects: FloatArray
    rows: np.ndarray
    returns: bool

    @classmethod
    def of_none(cls) -> Touch:
        """Of a table without readings."""
        return cls(np.zeros((3, 0)), np.zeros(0, dtype=np.bool_), returns=True)


def touch(values: FloatArray) -> Touch:
    """What a hand that begins open reads while it touches something; values [T, C]."""
    rest = _middle(values[:FIRST_ROWS])
    load = np.zeros(len(values))
    for channel, at_rest in zip(values.T, rest, strict=True):
        load += np.abs(np.nan_to_num(channel - at_rest))
    rows = load > TOUCHED * max(np.quantile(load, 0.95), 1e-300)
    where = np.flatnonzero(rows)
    begins = int(where[0]) if len(where) else 0
    onset = _middle(values[begins + ONSET_ROWS // 4 : begins + ONSET_ROWS])
    pressed = _middle(values[where[:: max(1, len(where) // 5000)]])
    effects = np.stack([rest, pressed - rest, np.abs(onset - rest)])
    return Touch(effects, rows, not rows[-FIRST_ROWS:].any())


def _middle(values: FloatArray) -> FloatArray:
    """[C] medians over the rows with a value; 0 without one."""
    middles: FloatArray = np.ma.median(np.ma.masked_invalid(values), axis=0).filled(0.0)
    return middles


def normal_axis(found: Touch) -> int:
    """The axis that most sensors clearly change along when they are touched; 2 where none is."""
    axis, share = _leading(found.effects[2].reshape(-1, 3))
    return axis if share >= 0.8 else NORMAL_AXIS


def oriented(
    sensors: Sequence[SensorColumns], found: Touch, unit: str
) -> list[SensorColumns]:
    """The sensors with signs and zeros such that a press raises their prepared normal.

    Preparation turns a sensor round whose normal rests below 0. Where all must be turned, the log
    has its z the other way; where some must be, their magnets are upside down.
    """
    ours, size = UNIT_OF[unit]
    rest, pressed, _ = size * found.effects[:, NORMAL_AXIS::3]
    is_turned_later = rest < -NORMAL_FLOOR[ours]
    is_far = np.abs(rest) > NORMAL_FLOOR[ours]
    touched = np.abs(pressed) > TOUCHED * np.abs(pressed).max()
    wrong = touched & (np.where(is_turned_later, -pressed, pressed) < 0.0)
    # a press raises a field whatever its sign; counts above 0 hide the sign
    is_hidden = ours == "count" and bool((rest >= 0).all()) and found.returns
    wrong &= (np.abs(rest) < np.abs(pressed)) | is_hidden
    turned = []
    for k, sensor in enumerate(sensors):
        axes = list(sensor.axes)
        if wrong[k] and not is_turned_later[k]:
            which = (NORMAL_AXIS,) if wrong.all() else range(3)
            axes = [f"-{name}" if n in which else name for n, name in enumerate(axes)]
        turned.append(sensor_of(axes))
        if wrong[k] and is_far[k]:
            zero = float(f"{2.0 * rest[k] / size:.4g}")
            turned[k] = sensor_of(axes, zero)

    return turned


# -- units


def unit_of_names(names: Sequence[str]) -> str | None:
    """The unit in the names of channels, such as `thumb_x [mN]`, or behind the axis."""
    for unit, words in SIGNAL_UNITS.items():
        in_brackets = [" ".join(re.findall(r"[\[(](.*?)[\])]", name)) for name in names]
        behind = [re.split(r"(?i)[xyz](?![a-z])", name)[-1] for name in names]
        for texts in (in_brackets, behind):
            if all(words & _unit_words(text) for text in texts):
                return unit

    return None


def _unit_words(text: str) -> set[str]:
    """Words as they stand, where G is gauss and g is gram; longer ones in small letters too."""
    words = set(re.findall(r"[^\W\d_]+", text))
    return words | {word.lower() for word in words if len(word) > 1}


def unit_of_sizes(
    names: Sequence[str], values: FloatArray, found: Touch
) -> tuple[str, str]:
    """(unit, why) of channels [T, C] by their sizes; "" where several are as likely."""
    rests = np.abs(found.effects[0]).reshape(-1, 3)
    rest = float(np.median(rests[:, NORMAL_AXIS]))
    change = float(np.nanquantile(np.abs(values[::7] - found.effects[0]), 0.99))
    sizes = f"at rest {rest:.3g}, changes of {change:.3g}"
    is_whole = bool((np.nan_to_num(values) % 1 == 0).all())
    if re.search(r"(?i)(?<![a-z])(b[xyz](?![a-z])|mag)", names[0]):
        return ("uT" if rest >= 1500.0 else ""), f"a field, {sizes}"
    if is_whole and np.nanmin(values) >= 0 and rest > change:
        return "count", f"by size: {sizes}, whole numbers above 0"
    is_named = bool(re.search(r"(?i)force|(?<![a-z])f[xyz](?![a-z])", names[0]))
    is_tared = rest < TARED * change
    is_force = is_named or is_tared or _is_fingertips(rests)
    is_press = PRESS_N[0] < change < PRESS_N[1] and not is_whole
    return ("N" if is_force and is_press else ""), f"by size: {sizes}"


def _is_fingertips(rests: FloatArray) -> bool:
    """Whether sensors rest as the thesis' fingertips do: under a load on the normal alone."""
    normal = rests[:, NORMAL_AXIS]
    is_loaded = (normal > PRELOAD_N[0]) & (normal < PRELOAD_N[1])
    is_straight = rests[:, :NORMAL_AXIS].max(axis=1) < 0.2 * normal
    return bool(np.mean(is_loaded & is_straight) >= 0.5)


def channels(
    columns: Mapping[str, Column], sensors: Sequence[SensorColumns]
) -> FloatArray:
    """[T, C] the readings of the sensors, without signs."""
    names = [name.removeprefix("-") for sensor in sensors for name in sensor.axes]
    return np.stack([columns[name].astype(np.float64) for name in names], axis=1)
