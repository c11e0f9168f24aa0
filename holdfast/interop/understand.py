"""What the logs of a folder are: a map for each form of log, a short table, and one question.

Everything is taken from what columns hold, then from names. What nothing in the logs says, and no
answer on the command line, is asked.

Steps: find the logs; read each once and keep its first readings; join the files of one trial; sort
the logs by their columns; make a map for each such form (forms.py). trials.py then reads the logs a
second time by the maps, one after the other.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from holdfast.core.errors import listed
from holdfast.core.progress import Part, ignored
from holdfast.interop.columns import channels, find_sensors, find_time, touch, unit_of
from holdfast.interop.forms import Form
from holdfast.interop.labels import is_mark
from holdfast.interop.logs import LogPlace, find_logs, read_log, table_of
from holdfast.interop.map import NUMBERED, ImportMap
from holdfast.interop.streams import (
    Columns,
    ForeignLog,
    counted,
    first_stream,
    is_text,
    merged,
)
from holdfast.interop.tables import pd
from holdfast.interop.trials import files_of, read_joined
from holdfast.interop.understood import Answers, Sample, Understood

FINGERS = ("thumb", "index", "middle", "ring", "little", "pinky", "palm", "finger")
KEPT_ROWS = 1000
"""Of readings, once it is known what a touch does to them."""
FEWEST_ROWS = 100
"""Of a log without a time: shorter ones are tables of something else."""
FINGER_NAMES = re.compile("|".join(FINGERS), re.IGNORECASE)
FINGER = re.compile(
    rf"(?i){'|'.join(FINGERS)}|(sensor|pad|taxel|tip|jaw|ch|f|s)[-_ ]?\d|left|right"
)
"""What the file of one finger is called by."""
CLOCK_S, DATE_S = 60.0, 1e8
"""A clock that stands later than this was not begun with the trial; a still later one is a date."""
OVERLAP = 0.7
"""Of the spans of files that belong to one trial."""


def understand(source: Path, answers: Answers, part: Part = ignored) -> Understood:
    """What the logs of a source are.

    source: a folder or a file. answers: what the command line says, which wins over what is seen.
    part: receives the share that is read. Raises a DataError where no log can be read at all.
    """
    found = Understood()
    places, others = find_logs(source)
    samples: list[Sample] = []
    tables: list[ForeignLog] = []
    for number, place in enumerate(places, 1):
        # no more than one is in the memory
        found.kept.clear()
        found.kept[place.name] = log = read_log(place)
        sample = _sample([place], log, answers)
        samples += [sample] if sample else []
        tables += [] if sample else [log]
        part(number / len(places))
    if len(places) > 1:
        found.kept.clear()

    unread = f"; not read: {listed(others, most=6)}" if others else ""
    found.add("logs", f"{len(samples)}{unread}")
    if not samples:
        names = listed([*merged(tables[0])], most=24)
        what = f"which columns of {tables[0].name} are x, y and z of each sensor? ({names})"
        found.ask("--map", f"{what}; a map names them (docs/your-data.md)")
        return found

    fingers = _fingers(samples)
    if fingers:
        each = f"the files {listed(fingers)} of each trial"
        found.add("joined", f"{each}, on the slowest clock")
        files = files_of([one.files[0] for one in samples], fingers)
        joined = []
        for name, group in files.items():
            log = read_joined(group, fingers, name)
            joined.append(_sample(group, log, answers))
        samples = [*filter(None, joined)]

    forms: dict[object, list[Sample]] = {}
    for sample in samples:
        forms.setdefault((sample.form, sample.time), []).append(sample)
    for of_form in forms.values():
        Form(found, source, of_form, tables, tuple(fingers), answers).understand()
    hands = {(plan.unit_of_values, len(plan.sensors)) for plan, _ in found.plans}
    if len(hands) > 1:
        words = " and ".join(f"{n} sensors in {unit}" for unit, n in sorted(hands))
        found.ask("SOURCE", f"logs of {words}: import each hand on its own")
    return found


def of_map(source: Path, plan: ImportMap) -> Understood:
    """The logs of a source by a map. Raises DataNotFound."""
    places, _ = find_logs(source)
    found = Understood(plans=[(plan, files_of(places, plan.trials.fingers))])
    found.add("sensors", f"{len(plan.sensors)}, by the map")
    found.add("unit", f"{plan.unit}, by the map")
    return found


def _sample(files: list[LogPlace], log: ForeignLog, answers: Answers) -> Sample | None:
    """A log with its time and its sensors; None for a table without readings."""
    whole, longest = merged(log), first_stream(log)
    marks = [name for name, column in whole.items() if is_mark(name, column)]
    sensors, why = find_sensors(whole, longest.columns, marks)
    names = tuple(name for sensor in sensors for name in sensor.axes)
    columns = table_of(log, names)
    time = find_time(columns, answers.rate or log.about.get("rate_hz"))
    if time is None or time.rate_hz:
        has_texts = any(map(is_text, whole.values())) and not why.startswith("by")
        if has_texts or longest.rows < FEWEST_ROWS:
            return None
    if not names:
        return None
    values = channels(columns, names)
    effects, touched = touch(values)
    size = unit_of(names, values, effects[0])
    marks = [name for name, column in columns.items() if is_mark(name, column)]
    if time and time.column in marks:
        marks.remove(time.column)
    streams = [replace(one, columns=_short(one.columns, names)) for one in log.streams]
    log, columns = replace(log, streams=tuple(streams)), _short(columns, names)
    return Sample(
        files, log, columns, time, sensors, names, why, marks, effects, touched, size
    )


def _short(columns: Columns, readings: Sequence[str]) -> Columns:
    """Columns with the first rows of the readings, so that long logs do not fill the memory."""
    short = {}
    for name, cells in columns.items():
        short[name] = cells[:KEPT_ROWS].copy() if name in readings else cells
    return short


# -- files of one trial


def _fingers(samples: Sequence[Sample]) -> list[str]:
    """The words by which the files of one trial differ, a file for each finger; [] for none.

    Such files have one sensor each, are named alike but for one word, and run at the same time.
    The word names a finger; or the clock is that of the day, so that overlap is no accident.
    """
    names = [re.split(r"[/_ .]+|-(?=[A-Za-z])", one.log.name) for one in samples]
    if any(len(one.sensors) > 1 for one in samples) or len({*map(len, names)}) > 1:
        return []
    firsts = pd.Series([np.nanmin(one.stamps_s) for one in samples])
    lasts = pd.Series([np.nanmax(one.stamps_s) for one in samples])
    for k, words in enumerate(map(dict.fromkeys, zip(*names, strict=True))):
        # trials that begin at 0 each seem to run at the same time
        is_number = all(map(NUMBERED.fullmatch, words))
        is_clock = firsts.min() > (DATE_S if is_number else CLOCK_S)
        trials = np.array([" ".join([*one[:k], *one[k + 1 :]]) for one in names])
        begins, ends = firsts.groupby(trials), lasts.groupby(trials)
        both = ends.min() - begins.max()
        overlap = both > OVERLAP * (ends.max() - begins.min())
        is_whole = (ends.size() == len(words)).all() and overlap.all()
        may_join = is_clock or all(map(FINGER.search, words))
        if len(words) > 1 and may_join and is_whole:
            return sorted(words, key=_finger_order)

    return []


def _finger_order(word: str) -> tuple[int, list[int | str]]:
    found = FINGER_NAMES.search(word)
    return FINGERS.index(found[0].lower()) if found else len(FINGERS), counted(word)
