"""What marks situations: words, columns of labels, tables of events.

Two values in a column mark the slip; English words name situations in any column; other words are
known by when they stand: while the hand is empty, and for most of a touch. A label that stands only
in the row where something begins holds until the next one.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import SITUATIONS, FloatArray, IntArray
from holdfast.core.errors import ColumnError, LabelError, NotANumber, listed
from holdfast.core.trial_layout import LABELLED_ACTIONS, UNSCRIPTED
from holdfast.interop.columns import unit_of_time, words_of
from holdfast.interop.map import EventRules
from holdfast.interop.streams import Column, Columns, is_text, text_cells
from holdfast.training.datasets.trials import action_of

ROW = "row"
ROW_WORDS = {"row", "rows", "index", "frame", "sample"}
LABEL_WORDS = {
    "label", "labels", "event", "events", "phase", "state", "situation", "marker", "markers",
    "annotation", "class", "slip", "slipping", "status", "trigger", "contact", "what",
}  # fmt: skip
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
class LabelledRows:
    """Cells [T] of a column in one log, and where something is touched [T]."""

    cells: tuple[str, ...]
    touched: np.ndarray


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
    kinds = np.unique(cells)
    changes = np.count_nonzero(np.diff(cells))
    is_few = len(kinds) <= 8 and bool((kinds == np.round(kinds)).all())
    is_named = bool(words_of(name) & LABEL_WORDS)
    return is_few and changes < 0.1 * len(cells) and (len(kinds) > 1 or is_named)


def labels_of(
    name: str, logs: Sequence[LabelledRows], known: Mapping[str, str]
) -> FoundLabels | None:
    """What a column of labels means; None for one that marks nothing.

    known: label -> situation, as given.
    """
    cells = [cell for log in logs for cell in log.cells]
    counts = Counter(cells)
    values = [value for value in counts if value]
    is_named = bool(words_of(name) & LABEL_WORDS)
    if not values or len(values) > MOST_LABELS:
        return None
    by_word = {value: known.get(value, situation_of_word(value)) for value in values}
    if len(counts) <= 2 and not all(by_word.values()):
        return _binary(name, logs, counts, is_named=is_named)
    hold = bool(counts[""] > 0.5 * len(cells))
    n_known = sum(value is not None for value in by_word.values())
    if n_known:
        labels = {value: situation or "" for value, situation in by_word.items()}
        lost = [value for value, situation in by_word.items() if situation is None]
        why = f"column {name}, {_shown(labels)}"
        why += f"; without a meaning: {listed(lost, most=6)}" if lost else ""
        return FoundLabels(_rules(name, labels, hold=hold), why)
    if not (is_named or len(values) <= 8) or len(values) < 2:
        return None
    return _by_content(name, logs, values, hold=hold)


def _binary(
    name: str, logs: Sequence[LabelledRows], counts: Counter[str], *, is_named: bool
) -> FoundLabels | None:
    """Two values: the one in which trials begin, and the one that marks the slip."""
    off = Counter(log.cells[0] for log in logs).most_common(1)[0][0]
    on = next((value for value in counts if value != off), "1")
    marked = np.concatenate([np.array(log.cells) == on for log in logs])
    touched = np.concatenate([log.touched for log in logs])
    inside = float(touched[marked].mean()) if marked.any() else 1.0
    covers = float(marked[touched].mean()) if touched.any() else 0.0
    is_slip = bool(re.search("(?i)slip", name))
    if not (is_named or inside > 0.9) or (not marked.any() and not is_slip):
        return None
    if covers > 0.8 and not is_slip:
        labels = {on: "grasp", **({off: "nothing"} if off else {})}
        return FoundLabels(
            _rules(name, labels), f"column {name}, {on!r} marks the contact"
        )
    begins = np.count_nonzero(np.diff(marked.astype(np.int8), prepend=0) == 1)
    is_moment = bool(marked.any() and marked.sum() <= 2 * begins)
    labels = {on: "risky_slip", **({off: ""} if off and not is_moment else {})}
    rules = EventRules(column=name, hold=is_moment, rest="grasp", labels=labels)
    ends = ", from there to the end of the contact" if is_moment else ""
    return FoundLabels(rules, f"column {name}, {on!r} marks the slip{ends}")


def _by_content(
    name: str, logs: Sequence[LabelledRows], values: Sequence[str], *, hold: bool
) -> FoundLabels | None:
    """Words or numbers that say nothing, by when they stand."""
    cells = np.array(
        [cell for log in logs for cell in (held(log.cells) if hold else log.cells)]
    )
    touched = np.concatenate([log.touched for log in logs])
    shares = {value: float(touched[cells == value].mean()) for value in values}
    rows = {
        value: int(np.count_nonzero(touched & (cells == value))) for value in values
    }
    first = Counter(next(filter(None, log.cells), "") for log in logs).most_common(1)[
        0
    ][0]
    grasp = max(rows, key=lambda value: rows[value])
    if first == grasp or shares.get(first, 1.0) > 0.5 or shares[grasp] < 0.5:
        return None
    empty = [value for value in values if shares[value] < 0.3]
    labels = {**dict.fromkeys(empty, "nothing"), grasp: "grasp"}
    unknown = tuple(value for value in values if value not in labels)
    why = f"column {name}, {_shown(labels)}, by when they stand"
    return FoundLabels(_rules(name, labels, hold=hold), why, unknown)


def _rules(name: str, labels: dict[str, str], *, hold: bool = False) -> EventRules:
    return EventRules(column=name, hold=hold, rest=_rest(labels), labels=labels)  # type: ignore[arg-type]


def _rest(labels: Mapping[str, str]) -> str:
    """What a closed hand does where no label says it; "" where the labels say it all."""
    situations = set(labels.values())
    return "" if "grasp" in situations and "" not in situations else "grasp"


def _shown(labels: Mapping[str, str]) -> str:
    pairs = [
        f"{label} = {one}" for label, one in labels.items() if one and label != one
    ]
    plain = [label for label, one in labels.items() if label == one]
    return listed([*plain, *pairs], most=8)


def held(cells: Sequence[str]) -> list[str]:
    """Cells in which an empty one repeats the one before."""
    last, kept = "", []
    for cell in cells:
        last = cell or last
        kept.append(last)
    return kept


# -- tables of events


def rules_of_table(
    columns: Columns, keys: Collection[str], about: str, known: Mapping[str, str]
) -> EventRules | None:
    """What the columns of a table of events are; None where it has no start or no label.

    keys: what logs are called. about: the name of the file. Its unit and zero come later.
    """
    plain = {key.casefold() for key in keys}
    trial = ""
    for name, column in columns.items():
        cells = {cell.casefold() for cell in text_cells(column) if cell}
        is_named = bool(
            words_of(name) & {"trial", "file", "log", "run", "recording", "episode"}
        )
        fits = len(cells & plain) > len(cells) / 2
        if (
            cells
            and not trial
            and (fits if is_text(column) else is_named and cells <= plain)
        ):
            trial = name
    numbers = [
        name for name, one in columns.items() if not is_text(one) and name != trial
    ]
    texts = [name for name, one in columns.items() if is_text(one) and name != trial]
    start = _named(numbers, START_WORDS | ROW_WORDS) or next(iter(numbers), None)
    if start is None:
        return None
    later = [name for name in numbers if name != start]
    end = _named(later, END_WORDS) or next(
        (name for name in later if _is_after(columns[name], columns[start])), ""
    )
    label = _named(texts, LABEL_WORDS) or next(iter(texts), "")
    situation = situation_of_word(about) or situation_of_word(start) or ""
    if not label and not situation:
        return None
    labels = {}
    if label:
        for cell in dict.fromkeys(text_cells(columns[label])):
            labels[cell] = known.get(cell, situation_of_word(cell)) or ""
    labels.pop("", None)
    if len(labels) > MOST_LABELS or (
        label and not situation and not any(labels.values())
    ):
        return None
    return EventRules(
        file=about,
        trial=trial,
        start=start,
        end=end,
        label=label,
        situation="" if label else situation,  # type: ignore[arg-type]
        rest=_rest(labels),  # type: ignore[arg-type]
        labels=labels,  # type: ignore[arg-type]
    )


def _named(names: Sequence[str], words: set[str]) -> str | None:
    return next((name for name in names if words_of(name) & words), None)


def _is_after(end: Column, start: Column) -> bool:
    both = np.isfinite(end) & np.isfinite(start)
    return bool(both.any() and (end[both] >= start[both]).all())


def unit_and_zero(
    rules: EventRules, columns: Columns, first_s: float, last_s: float
) -> tuple[str, str]:
    """The unit of a table's times, and whether they count from a log's begin or on its clock."""
    if words_of(rules.start) & ROW_WORDS:
        return ROW, "log"
    latest = float(np.nanmax(columns[rules.start].astype(np.float64)))
    lasts_s = last_s - first_s
    named = unit_of_time(rules.start)
    for unit in (named,) if named else NS_OF:
        latest_s = latest * NS_OF[unit] * 1e-9
        if 0.02 * lasts_s < latest_s <= 1.1 * lasts_s:
            return unit, "log"
        if first_s < latest_s <= last_s + 0.1 * lasts_s:
            return unit, "clock"
    return named or "s", "log"


def events_of_table(columns: Columns, rules: EventRules, path: Path) -> list[Event]:
    """The events of a table by its rules, in its unit. Raises ColumnError, NotANumber, LabelError."""
    names = [rules.start, rules.end, rules.label, rules.trial]
    missing = [name for name in names if name and name not in columns]
    if missing:
        raise ColumnError(
            f"no column {listed(missing)} (events)",
            where=path,
            cause=f"its columns are {listed(list(columns), most=40)}",
            next_step="correct [events] of the column map",
        )
    starts = _times(columns, rules.start, path)
    ends = np.full(len(starts), np.nan)
    if rules.end:
        ends = _times(columns, rules.end, path)
        if words_of(rules.end) & {"duration", "length"}:
            ends = starts + ends
    blank = [""] * len(starts)
    labels = text_cells(columns[rules.label]) if rules.label else blank
    trials = text_cells(columns[rules.trial]) if rules.trial else blank
    found = []
    for start, end, label, trial in zip(
        starts.tolist(), ends.tolist(), labels, trials, strict=True
    ):
        if end < start or (rules.unit == ROW and start < 0):
            raise LabelError(
                f"the event {label!r:.60} from {start:g} to {end:g} {rules.unit} is impossible",
                where=path,
                next_step="correct that line, or events.unit of the column map",
            )
        # a trial without an event has an empty row
        if start == start:
            found.append(Event(start, end, label, trial))
    return with_ends(sorted(found, key=lambda event: (event.trial, event.start)))


def _times(columns: Columns, name: str, path: Path) -> FloatArray:
    if is_text(columns[name]):
        raise NotANumber(
            f"column {name} holds no times",
            where=path,
            next_step="write numbers, in events.unit of the column map",
        )
    return columns[name].astype(np.float64)


def with_ends(events: Sequence[Event]) -> list[Event]:
    """Each event without an end lasts to the next one of its trial."""
    whole: list[Event] = []
    later: Event | None = None
    for event in reversed(events):
        end = event.end
        if np.isnan(end):
            follows = later is not None and later.trial == event.trial
            end = later.start if later and follows else FOR_EVER
        whole.append(Event(event.start, end, event.label, event.trial))
        later = event
    return whole[::-1]


def in_ns(event: Event, rules: EventRules, stamps: IntArray, zero_ns: int) -> Event:
    """An event with times on the log's clock, ns. stamps [T]: of the rows that `row` counts."""
    times = []
    for time in (event.start, event.end):
        if time >= FOR_EVER:
            times.append(FOR_EVER)
        elif rules.unit == ROW:
            row = int(time)
            times.append(float(stamps[row] if row < len(stamps) else stamps[-1] + 1))
        else:
            times.append(zero_ns + time * NS_OF[rules.unit])
    return Event(times[0], times[1], event.label, event.trial)


def events_of_cells(cells: Sequence[str], stamps: IntArray) -> list[Event]:
    """Runs of equal cells [T] as events, ns."""
    starts = [k for k, cell in enumerate(cells) if not k or cell != cells[k - 1]]
    events = [Event(float(stamps[k]), np.nan, cells[k]) for k in starts]
    return with_ends(events)
