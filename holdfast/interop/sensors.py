"""Which columns are the three axes of which sensor, and what a touch does to them.

Sensors are certain where names differ in an axis alone and are of one quantity: a force, where
other quantities stand beside it. Columns without axes are checked: every third one must press, on
every sensor. What is neither is asked.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from fnmatch import fnmatchcase

import numpy as np

from holdfast.core.column_map import SensorColumns
from holdfast.core.contract import AXES, NORMAL_AXIS, NORMAL_FLOOR, UNIT_OF, FloatArray
from holdfast.core.errors import listed
from holdfast.interop.columns import channels, rise_of
from holdfast.interop.evidence import Evidence
from holdfast.interop.formats.streams import LOG_TIME, Columns, counted, is_text
from holdfast.interop.formats.tables import pd
from holdfast.interop.words import (
    FINGERS,
    NO_SENSOR,
    NUMBERS,
    OF_A_TRIAL,
    UNIT_OF_FORCE,
    says,
)

BEGIN = r"(?:(?<![a-z])|(?-i:(?<=[xyzt])(?=[A-Z])))(?:finger)?"
END = (
    r"(?:[-_ ]?finger|distal|tip)?"
    r"(?:(?![a-z])|(?-i:(?<=[a-z])(?=[FB]?[XYZxyz*](?![a-z]))))"
)
"""Before and behind a finger, which may stand in `FxThumb`, `RightThumb`, `thumbFx`, `thdistal`."""
_FINGERS = [f"({BEGIN}(?:{one}){END})" for one in FINGERS]
_FINGER = "|".join(_FINGERS)
_SIDE = (
    r"(?<![a-z])(?:left|lh|l|right|rh|r|link[se]|rechte?s?)"
    r"(?:(?![a-z])|(?-i:(?<=t)(?=[A-Z])))"
)
_LETTER = r"(?-i:(?<![A-Za-z])|(?<=[a-z])(?=[A-Z]))[a-d](?=[-_ .]+f(orce)?[-_ .]?\*)"
FINGER, THUMB, HAND, TRIAL, PLACE = (
    re.compile(f"(?i){one}")
    for one in (
        _FINGER,
        _FINGERS[0],
        rf"{_SIDE}|(?<![a-z])hand[-_ ]?\d+",
        rf"(?<![a-z])(?:{OF_A_TRIAL})[-_ ]?(?:\d+|{NUMBERS})(?![a-z])",
        rf"{_FINGER}|{_SIDE}|((?<![a-z])finger[-_ ]?)?\d+|{_LETTER}",
    )
)
"""A place tells sensors of one quantity apart; of letters, a to d before a force."""
AGAIN = re.compile(r"(?<=f\*)(.*)\.#$")
"""Behind the kind of a force that has the name of another one."""
FORCE = re.compile(
    rf"force|kraft|(?<![a-z])f[_ ]?\*|f\*$|[\[(](?i:n|{UNIT_OF_FORCE})[\])]"
)
"""A kind of column that is a force by its name or by its unit in brackets; * is the axis."""
FIELD = re.compile(rf"{FORCE.pattern}|[\[(]([muµμ]?t|teslas?|gs|gauss)[\])]")
"""Also one that is a field by its unit."""
READING = re.compile(r"(?<![a-z])(?<![ag]#)[fbh]?[_ ]?\*|force|[fbh]\*")
"""A kind of column that may be a reading: without a letter before its axis, or a force, a field;
no a1x or g1x, which are accelerations and turns."""
SHEAR = "(shear|tangential|lateral)([_ .]?force)?[_ .]?"
AXIS_WORDS = (
    (re.compile(r"(?i)normal([_ .]?force)?"), " z "),
    (re.compile(rf"(?i){SHEAR}[2yb](?![0-9])"), " y "),
    (re.compile(rf"(?i){SHEAR}[1xa]?(?![0-9])"), " x "),
)
"""Words for axes."""
FEWEST_UNNAMED = 9
"""Of six columns and fewer, three that press may be chance."""
TOUCHED = 0.2
"""A hand touches something while its readings are so far from rest, of their 95 % quantile."""
FIRST_ROWS, FEW_ROWS = 10, 5000
MORE, ONE_WAY = 1.5, 0.9
"""How much more than the others an axis moves that presses, and in which share of the contact."""
MUCH_MORE = 4.0
"""How much more one sensor presses than another; more than so are a force and its torque."""
REPEATED = 0.99
"""A sensor whose steps are so alike to those of another one is no sensor of its own."""
SUM, FOLLOWS = 0.04, 0.3
"""A resultant differs from the sum of the others on no axis by more, of how much it varies itself:
rounding and noise of its own (0.05 N where it presses with 3 N). And on two axes by less of how
much that axis varies: so a thumb that balances the fingers in its normal alone is no resultant."""
MEAN = 0.35
"""The steps of a mean differ by less from those of the mean of the others, of themselves: its noise
is theirs, and less. With noise of its own, or rounded to more than that, it looks like a sensor."""
CLEARLY, MOST_SENSORS = 3.0, 0.8
"""How much larger a change is that contradicts the names, and on which share of the sensors."""


def find_sensors(
    columns: Columns,
    longest: Columns,
    marks: Collection[str],
    chosen: str,
    is_joined: bool,
) -> Evidence[list[SensorColumns]]:
    """The sensors of a log in the order in which people count; none where they must be asked for.

    By the names of all its columns, else by what those of its longest stream hold. marks: the
    columns that may hold labels. chosen: patterns of names, as given, by commas; "" for none.
    is_joined: of files, whose words stand before a dot in the names.
    """
    names = []
    if chosen:
        for pattern in chosen.split(","):
            # as a question shows it: small letters, and # for a number
            small = pattern.lower().replace("#", "*")
            names += [name for name in columns if fnmatchcase(name.lower(), small)]
        names = [*dict.fromkeys(names)]
    else:
        for name, column in columns.items():
            is_other = name == LOG_TIME or name in marks or is_text(column)
            if not is_other and not says(name, NO_SENSOR):
                names.append(name)

    groups = _by_axes(names)
    if groups:
        return _of_one_kind(groups, is_given=bool(chosen), is_joined=is_joined)
    if not chosen:
        there = [name for name in names if name in longest]
        still = [name for name in there if not rise_of(longest[name])[0]]
        return _by_touch(still, longest)
    if not names or len(names) % 3:
        what = f"--sensors {chosen}, {len(names)} columns, not three a sensor,"
        return Evidence([], what)
    return Evidence(in_threes(names), "as given")


def in_threes(names: Sequence[str]) -> list[SensorColumns]:
    """Columns as x, y and z of each sensor, in the order of a hand."""
    rows = [*zip(names[::3], names[1::3], names[2::3], strict=True)]
    rows.sort(key=lambda row: finger_order(row[0]))
    return [SensorColumns(*row) for row in rows]


# -- by names


def _by_axes(names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Key -> axis -> name, of names that differ in one letter alone: x, y or z, in any place."""
    groups: dict[str, dict[str, str]] = {}
    for name in names:
        text = name
        for word, axis in AXIS_WORDS:
            text = word.sub(axis, text)
        for at in re.finditer("(?i)[xyz]", text):
            key = f"{text[: at.start()]}*{text[at.end() :]}"
            groups.setdefault(key, {}).setdefault(at[0].lower(), name)
    return {key: group for key, group in groups.items() if len(group) == len(AXES)}


def _of_one_kind(
    groups: dict[str, dict[str, str]], *, is_given: bool, is_joined: bool
) -> Evidence[list[SensorColumns]]:
    """The sensors of groups that are of one quantity; asked where several may be readings."""
    file_of, kind_of = {}, {}
    for key in groups:
        file, _, name = key.partition(".") if is_joined else ("", "", key)
        file_of[key] = file
        kind_of[key] = AGAIN.sub(r"\1", PLACE.sub("#", name).lower())
    files = [*file_of.values()]
    kinds = [*dict.fromkeys(kind_of.values())]
    found = ([*filter(one.search, kinds)] for one in (FORCE, FIELD, READING))
    of_one = next((one for one in found if len(one) == 1), [])
    readings = kinds if is_given else of_one
    if not readings:
        what = f"columns {listed(kinds, most=6)} (which are the readings?)"
        return Evidence([], what)
    keys = [key for key in groups if kind_of[key] in readings]
    trials = {word.lower() for key in keys for word in TRIAL.findall(key)}
    # two sensors are the jaws of a gripper
    is_hands = are_two_hands(keys) and len(keys) > 2
    if (is_hands or len(trials) > 1) and not (is_given or is_joined):
        what = "two hands" if is_hands else "trials (write each below the other)"
        return Evidence([], f"columns of {what}: {listed(keys)}")

    def place(key: str) -> tuple[object, ...]:
        """By the order of a hand; other words as they stand, numbers as people count."""
        file, kind = files.index(file_of[key]), kinds.index(kind_of[key])
        return file, finger_order(key), kind, counted(key)

    sensors = [SensorColumns(**groups[key]) for key in sorted(keys, key=place)]  # type: ignore
    return Evidence(sensors, "as given" if is_given else "by the axes in their names")


def are_two_hands(names: Sequence[str]) -> bool:
    """Whether names say left and right, or are of two hands with a number."""
    return len({" ".join(HAND.findall(one)).lower() for one in names} - {""}) == 2


def finger_order(name: str) -> int:
    """The place of a finger in the order of a hand; behind all others for other names."""
    found = FINGER.search(name)
    return found.lastindex or 0 if found else len(FINGERS) + 1


# -- by what a touch does


def _by_touch(names: Sequence[str], columns: Columns) -> Evidence[list[SensorColumns]]:
    """Columns without axes in their names as three a sensor, where a touch shows that.

    All of them, or those that differ in a number. Sensor by sensor, as they stand.
    """
    series = {"": [*names]}
    for name in sorted(names, key=counted):
        series.setdefault(re.sub(r"\d+", "#", name), []).append(name)
    found = []
    for one in series.values():
        is_whole = len(one) >= FEWEST_UNNAMED and len(one) % 3 == 0
        if is_whole and one not in found and presses(channels(columns, one)):
            found.append(one)
    if len(found) != 1:
        most = max(series.values(), key=len)
        # a table of fewer has no readings
        return Evidence([], f"columns {listed(most)}" if len(most) > 2 else "")
    (axes,) = found
    check = "every third column presses, on every sensor"
    why = f"no axes in the names, {axes[0]} to {axes[-1]}"
    return Evidence(in_threes(axes), why, check)


def presses(values: FloatArray) -> bool:
    """Whether the same axis of every sensor presses: moves most, and in one direction.

    And whether no sensor repeats another one or is much weaker, as torques are beside their forces.
    values [T, 3 S]: of the sensors in turn.
    """
    (rest, change), rows = touch(values)
    sizes = np.abs(change).reshape(-1, 3)
    axis = int(sizes[0].argmax())
    sizes, others = sizes[:, axis], np.delete(sizes, axis, axis=1).max(axis=1)
    if not (sizes > MORE * others).all() or sizes.max() > MUCH_MORE * sizes.min():
        return False
    toward = (values[rows] - rest) * np.sign(change)
    one_way = np.nanmean(toward >= 0, axis=0) > ONE_WAY
    # where all columns press, each is a sensor of its own
    each_presses = (one_way & (np.sign(change) == np.sign(change[axis]))).all()
    # pandas leaves nan out, and steps show the noise that each sensor has of its own
    alike = pd.DataFrame(np.diff(toward[:, axis::3], axis=0)).corr().abs().to_numpy()
    repeats = np.triu(alike, 1).max() > REPEATED
    return bool(one_way[axis::3].all() and not (each_presses or repeats))


def sums_of_others(values: FloatArray) -> list[int]:
    """Which sensors of three and more are the sum of the others, or their mean; values [T, 3 S]."""
    # a few of the rows of a long log, which is large
    some = values[:: max(1, len(values) // FEW_ROWS)]
    sensors = np.nan_to_num(some).reshape(len(some), -1, 3)
    n_others = sensors.shape[1] - 1
    if n_others < 2:
        return []
    others = sensors.sum(axis=1, keepdims=True) - sensors
    noise = np.diff(sensors, axis=0).std(axis=0)
    off = np.diff(sensors - others / n_others, axis=0).std(axis=0)
    is_sum = (off < MEAN * noise).all(axis=1)
    is_sum &= (noise == noise.min(axis=0)).any(axis=1)
    varies = sensors.std(axis=0)
    # the sum of the others, or what balances it
    for rest in (sensors - others, sensors + others):
        off = rest.std(axis=0)
        is_near = off.max(axis=1) < SUM * varies.max(axis=1)
        is_sum |= is_near & ((off < FOLLOWS * varies).sum(axis=1) > 1)
    return np.flatnonzero(is_sum).tolist()


def touch(values: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """What a hand that begins open reads while it touches something; values [T, C].

    ([2, C] the readings at rest, and their usual change while something is touched; [T] the rows in
    which something is).
    """
    rest = _middle(values[:FIRST_ROWS])
    load = np.zeros(len(values))
    for channel, at_rest in zip(values.T, rest, strict=True):
        load += np.abs(np.nan_to_num(channel - at_rest))
    rows = load > TOUCHED * np.quantile(load, 0.95)
    where = np.flatnonzero(rows)
    pressed = _middle(values[where[:: max(1, len(where) // FEW_ROWS)]])
    return np.stack([rest, pressed - rest]), rows


def _middle(values: FloatArray) -> FloatArray:
    """[C] medians over the rows with a value; 0 without one."""
    middles: FloatArray = np.ma.median(np.ma.masked_invalid(values), axis=0).filled(0.0)
    return middles


def moved_most(changes: FloatArray) -> int:
    """The axis that a touch clearly moves most on most sensors; else that of the names.

    changes [S, 3]: what a touch changes.
    """
    sizes = np.abs(changes)
    sizes = sizes[sizes.sum(axis=1) > TOUCHED * sizes.sum(axis=1).max()]
    ordered = np.sort(sizes, axis=1)
    is_clear = ordered[:, 2] > CLEARLY * ordered[:, 1]
    most = np.bincount(sizes.argmax(axis=1)[is_clear], minlength=3)
    axis = int(most.argmax())
    return axis if most[axis] > MOST_SENSORS * len(sizes) else NORMAL_AXIS


def oriented(
    sensors: Sequence[SensorColumns], effects: FloatArray, unit: str, axis: int
) -> list[SensorColumns]:
    """The sensors with signs and zeros such that a press raises their prepared normal.

    Preparation turns a sensor round whose normal rests below 0. Where all must be turned, the log
    has its z the other way; where some must be, their magnets are upside down. effects: of a touch.
    axis: the normal one in them.
    """
    ours, size = UNIT_OF[unit]
    rest, pressed = size * effects[:, axis::3]
    is_far = np.abs(rest) > NORMAL_FLOOR[ours]
    is_turned_later = is_far & (rest < 0.0)
    touched = np.abs(pressed) > TOUCHED * np.abs(pressed).max()
    wrong = touched & (np.where(is_turned_later, -pressed, pressed) < 0.0)
    # a press raises a field whatever its sign, which counts do not show
    wrong &= (np.abs(rest) < np.abs(pressed)) | (ours == "count")
    turned = list(sensors)
    for k in np.flatnonzero(wrong).tolist():
        axes = list(sensors[k].axes)
        first = NORMAL_AXIS if wrong.all() else 0
        if not is_turned_later[k]:
            axes[first:] = [f"-{name}" for name in axes[first:]]
        zero = float(f"{2.0 * rest[k] / size:.4g}") if is_far[k] else 0.0
        turned[k] = SensorColumns(*axes, zero)  # type: ignore[arg-type, call-arg]

    return turned
