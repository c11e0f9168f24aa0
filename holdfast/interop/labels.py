"""What marks situations: words, columns of labels, tables of events.

Two values in a column mark the slip; English words name situations in any column; other words are
known by when they stand: while the hand is empty, and for most of a touch. A label that stands only
in the row where something begins holds until the next one.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import SITUATIONS, IntArray
from holdfast.core.errors import ColumnError, LabelError, listed
from holdfast.core.trial_layout import LABELLED_ACTIONS, UNSCRIPTED
from holdfast.interop.columns import unit_of_time, words_of
from holdfast.interop.logs import LogPlace, read_log
from holdfast.interop.map import EventRules
from holdfast.interop.streams import Column, Columns, is_text, text_cells
from holdfast.training.datasets.trials import action_of

ROW = "row"
ROW_WORDS = {"row", "rows", "index", "frame", "sample"}
LABEL_WORDS = {
    "label", "labels", "event", "events", "phase", "state", "situation", "marker", "markers",
    "annotation", "class", "slip", "slipping", "status", "trigger", "contact", "what",
}  # fmt: skip
TRIAL_WORDS = {"trial", "file", "log", "run", "recording", "episode", "name"}
START_WORDS = {"start", "begin", "from", "onset", "t0", "time", "at"}
END_WORDS = {
    "end",
    "stop",
    "to",
    "until",
    "offset",
    "finish",
    "duration",
    "length",
    "t1",
}
SITUATION_STEMS = (
    ("", ("unlabel", "unknown", "none", "ignore")),
    (
        "nothing",
        ("nothing", "no contact", "open", "empty", "idle", "rest", "free", "no touch"),
    ),
    (
        "grasp",
        (
            "no slip",
            "noslip",
            "non slip",
            "not slip",
            "stable",
            "still",
            "static",
            "steady",
        ),
    ),
    (
        "safe_slip",
        ("safe", "release", "handover", "hand over", "hand-over", "put down", "place"),
    ),
    (
        "risky_slip",
        ("slip", "slid", "drop", "fall", "fell", "fail", "lost", "tug", "pull", "torn"),
    ),
    ("grasp", ("grasp", "hold", "held", "grip", "contact", "lift", "carry", "touch")),
)
"""Beginnings of words in labels, the first that fits counts."""
ENDS = ("end", "stop", "finish", "over", "off")
ACTION_OF_SITUATION = {
    "grasp": "hold",
    "risky_slip": "slip",
    "safe_slip": "pass",
    "nothing": "nothing",
}
NEED_EVENTS = tuple(name for name in UNSCRIPTED if name not in LABELLED_ACTIONS)
"""Actions that follow no script: what happens when is known by events alone."""
MOST_LABELS = 40
FOR_EVER = 2.0**62


@dataclass(frozen=True)
class Event:
    """A label that lasts, ns on the log's clock, or in the unit of its table. trial: "" for any."""

    start: float
    end: float
    label: str
    trial: str = ""


def situation_of_word(label: str) -> str | None:
    """The situation that a label means by its words, "" for none; None where they say nothing."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", label).lower()
    plain = " ".join(re.findall(r"[a-z]+", parted))
    if plain.replace(" ", "_") in SITUATIONS:
        return plain.replace(" ", "_")
    words = plain.split()
    if len(words) > 1 and (words[0] in ENDS or words[-1] in ENDS):
        return ""
    for situation, stems in SITUATION_STEMS:
        if any(re.search(rf"\b{stem}", plain) for stem in stems):
            return situation

    return None


def action_of_word(word: str, *, has_events: bool = False) -> str | None:
    """The action that a word means; None where it says nothing.

    has_events: else an action that needs its phases is only a slip or a hold.
    """
    known = action_of(word)
    if known is not None and (has_events or known not in NEED_EVENTS):
        return known
    return ACTION_OF_SITUATION.get(situation_of_word(word) or "")


# -- columns of labels


@dataclass(frozen=True)
class FoundLabels:
    """Rules, what was understood in words, and labels whose situation nothing says."""

    rules: EventRules
    why: str
    unknown: tuple[str, ...] = ()


def is_mark(name: str, column: Column) -> bool:
    """Whether a column can hold labels: texts, or few whole numbers that seldom change."""
    if is_text(column):
        return len(set(column.tolist())) <= MOST_LABELS
    cells = column[np.isfinite(column)]
    if (cells[:1000] % 1 != 0).any():
        return False
    kinds = np.unique(cells)
    is_few = len(kinds) <= 8 and bool((kinds % 1 == 0).all())
    is_named = bool(words_of(name) & LABEL_WORDS)
    seldom = np.count_nonzero(np.diff(cells)) < 0.1 * len(cells)
    return is_few and bool(seldom) and (len(kinds) > 1 or is_named)


def labels_of(
    name: str, cells: np.ndarray, touched: np.ndarray, known: Mapping[str, str]
) -> FoundLabels | None:
    """What a column of labels means; None for one that marks nothing.

    cells, touched [T]: of all logs, one after the other; touched: whether the hand touches
    something. known: label -> situation, as given.
    """
    values = [value for value in dict.fromkeys(cells.tolist()) if value]
    by_word = {value: known.get(value, situation_of_word(value)) for value in values}
    n_kinds = len(set(cells.tolist()))
    if not values or n_kinds > MOST_LABELS:
        return None
    if n_kinds <= 2 and not all(by_word.values()):
        return _binary(name, cells, touched)
    hold = bool(np.mean(cells == "") > 0.5)
    if any(one is not None for one in by_word.values()):
        labels = {value: situation or "" for value, situation in by_word.items()}
        lost = [value for value, situation in by_word.items() if situation is None]
        no_meaning = f"; without a meaning: {listed(lost, most=6)}" if lost else ""
        return _found(name, labels, no_meaning, hold=hold)

    held_cells = np.array(held(cells.tolist()) if hold else cells)
    return _by_content(name, held_cells, touched, values, hold=hold)


def _binary(name: str, cells: np.ndarray, touched: np.ndarray) -> FoundLabels | None:
    """Two values: the one in which logs begin, and the one that marks the slip."""
    off = cells[0]
    on = next((value for value in cells.tolist() if value != off), "1")
    marked = cells == on
    is_slip = bool(re.search("(?i)slip", name))
    begins = np.count_nonzero(np.diff(marked.astype(np.int8)) == 1)
    if not is_slip:
        inside = marked.any() and touched[marked].mean() > 0.9
        if not (inside or (words_of(name) & LABEL_WORDS and marked.any())):
            return None
        if marked[touched].mean() > 0.8:
            return _found(name, {on: "grasp", off: "nothing"}, ": the contact")

    if marked.any() and marked.sum() <= 2 * begins:
        ends = ": the slip, from there to the end of the contact"
        rules = EventRules(column=name, hold=True, labels={on: "risky_slip"})
        return FoundLabels(rules, f"column {name}, {on!r} marks{ends}")

    return _found(name, {on: "risky_slip", off: ""}, f": {on!r} marks the slip")


def _by_content(
    name: str,
    cells: np.ndarray,
    touched: np.ndarray,
    values: Sequence[str],
    *,
    hold: bool,
) -> FoundLabels | None:
    """Words or numbers that say nothing, by when they stand.

    Those that stand while nothing is touched mean the empty hand, and the most frequent one of a
    touch means the grasp. What is left is listed as unknown, because a slip cannot be seen so.
    """
    shares = {value: float(touched[cells == value].mean()) for value in values}
    counts = Counter(cells[touched].tolist())
    grasp = max(values, key=lambda value: counts[value])
    empty = [value for value in values if shares[value] < 0.3]
    if values[0] not in empty or shares[grasp] < 0.5 or len(values) > 8:
        return None
    labels = {**dict.fromkeys(empty, "nothing"), grasp: "grasp"}
    unknown = tuple(value for value in values if value not in labels)
    return _found(name, labels, ", by when they stand", unknown, hold=hold)


def _found(
    name: str,
    labels: dict[str, str],
    why: str,
    unknown: tuple[str, ...] = (),
    *,
    hold: bool = False,
) -> FoundLabels:
    labels.pop("", None)
    shown = [
        label if label == one else f"{label} = {one}"
        for label, one in labels.items()
        if one
    ]
    rules = EventRules(column=name, hold=hold, labels=labels)  # type: ignore[arg-type]
    return FoundLabels(rules, f"column {name}, {listed(shown, most=8)}{why}", unknown)


def held(cells: Sequence[str]) -> list[str]:
    """Cells in which an empty one repeats the one before."""
    last, kept = "", []
    for cell in cells:
        last = cell or last
        kept.append(last)

    return kept


def runs_of(cells: Sequence[str], stamps: IntArray) -> list[Event]:
    """Runs of equal cells [T] as events, ns."""
    events = []
    for k, cell in enumerate(cells):
        if not k or cell != cells[k - 1]:
            events.append(Event(float(stamps[k]), np.nan, cell))

    return with_ends(events)


# -- tables of events


def rules_of_table(
    columns: Columns, keys: set[str], file: str, known: Mapping[str, str]
) -> EventRules | None:
    """What the columns of a table of events are; None where it has no start or no label.

    A row is an event: when it starts, when it ends or how long it lasts, what it is, and which
    trial it is of. A table without labels is of one kind, by the name of the column or the file.
    keys: what logs are called, in small letters. Unit and zero come later.
    """
    trial = ""
    for name, column in columns.items():
        cells = set(map(str.casefold, text_cells(column))) - {""}
        is_named = bool(words_of(name) & TRIAL_WORDS)
        if cells and (
            cells <= keys if is_named else is_text(column) and len(cells & keys) > 1
        ):
            trial = trial or name

    numbers: list[str] = []
    texts: list[str] = []
    for name, column in columns.items():
        if name != trial:
            (texts if is_text(column) else numbers).append(name)

    start = _named(numbers, START_WORDS | ROW_WORDS) or next(iter(numbers), "")
    label = _named(texts, LABEL_WORDS) or next(iter(texts), "")
    about = situation_of_word(start) or situation_of_word(Path(file).stem) or ""
    if not (start and (label or about)):
        return None
    numbers.remove(start)
    after = [name for name in numbers if (columns[name] >= columns[start]).all()]
    labels = {}
    for cell in text_cells(columns[label]) if label else []:
        labels[cell] = known.get(cell) or situation_of_word(cell) or ""
    labels.pop("", None)
    if len(labels) > MOST_LABELS or (label and not any(labels.values())):
        return None
    return EventRules(
        file=file,
        trial=trial,
        start=start,
        end=_named(numbers, END_WORDS) or next(iter(after), ""),
        label=label,
        situation="" if label else about,  # type: ignore[arg-type]
        labels=labels,  # type: ignore[arg-type]
    )


def _named(names: Sequence[str], words: set[str]) -> str:
    return next((name for name in names if words_of(name) & words), "")


def unit_and_zero(
    rules: EventRules, latest: float, first_s: float, last_s: float
) -> tuple[str, str]:
    """The unit of a table's times, and whether they count from a log's begin or on its clock.

    latest: the last time in the table, in its unit. first_s, last_s: of the log. The first unit
    counts with which the last event lies within the log.
    """
    if words_of(rules.start) & ROW_WORDS:
        return ROW, "log"
    lasts_s = last_s - first_s
    named = unit_of_time(rules.start)
    for unit in (named,) if named else NS_OF:
        latest_s = latest * NS_OF[unit] * 1e-9
        if 0.02 * lasts_s < latest_s <= 1.1 * lasts_s:
            return unit, "log"
        if first_s < latest_s <= last_s + 0.1 * lasts_s:
            return unit, "clock"

    return named or "s", "log"


def read_events(
    source: Path, rules: EventRules | None, log: Path
) -> tuple[Path, list[Event]]:
    """(the file of a log's events, they, in the unit of the rules); none without such a file.

    Raises ColumnError, NotANumber or LabelError.
    """
    if rules is None or not rules.file:
        return Path(), []
    root = source if source.is_dir() else source.parent
    path = root / rules.file
    if "{name}" in rules.file:
        path = log.parent / rules.file.replace("{name}", log.stem)
        if not path.is_file():
            return Path(), []

    streams = read_log(LogPlace(path, path.stem, path.suffix.lower())).streams
    with_start = [one for one in streams if rules.start in one.columns]
    columns = (with_start or streams)[0].columns
    needed = {rules.start, rules.end, rules.label, rules.trial} - {""}
    missing = sorted(needed - columns.keys())
    if missing or is_text(columns[rules.start]):
        raise ColumnError(
            f"no column {listed(missing or [rules.start])} of the events",
            where=path,
            cause=f"its columns are {listed(list(columns), most=40)}",
            next_step="correct [events] of the column map",
        )

    return path, _events(columns, rules, path)


def _events(columns: Columns, rules: EventRules, path: Path) -> list[Event]:
    starts = columns[rules.start].astype(np.float64)
    ends = (
        columns[rules.end].astype(np.float64)
        if rules.end
        else np.full(len(starts), np.nan)
    )
    if words_of(rules.end) & {"duration", "length"}:
        ends = starts + ends
    labels = text_cells(columns[rules.label]) if rules.label else [""] * len(starts)
    trials = text_cells(columns[rules.trial]) if rules.trial else [""] * len(starts)
    rows = zip(starts.tolist(), ends.tolist(), labels, trials, strict=True)
    # a trial without an event has an empty row
    found = [Event(*row) for row in rows if np.isfinite(row[0])]
    for event in found:
        if event.end < event.start:
            raise LabelError(
                f"{event.label!r:.60} from {event.start:g} to {event.end:g} {rules.unit} "
                "is impossible",
                where=path,
                next_step="correct that line",
            )

    return with_ends(sorted(found, key=lambda event: (event.trial, event.start)))


def with_ends(events: Sequence[Event]) -> list[Event]:
    """Each event without an end lasts to the next one of its trial."""
    whole: list[Event] = []
    for event in reversed(events):
        follows = whole and whole[-1].trial == event.trial
        end = whole[-1].start if follows else FOR_EVER
        whole.append(replace(event, end=end) if np.isnan(event.end) else event)

    return whole[::-1]


def in_ns(event: Event, rules: EventRules, stamps: IntArray, zero_ns: int) -> Event:
    """An event with times on the log's clock, ns. stamps [T]: of the rows that `row` counts."""
    times = []
    for time in (event.start, event.end):
        if time >= FOR_EVER:
            times.append(FOR_EVER)
        elif rules.unit == ROW:
            row = min(max(int(time), 0), len(stamps) - 1)
            times.append(float(stamps[row]))
        else:
            times.append(zero_ns + time * NS_OF[rules.unit])

    return replace(event, start=times[0], end=times[1])
