"""What names and magnitudes of columns say: time and its unit, sensors and their axes, units."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.core.column_map import NS_OF, SensorColumns
from holdfast.core.contract import AXES, NORMAL_AXIS, FloatArray
from holdfast.core.trial_file import FASTEST_HZ, SLOWEST_HZ
from holdfast.interop.logs.log import LOG_TIME, Column, Columns, ForeignLog

TIME_WORDS = {
    "time", "timestamp", "stamp", "t", "zeit", "clock", "elapsed", "millis", "micros",
    "nanos", "seconds", "secs", "sec", "ms", "us", "ns", "zeitstempel", "temps", "when",
}  # fmt: skip
UNIT_WORDS = {
    "s": {"s", "sec", "secs", "second", "seconds"},
    "ms": {"ms", "msec", "millis", "millisecond", "milliseconds"},
    "us": {"us", "usec", "micros", "microsecond", "microseconds", "µs", "μs"},
    "ns": {"ns", "nsec", "nanos", "nanosecond", "nanoseconds"},
}
NO_SENSOR = {
    "torque", "translation", "rotation", "quaternion", "orientation", "covariance",
    "position", "pose", "pos", "gyro", "angular", "velocity", "vel", "acc", "accel",
    "acceleration", "imu", "joint", "marker", "transform",
}  # fmt: skip
"""Words of three axes that are no reading of a fingertip."""
THUMBS = ("thumb", "daumen", "pouce", "pulgar")
SIGNAL_UNITS = {
    "N": {"n", "newton", "newtons"},
    "mN": {"mn", "millinewton"},
    "gf": {"gf", "g", "gram", "grams"},
    "uT": {"ut", "µt", "μt", "microtesla"},
    "mT": {"mt", "millitesla"},
    "count": {"count", "counts", "raw", "adc", "lsb", "digits"},
}
USUAL_HZ = 100.0
UNNAMED_FIRST = "column1"
AXIS_FORMS = (
    re.compile(r"(?i)(?<![a-z])([xyz])(?![a-z])"),
    re.compile(r"(?i)([xyz])(?![a-z])"),
    re.compile(r"(?i)(?<![a-z])([xyz])"),
)
"""An axis in a name: a letter on its own, at the end of a word, or at its beginning."""


@dataclass(frozen=True)
class TimeGuess:
    """A column of time. unit: None where nothing says it. why: in words."""

    column: str
    unit: str | None
    why: str


def whole_words(name: str) -> set[str]:
    """Lower-case words between what is no letter."""
    return {word.lower() for word in re.findall(r"[^\W\d_]+", name)}


def words_of(name: str) -> set[str]:
    """The same, and the parts of words with capitals: `thumbX [mN]` has also thumb and x."""
    return whole_words(name) | whole_words(re.sub(r"([a-z])([A-Z])", r"\1 \2", name))


def unit_of_time(name: str) -> str | None:
    """The unit that a name of time has."""
    words = words_of(name)
    for unit in ("ns", "us", "ms", "s"):
        if words & UNIT_WORDS[unit]:
            return unit
    return None


def guess_time(columns: Columns) -> TimeGuess | None:
    """The column of time of a table; None where no column runs like one."""
    found: list[tuple[int, TimeGuess]] = []
    for name, column in columns.items():
        if column.dtype.kind not in "iuf" or name == LOG_TIME:
            continue
        step = _usual_step(column)
        if step is None:
            continue
        # of a table without names, the first column is taken for the time
        is_first = name == UNNAMED_FIRST and not (np.diff(column) == 1).all()
        is_named = bool(words_of(name) & TIME_WORDS) or is_first
        if not is_named:
            continue
        unit, why = _unit_of_step(name, step)
        rank = 0 if unit_of_time(name) else 1
        found.append((rank, TimeGuess(name, unit, why)))
    return min(found, key=lambda one: one[0])[1] if found else None


def _usual_step(column: Column) -> float | None:
    """The median step of a column that runs forward; None for another."""
    values = column[:20_000].astype(np.float64)
    steps = np.diff(values)
    if not len(steps) or not np.isfinite(steps).all():
        return None
    forward = float(np.mean(steps > 0.0))
    step = float(np.median(steps))
    return step if step > 0.0 and forward > 0.9 else None


def _unit_of_step(name: str, step: float) -> tuple[str | None, str]:
    """The unit that name and step agree on, else the one that the step has."""
    named = unit_of_time(name)
    if named and _rate_hz(step, named) is not None:
        return named, f"{_rate_hz(step, named):.4g} Hz, by its name"
    fit = [unit for unit in NS_OF if _rate_hz(step, unit) is not None]
    if not fit:
        return named, f"steps of {step:g}: no unit of time makes a rate of a hand"
    unit = min(fit, key=lambda one: abs(np.log((_rate_hz(step, one) or 1) / USUAL_HZ)))
    note = f"{_rate_hz(step, unit):.4g} Hz, by its steps of {step:.6g}"
    return unit, note + (f"; its name says {named}" if named else "")


def _rate_hz(step: float, unit: str) -> float | None:
    """The rate of steps in a unit; None for one that no hand has."""
    rate_hz = 1e9 / (step * NS_OF[unit])
    return rate_hz if SLOWEST_HZ <= rate_hz <= FASTEST_HZ else None


def guess_sensors(names: Iterable[str]) -> list[SensorColumns]:
    """Columns whose names differ in an axis alone, in their order; those of a thumb first."""
    there = list(names)
    for form in AXIS_FORMS:
        groups: dict[str, dict[str, str]] = {}
        for name in there:
            match = list(form.finditer(name))
            if match and not words_of(name) & NO_SENSOR:
                at = match[-1]
                key = f"{name[: at.start()]}*{name[at.end() :]}"
                groups.setdefault(key, {}).setdefault(at[1].lower(), name)
        whole = [one for one in groups.values() if set(one) == set(AXES)]
        if whole:
            sensors = [SensorColumns(*(one[axis] for axis in AXES)) for one in whole]
            return sorted(sensors, key=lambda one: not _is_thumb(one))
    return []


def counted_sensors(columns: Columns, taken: set[str]) -> list[SensorColumns]:
    """Numbered columns without axes, three a sensor, such as `ch0` .. `ch14`."""
    series: dict[str, list[str]] = {}
    for name, column in columns.items():
        match = re.fullmatch(r"(.*?)\d+", name)
        if match and name not in taken and column.dtype.kind in "iuf":
            series.setdefault(match[1], []).append(name)
    longest = max(series.values(), key=len, default=[])
    if len(longest) < 3 or len(longest) % 3:
        return []
    return [SensorColumns(*longest[k : k + 3]) for k in range(0, len(longest), 3)]


def _is_thumb(sensor: SensorColumns) -> bool:
    return any(word in sensor.x.lower() for word in THUMBS)


def unit_of_signals(names: Sequence[str]) -> str | None:
    """The unit in the names of channels, such as `thumb_x [mN]`."""
    # a unit stands in brackets, or behind the axis
    brackets = [whole_words(" ".join(re.findall(r"[\[(](.*?)[\])]", n))) for n in names]
    tails = [whole_words(re.split(r"(?i)[xyz](?![a-z])", n)[-1]) for n in names]
    for unit, words in SIGNAL_UNITS.items():
        for said in (brackets, tails):
            if said and all(one & words for one in said):
                return unit
    return None


def guess_unit(values: FloatArray) -> tuple[str, str]:
    """(unit, why) of channels [T, C] by their size: a guess, to be looked at."""
    finite = np.where(np.isfinite(values), values, 0.0)
    rest = float(np.median(np.abs(np.median(finite[:10], axis=0))))
    change = float(np.quantile(np.abs(finite - np.median(finite[:10], axis=0)), 0.99))
    is_whole = bool((finite == np.round(finite)).all())
    sizes = f"at rest {rest:.3g}, changes of {change:.3g}"
    if change < 200.0 and rest < 100.0 and not is_whole:
        return "N", f"a guess by size: {sizes}"
    # a Hall sensor has the field of its magnet at rest, a force has nothing
    if rest > change:
        unit = "count" if is_whole else "uT"
        return unit, f"a guess by size: {sizes}, as of a magnet"
    return "mN", f"a guess by size: {sizes}; a field without its rest looks the same"


def turned_normals(
    sensors: Sequence[SensorColumns], columns: Mapping[str, Column]
) -> list[SensorColumns]:
    """The sensors with a sign where a press makes their Z negative.

    Of all sensors, that is how the log has its Z; of some, their magnets are upside down, which
    turns all three axes (docs/decisions.md).
    """
    are_turned = []
    for sensor in sensors:
        normal = columns[sensor.axes[NORMAL_AXIS]].astype(np.float64)
        pressed = np.nan_to_num(normal - np.nanmean(normal[:5]))
        below, above = abs(float(pressed.min())), float(pressed.max())
        are_turned.append(below > 2.0 * above)
    turned = []
    for sensor, is_turned in zip(sensors, are_turned, strict=True):
        signed = SensorColumns(*(f"-{name}" for name in sensor.axes))
        if all(are_turned):
            signed = SensorColumns(sensor.x, sensor.y, signed.z)
        turned.append(signed if is_turned else sensor)
    return turned


def longest_stream(log: ForeignLog) -> Columns:
    """All numeric columns of a log, as long as the longest one."""
    columns: Columns = {}
    for stream in log.streams:
        columns |= stream.columns
    return columns
