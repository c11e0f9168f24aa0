"""What marks situations: words, columns of labels, tables of events.

A label means what its words say, or what the command line says; a column that is called slip marks
the slip by its two values. All other labels are asked. A label that stands only in the row where
something begins holds until the next one. Whatever marks it, the events of a trial are one table:
`start` and `end`, and the `label` that lasts from one to the other.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import IntArray
from holdfast.core.errors import LabelError, listed
from holdfast.data.datasets.trials import action_of
from holdfast.interop.columns import CLOCK_NS
from holdfast.interop.formats.logs import LogPlace, read_log
from holdfast.interop.formats.streams import (
    Column,
    Columns,
    ForeignLog,
    is_text,
    text_cells,
)
from holdfast.interop.formats.tables import pd
from holdfast.interop.map import EventRules, ImportMap
from holdfast.interop.words import (
    BEGIN,
    END,
    ENDINGS,
    FILLERS,
    LABEL,
    LENGTH,
    OFF,
    OTHER_TIMES,
    OUTCOMES,
    OVER,
    ROWS,
    SITUATIONS,
    START,
    TIME,
    TIME_UNITS,
    TRIAL,
    is_called,
    meaning,
    says,
    unit_of_time,
    words_of,
)

ROW = "row"
MOST_CODE = 1000
"""Numbers that mark a situation are smaller; those of a clock are not."""
ACTION_OF_SITUATION = {"grasp": "hold", "risky_slip": "slip", "safe_slip": "pass"}
MOST_LABELS = 40
LATE, SOON_S = 1.1, 0.05
"""An event lies within a log of so many times its length; a clock begins at 0, but for this."""
_OUTCOMES, _SITUATIONS = (
    {key: f"(?:(?:{words}){ENDINGS} ?)+" for key, words in meanings.items()}
    for meanings in (OUTCOMES, SITUATIONS)
)
"""Situation -> pattern of a text whose words all mean it."""
EVENT = {"start": np.nan, "end": np.nan, "label": "", "trial": ""}
"""The columns of a table of events, and what stands in a column that a table has not."""
NO_EVENTS = pd.DataFrame(columns=[*EVENT], dtype=object)


def situation_of_word(label: str) -> str | None:
    """The situation that a label means by all its words, "" for none; else None.

    >>> [situation_of_word(one) for one in ("GraspStable", "slip end", "slip prevented")]
    ['grasp', '', None]
    """
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", label).lower()
    words = re.findall(r"[a-z]+", parted)
    ends = [word for word in (*words[:1], *words[-1:]) if re.fullmatch(OVER, word)]
    if len(words) > 1 and ends:
        return ""
    fillers = "|".join([FILLERS, *TIME_UNITS.values()])
    kept = [word for word in words if not re.fullmatch(fillers, word)]
    return meaning(" ".join(kept), _SITUATIONS)


def action_of_word(word: str) -> str | None:
    """The action that a whole word of a path or a column means; None where it says nothing."""
    plain = re.sub(r"[^a-z]+", " ", word.lower()).strip()
    situation = meaning(plain, _OUTCOMES)
    return action_of(word) or ACTION_OF_SITUATION.get(situation or "")


def action_of_sentence(text: str) -> str | None:
    """The action of a word, or of a sentence that begins with an action of ours."""
    first = text.split()[:2]
    return action_of_word(text) or action_of("-".join(first)) or action_of(first[0])


# -- what a column of labels means


@dataclass(frozen=True)
class LabelMeanings:
    """Rules, the labels whose situation must be asked, and what checks the times.

    starts: columns any of which may be the start of an event.
    """

    rules: EventRules
    unknown: Sequence[str] = ()
    check: str = ""
    starts: Sequence[str] = ()

    @property
    def text(self) -> str:
        """What the labels mean."""
        labels = self.rules.labels.items()
        shown = [
            f"{label or 'each'} = {meaning or 'none'}" for label, meaning in labels
        ]
        holds = "; each holds to the next, or to the end of the contact"
        return listed(shown, most=8) + (holds if self.rules.hold else "")


def is_mark(name: str, column: Column) -> bool:
    """Whether a column can hold labels: texts, or few whole numbers that seldom change.

    A time is none, such as that of a slip, which is the same in all rows.
    """
    if unit_of_time(name) or says(name, f"{TIME}|frames?"):
        return False
    if is_text(column):
        return len(pd.unique(column)) <= MOST_LABELS
    cells = column[np.isfinite(column)]
    if (cells % 1 != 0).any() or (np.abs(cells) >= MOST_CODE).any():
        return False
    kinds = len(pd.unique(cells))
    is_named = says(name, LABEL)
    seldom = np.count_nonzero(np.diff(cells)) < 0.1 * len(column)
    return bool(seldom) and (1 < kinds <= 8 or (kinds == 1 and is_named))


def labels_of(
    name: str, cells: Sequence[str], known: Mapping[str, str]
) -> LabelMeanings | None:
    """What a column of labels means; None for one that marks nothing.

    cells: of all logs, one after the other. known: label -> situation, as given; else a label means
    what its words say. Of two values of a column that is called slip, one marks it.
    """
    kinds = [*dict.fromkeys(cells)]
    if len(kinds) > MOST_LABELS:
        return None
    off = [kind for kind in kinds if re.fullmatch(OFF, kind.lower())]
    labels = _by_words(kinds, known)
    # of files of one trial the finger stands before a dot
    name_alone = name.rpartition(".")[2]
    about = situation_of_word(name_alone) if "slip" in name_alone.lower() else None
    on = [kind for kind in kinds if kind not in off]
    if about and len(on) <= 1 and (off or on == ["1"]):
        on = on or ["1"]
        no = [*filter(None, off)] or ["0"]
        if about == "grasp":
            on, no = no, on
        labels = dict.fromkeys(no, "") | dict.fromkeys(on, "risky_slip")
    # a label in a row or two lasts on
    marked = ~is_off(cells)
    begins = marked & ~np.append(False, marked[:-1])
    hold = bool(0 < marked.sum() <= 2 * begins.sum())
    if hold:
        labels = {kind: meaning for kind, meaning in labels.items() if kind not in off}
    else:
        labels = dict.fromkeys(filter(None, off), "") | labels
    unknown = [kind for kind in kinds if kind not in labels and kind not in off]
    if not any(labels.values()) and not (unknown and says(name, LABEL)):
        return None
    rules = EventRules(column=name, hold=hold, labels=labels)  # type: ignore[arg-type]
    return LabelMeanings(rules, unknown)


def is_off(cells: Sequence[str] | np.ndarray) -> np.ndarray:
    """[T] where a cell says that nothing is marked there."""
    off: np.ndarray = pd.Series(cells).str.lower().str.fullmatch(OFF).to_numpy()
    return off


def _by_words(kinds: Iterable[str], known: Mapping[str, str]) -> dict[str, str]:
    """Label -> situation, "" for none, as given or by its words; none where they say nothing."""
    meanings = {kind: known.get(kind, situation_of_word(kind)) for kind in kinds}
    # of slip_0 and slip_1 one marks no slip
    off = {
        kind[:-1] for kind in meanings.keys() - known.keys() if re.search(r"\D0$", kind)
    }
    return {
        kind: meaning
        for kind, meaning in meanings.items()
        if meaning is not None
        and (kind in known or re.sub(r"\d+$", "", kind) not in off)
    }


# -- what a table of events means


def rules_of_table(
    columns: Columns, keys: set[str], file: str, known: Mapping[str, str]
) -> LabelMeanings | None:
    """What the columns of a table of events are; None where no heading names a start or a label.

    A row is an event: when it starts, when it ends or how long it lasts, what it is, and which
    trial it is of. A table without labels is of one kind, by the name of the column or the file.
    keys: what logs are called, in small letters. The zero of its times comes later.
    """
    trial = next((name for name in columns if _are_trials(name, columns, keys)), "")
    texts = [name for name in columns if name != trial and is_text(columns[name])]
    numbers = [name for name in columns if name not in (trial, *texts)]
    # a table without a heading is a track of labels: start, end, label
    starts, end, label = numbers[:1], (*numbers[1:2], "")[0], (*texts, "")[0]
    if "column1" not in columns:
        starts, end = _start_and_end(numbers)
        label = next((name for name in texts if says(name, LABEL)), "")
    if not starts:
        return None
    start = starts[0]
    about = situation_of_word(start)
    if about:
        label = ""
    about = about or situation_of_word(Path(file).stem) or ""
    kinds = [*dict.fromkeys(filter(None, text_cells(columns[label])))] if label else []
    labels = _by_words(kinds, known) if label else {"": about}
    unknown = [kind for kind in kinds if kind not in labels]
    # words that say nothing are labels where an end stands beside them
    is_known = any(labels.values()) or (unknown and end)
    if not is_known or len(kinds) > MOST_LABELS:
        return None
    is_row, is_date = says(start, ROWS), columns[start].dtype.kind == "i"
    is_date &= columns[start].max() > CLOCK_NS
    unit = ROW if is_row else unit_of_time(start) or ("ns" if is_date else "s")
    rules = EventRules(
        file=file,
        trial=trial,
        start=start,
        end=end,
        label=label,
        unit=unit,  # type: ignore[arg-type]
        hold=not end,
        labels=labels,  # type: ignore[arg-type]
    )
    return LabelMeanings(rules, unknown, starts=starts[1:] and starts)


def _are_trials(name: str, columns: Columns, keys: set[str]) -> bool:
    """Whether cells are what logs are called by; numbers are so only by the column's name."""
    found = keys & {*map(str.casefold, text_cells(columns[name]))}
    if is_called(name, TRIAL):
        return bool(found)
    return is_text(columns[name]) and len(found) > 1


def _start_and_end(names: Sequence[str]) -> tuple[list[str], str]:
    """(the columns any of which may be the start of an event, that of its end), by headings."""
    names = [name for name in names if not says(name, OTHER_TIMES)]
    ends = [name for name in names if says(name, END)]
    others = [name for name in names if name not in ends]
    slips = [name for name in others if situation_of_word(name) == "risky_slip"]
    slips = [name for name in slips if says(name, START)]
    starts: list[str] = []
    for words in (BEGIN, TIME, ROWS):
        starts = starts or [name for name in others if says(name, words)]
    if slips:
        # of the times of several events that of the slip
        starts = slips[:1]
    if starts and situation_of_word(starts[0]):
        # its end is that of the same event, not of the trial
        said = {word for word in words_of(starts[0]) if meaning(word, _SITUATIONS)}
        ends = [name for name in ends if said & words_of(name)]
    return starts, (*ends, "")[0]


def zeros_of(
    rules: EventRules, columns: Columns, spans_s: Sequence[tuple[float, float]]
) -> list[Literal["log", "clock"]]:
    """From where a table may count its times, so that all lie in the logs: begin, or clock.

    spans_s: of the logs.
    """
    times = columns[rules.start].astype(np.float64)
    times = times[np.isfinite(times)]
    if rules.unit == ROW or not len(times):
        return ["log"]
    first_s, last_s = (
        1e-9 * NS_OF[rules.unit] * one for one in (times.min(), times.max())
    )
    begins_s, ends_s = np.transpose(spans_s)
    longest_s = max(ends_s - begins_s)
    late_s = (LATE - 1.0) * longest_s
    zeros: list[Literal["log", "clock"]] = []
    if last_s <= longest_s + late_s:
        zeros.append("log")
    # where the clock begins at 0, both are the same
    is_same = bool(zeros) and min(begins_s) <= SOON_S
    if not is_same and min(begins_s) < first_s and last_s <= max(ends_s) + late_s:
        zeros.append("clock")
    return zeros


# -- the events of a trial


def events_of(
    log: ForeignLog, plan: ImportMap, source: Path
) -> tuple[pd.DataFrame, Path]:
    """(the events of a log, where they stand), in the unit of the rules, with the columns of EVENT.

    In a table of the log or beside it, else in one for all logs. A trial without an event has a row
    without a start. Raises ColumnError or LabelError.
    """
    rules = plan.events
    if rules is None or not rules.file:
        return NO_EVENTS, log.path
    path, streams = log.path, log.streams
    if "*" not in rules.file:
        path = (source if source.is_dir() else source.parent) / rules.file
        if path != log.path:
            streams = read_log(LogPlace(path, path.stem, path.suffix.lower())).streams
    tables = [
        one.columns for one in streams if not one.columns.keys() & {*plan.channels}
    ]
    tables.sort(key=lambda columns: rules.start not in columns)
    if not tables:
        return NO_EVENTS, path
    columns = tables[0]
    names = {key: getattr(rules, key) for key in EVENT}
    is_fact = not rules.label and "*" in rules.file
    if not is_fact:
        plan.require_columns(columns, path, {*names.values()} - {""})
    events = pd.DataFrame(columns)
    events = pd.DataFrame(
        {key: events.get(name, EVENT[key]) for key, name in names.items()}, events.index
    )
    for key in ("label", "trial"):
        events[key] = text_cells(events[key].to_numpy())
    times = events[["start", "end"]].apply(pd.to_numeric, errors="coerce")
    if is_fact:
        # what has no time, a negative one or 0 did not happen
        times["start"] = times["start"].where(times["start"] > 0.0)
    unit, end_unit = rules.unit, unit_of_time(rules.end)
    if end_unit and unit != ROW:
        times["end"] *= NS_OF[end_unit] / NS_OF[unit]
    if says(rules.end, LENGTH):
        times["end"] += times["start"]
    # a point has no end
    times["end"] = times["end"].where(times["end"] != times["start"])
    events = events.assign(**times)
    wrong = events[events["end"] < events["start"]]
    if len(wrong):
        start, end, label, _ = wrong.iloc[0]
        raise LabelError(
            f"{label!r:.60} from {start:g} to {end:g} {rules.unit} is impossible",
            where=path,
            next_step="correct that line",
        )

    # what lasts shorter lies within what lasts longer; one without an end lasts to the next one
    order = ["trial", "start", "end"]
    events = events.sort_values(order, ascending=[True, True, False])
    following = events.groupby("trial")["start"].shift(-1)
    return events.fillna({"end": following}).fillna({"end": np.inf}), path


def clock_of(rules: EventRules, stamps: IntArray) -> np.ndarray:
    """[T] the time of a trial's rows as its table of events has it. stamps [T]: ns."""
    if rules.unit == ROW:
        return np.arange(len(stamps))
    zero_ns = 0 if rules.zero == "clock" else stamps[0]
    # as exact as an event is written
    return np.round((stamps - zero_ns) / NS_OF[rules.unit], 6)


def marks_of(cells: np.ndarray, rules: EventRules) -> np.ndarray:
    """A column of labels [T]; one that stands only where something begins lasts to the next."""
    return held(np.where(is_off(cells), "", cells)) if rules.hold else cells


def held(cells: np.ndarray) -> np.ndarray:
    """Cells [T] in which an empty one repeats the one before."""
    begins = np.where(cells != "", np.arange(len(cells)), 0)
    return cells[np.maximum.accumulate(begins)]
