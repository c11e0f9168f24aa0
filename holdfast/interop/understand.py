"""What the logs of a folder are: a map for each form of log, a short table, one list of questions.

Everything is taken from names and from what columns hold, as evidence. What no evidence says, and
no answer on the command line, is asked.

Steps: find the logs; read each once and keep its first readings; join the files of one trial; sort
the logs by their columns; make a map for each such form (forms.py). trials.py then reads the logs a
second time by the maps, one after the other.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np

from holdfast.core.contract import AXES
from holdfast.core.errors import ColumnError, listed
from holdfast.core.progress import Part, ignored
from holdfast.interop.beside import files_of, read_joined
from holdfast.interop.columns import (
    channels,
    find_time,
    unit_of,
    without_codes,
    without_jumps,
)
from holdfast.interop.formats.logs import SCALARS, LogPlace, find_logs, read_log
from holdfast.interop.formats.streams import (
    Columns,
    ForeignLog,
    counted,
    first_stream,
    is_text,
    merged,
)
from holdfast.interop.forms import Form
from holdfast.interop.joining import in_turn, is_twice, is_union, table_of
from holdfast.interop.labels import is_mark
from holdfast.interop.map import NAMES, ImportMap
from holdfast.interop.names import kind_of
from holdfast.interop.proposal import Answers, Proposal, Sample
from holdfast.interop.sensors import (
    FINGER,
    are_two_hands,
    find_sensors,
    finger_order,
    sums_of_others,
    touch,
)
from holdfast.interop.words import (
    NUMBERS,
    TOGETHER,
    TRIAL,
    UNIT_COLUMN,
    UNIT_OF_PATH,
    is_called,
)

FEWEST_ROWS = 100
"""Of a log without a time: shorter ones are tables of something else."""
_NUMBERED = r"(?i:finger|sensor|pad|taxel|tip|jaw)[-_ ]?\d+"
WORD = re.compile(
    rf"{_NUMBERED}|{TOGETHER}|(?i:{FINGER.pattern[4:]})(?=\d)|[^\W\d_]+\d*|\d+"
)
"""Of a path: letters with their number, or a number; a finger's number is that of a trial."""
FILE_OF_A_SENSOR = re.compile(
    rf"{_NUMBERED}|(?!(?:{TOGETHER}|(?i:{NUMBERS}))$).*(?i:{FINGER.pattern[4:]})"
)
"""A word that names a finger or numbers a sensor; a number alone may be that of a trial."""
NO_SHEAR = (
    "the step needs shear: x, y and z of each sensor, or xz or yz where the hand card says so "
    "(measures); of the normal alone nothing is trained"
)


def understand(source: Path, answers: Answers, part: Part = ignored) -> Proposal:
    """What the logs of a source are.

    source: a folder or a file. answers: what the command line says, which wins over what is seen.
    part: receives the share that is read. Raises a DataError where no log can be read at all.
    """
    found = Proposal()
    places, others = find_logs(source)
    samples: dict[str, Sample] = {}
    others_read: dict[Path, ForeignLog] = {}
    for number, place in enumerate(places, 1):
        log = read_log(place)
        # no more than one is in the memory
        found.kept = {place.name: log} if len(places) == 1 else {}
        sample = (
            None if place.kind == SCALARS else _sample([place], log, answers, found)
        )
        if sample:
            samples[place.name] = sample
        else:
            others_read[place.path] = log
        part(number / len(places))

    unread = f"; not read: {listed(others, most=6)}" if others else ""
    found.add("logs", f"{len(samples)}{unread}")
    if not samples:
        log = next(iter(others_read.values()))
        names = listed([*merged(log)], most=24)
        what = f"which columns of {log.name} are x, y and z of each sensor? ({names})"
        if not found.questions:
            found.ask("--sensors", f"{what}; or a map names them (docs/your-data.md)")
        return found

    fingers = _fingers([*samples.values()], answers, found)
    if fingers:
        each = f"the files {listed(fingers)} of each trial"
        found.add("joined", f"{each}, on the slowest clock")
    logs = [one.files[0] for one in samples.values()]
    beside = [place for place in places if place.path in others_read]
    files = files_of(logs, beside, fingers, _of_folders(beside, others_read))
    for name, group in files.items():
        if name not in samples or len(group) > 1:
            found.kept.clear()
            log = read_joined(group, fingers, name)
            sample = _sample(group, log, answers, found, bool(fingers))
            samples |= {name: sample} if sample else {}
        for place in group:
            others_read.pop(place.path, None)
    tables = [one for one in others_read.values() if one.path.suffix != SCALARS]
    alone = [path.name for path in others_read if path.suffix == SCALARS]
    if alone:
        found.add("not used", f"{listed(alone, most=6)} (beside no log)")

    forms: dict[object, list[Sample]] = {}
    for one in [samples[name] for name in files if name in samples]:
        time = one.time.value if one.time else None
        forms.setdefault((one.names, time), []).append(one)
    for of_form in forms.values():
        Form(found, source, of_form, tables, tuple(fingers), answers).understand()
    hands = {(plan.unit_of_values, len(plan.sensors)) for plan, _ in found.plans}
    if len(hands) > 1:
        words = " and ".join(f"{n} sensors in {unit}" for unit, n in sorted(hands))
        found.ask("SOURCE", f"logs of {words}: import each hand on its own")
    return found


def of_map(source: Path, plan: ImportMap) -> Proposal:
    """The logs of a source by a map. Raises DataNotFound."""
    places, _ = find_logs(source)
    pattern = plan.events.file if plan.events else ""
    beside = [one for one in places if one.kind == SCALARS]
    beside += [
        one for one in places if fnmatch(f"{one.name}{one.path.suffix}", pattern)
    ]
    logs = [one for one in places if one not in beside]
    names_trials = plan.events is not None and plan.events.trial
    of_folders = [one for one in beside if names_trials and one.kind != SCALARS]
    files = files_of(logs, beside, plan.trials.fingers, of_folders)
    found = Proposal(plans=[(plan, files)])
    found.add("sensors", f"{len(plan.sensors)}, by the map")
    found.add("unit", f"{plan.unit}, by the map")
    return found


def _sample(
    files: list[LogPlace],
    log: ForeignLog,
    answers: Answers,
    found: Proposal,
    is_joined: bool = False,
) -> Sample | None:
    """A log with its time and its sensors; None of a table without readings, or where it is asked.

    Raises ColumnError.
    """
    whole, longest = merged(log), first_stream(log)
    if longest.rows < 2:
        return None
    marks = [name for name, column in whole.items() if is_mark(name, column)]
    sensors = find_sensors(whole, longest.columns, marks, answers.sensors, is_joined)
    names = [name for sensor in sensors.value for name in sensor.axes]
    columns = table_of(log, names)
    time = find_time(columns or whole, answers.rate, log.about.get("rate_hz"))
    clock = time.value.column if time else ""
    if longest.rows < FEWEST_ROWS and not (names and clock):
        return None
    of_rows = columns or longest.columns
    beside = {name: cells for name, cells in of_rows.items() if name not in names}
    keys = in_turn(beside, {name: of_rows[name] for name in names}, clock)
    if keys and (names or sensors.why):
        text = f"each row of {log.name} is of one {listed(keys)} that comes in turn"
        found.ask("SOURCE", f"{text}: write a row for each time, with all sensors")
        return None
    if not names:
        if sensors.why:
            text = f"{sensors.why} of {log.name}: which are x, y and z of each sensor?"
            found.ask("--sensors", f"{text} {NO_SHEAR}")
        return None
    if clock and is_twice(columns, clock, names):
        found.ask("SOURCE", f"rows of {log.name} stand there twice: take them out")
        return None
    values = channels(columns, names)
    values = without_codes(without_jumps(values) if answers.unwrap else values)
    if is_union(values):
        raise ColumnError(
            "no row has all sensors, or few by chance: each is of one topic or sensor",
            where=log.path,
            next_step="write a row for each time, with all sensors",
        )
    # fingers are no sum, and what is given is not judged
    is_judged = not (answers.sensors or FINGER.search(names[0]) or is_joined)
    sums = sums_of_others(values) if is_judged else []
    if sums:
        shown = listed([sensors.value[k].z for k in sums])
        text = f"{shown} is the sum or the mean of the others: which columns are the sensors?"
        found.ask("--sensors", f"{text} ({listed(names, most=9)})")
        return None
    effects, _ = touch(values)
    unit = unit_of(names, values, effects, _units_beside(log, columns))
    span_s = 0.0, float(longest.rows)
    if time and clock:
        stamps_s = columns[clock] * (1e-9 * time.value.unit_ns)
        span_s = float(np.nanmin(stamps_s)), float(np.nanmax(stamps_s))
        marks = [name for name in marks if name != clock]
    # the readings of all logs would fill the memory
    others = [one for one in log.streams if not {*names} & one.columns.keys()]
    log = replace(log, streams=tuple(others))
    marks = [name for name in marks if name in beside]
    return Sample(files, log, beside, time, sensors, marks, effects, span_s, unit)


def _units_beside(log: ForeignLog, columns: Columns) -> str:
    """Words for the unit of the readings in the head of a log, its path, and beside them."""
    words = [log.about.get("unit") or "", *UNIT_OF_PATH.findall(log.name)]
    for name, column in columns.items():
        if is_text(column) and UNIT_COLUMN.fullmatch(name):
            words.append(max(column))
    return " ".join(words)


# -- files of one trial


def _of_folders(
    beside: Sequence[LogPlace], others_read: Mapping[Path, ForeignLog]
) -> list[LogPlace]:
    """Tables that name their trials, one in each of several folders."""
    in_folders = [one for one in beside if "/" in one.name and one.kind != SCALARS]
    counts = Counter(one.path.name for one in in_folders)
    naming = [
        one
        for one in in_folders
        if any(is_called(name, TRIAL) for name in merged(others_read[one.path]))
    ]
    return [one for one in naming if counts[one.path.name] > 1]


def _fingers(samples: Sequence[Sample], answers: Answers, found: Proposal) -> list[str]:
    """The words by which the files of one trial differ, a file for each finger; [] for none.

    Such files have one sensor each, and are named alike but for one word, which names a finger or
    a sensor. A word that may be one, or a hand, is asked.
    """
    if answers.fingers:
        return answers.fingers.split(",")
    names = [[word[0] for word in WORD.finditer(one.log.name)] for one in samples]
    are_single = {len(one.names) for one in samples} == {len(AXES)}
    if len({*map(len, names)}) > 1:
        return []
    for at in range(len(names[0])):
        words = [*dict.fromkeys(one[at] for one in names)]
        trials = Counter(" ".join([*one[:at], *one[at + 1 :]]) for one in names)
        if are_single and len(words) > 1 and all(map(FILE_OF_A_SENSOR.match, words)):
            return sorted(words, key=lambda word: (finger_order(word), counted(word)))
        if len(words) < 2 or {*trials.values()} != {len(words)}:
            continue
        kind = kind_of(words, answers)
        if kind not in NAMES and (
            (are_single and kind == "unclear") or are_two_hands(words)
        ):
            each = ",".join(words)
            found.ask(
                "--fingers",
                f"are {each} fingers of one trial? nothing says it: --fingers {each}, "
                f"or --object {each} for trials",
            )
    return []
