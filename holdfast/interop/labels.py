"""What marks situations: words, columns of labels, tables of events.

Two values in a column mark the slip; English words name situations in any column; other words are
known by when they stand: while the hand is empty, and for most of a touch. A label that stands only
in the row where something begins holds until the next one. Whatever marks it, the events of a trial
are one table: `start` and `end`, and the `label` that lasts from one to the other.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import IntArray
from holdfast.core.errors import LabelError, listed
from holdfast.core.trial_layout import LABELLED_ACTIONS, UNSCRIPTED
from holdfast.interop.columns import unit_of_time, words_of
from holdfast.interop.logs import LogPlace, read_log
from holdfast.interop.map import EventRules, ImportMap
from holdfast.interop.streams import Column, Columns, is_text, text_cells
from holdfast.interop.tables import pd
from holdfast.training.datasets.trials import action_of

ROW = "row"
ROW_WORDS = {"row", "rows", "index", "frame", "sample"}
LABEL_WORDS = {
    "label", "labels", "event", "events", "phase", "state", "situation", "marker", "markers",
    "annotation", "class", "slip", "slipping", "status", "trigger", "contact", "what",
}  # fmt: skip
TRIAL_WORDS = {"trial", "file", "log", "run", "recording", "episode", "name"}
START_WORDS = {"start", "begin", "from", "onset", "t0", "time", "at"}
LENGTH_WORDS = {"duration", "length"}
END_WORDS = {"end", "stop", "to", "until", "offset", "finish", "t1"} | LENGTH_WORDS
SITUATION_WORDS = (
    ("", r"unlabel|unknown|none|ignore"),
    ("nothing", r"nothing|no contact|open|empty|idle|rest|free|no touch"),
    ("grasp", r"no slip|noslip|non slip|not slip|stable|still|static|steady"),
    ("safe_slip", r"safe|release|hand ?over|put down|place"),
    ("risky_slip", r"slip|slid|drop|fall|fell|fail|lost|tug|pull|torn"),
    ("grasp", r"grasp|hold|held|grip|contact|lift|carry|touch"),
)
"""Beginnings of words in labels, the first that fits counts."""
ENDS = {"end", "stop", "finish", "off"}
ACTION_OF_SITUATION = {
    "grasp": "hold",
    "risky_slip": "slip",
    "safe_slip": "pass",
    "nothing": "nothing",
}
NEED_EVENTS = tuple(name for name in UNSCRIPTED if name not in LABELLED_ACTIONS)
"""Actions that follow no script: what happens when is known by events alone."""
MOST_LABELS = 40
NO_EVENTS = pd.DataFrame(columns=["start", "end", "label", "trial"], dtype=object)


def situation_of_word(label: str) -> str | None:
    """The situation that a label means by its words, "" for none; None where they say nothing."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", label).lower()
    words = re.findall(r"[a-z]+", parted)
    if len(words) > 1 and ENDS & {words[0], words[-1]}:
        return ""
    for situation, beginnings in SITUATION_WORDS:
        if re.search(rf"\b({beginnings})", " ".join(words)):
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


# -- what a column of labels means


@dataclass(frozen=True)
class FoundLabels:
    """Rules, what was understood in words, and labels whose situation nothing says."""

    rules: EventRules
    why: str
    unknown: tuple[str, ...] = ()


def is_mark(name: str, column: Column) -> bool:
    """Whether a column can hold labels: texts, or few whole numbers that seldom change."""
    if is_text(column):
        return len(pd.unique(column)) <= MOST_LABELS
    cells = column[np.isfinite(column)]
    if (cells % 1 != 0).any():
        return False
    kinds = len(pd.unique(cells))
    is_named = bool(words_of(name) & LABEL_WORDS)
    seldom = np.count_nonzero(np.diff(cells)) < 0.1 * len(cells)
    return bool(seldom) and (1 < kinds <= 8 or (kinds == 1 and is_named))


def labels_of(
    name: str, cells: np.ndarray, touched: np.ndarray, known: Mapping[str, str]
) -> FoundLabels | None:
    """What a column of labels means; None for one that marks nothing.

    cells, touched [T]: of all logs, one after the other; touched: whether the hand touches
    something. known: label -> situation, as given.
    """
    values = list(dict.fromkeys(cells.tolist()))
    meanings = {}
    for value in filter(None, values):
        meanings[value] = known.get(value, situation_of_word(value))
    if not meanings or len(values) > MOST_LABELS:
        return None
    if len(values) <= 2 and not all(meanings.values()):
        return _of_two(name, cells, touched)
    hold = bool(np.mean(cells == "") > 0.5)
    lost = [value for value, meaning in meanings.items() if meaning is None]
    if len(lost) < len(meanings):
        labels = {value: meaning or "" for value, meaning in meanings.items()}
        why = f"; without a meaning: {listed(lost, most=6)}" if lost else ""
        return _found(name, labels, why, hold=hold)
    return _by_content(name, held(cells) if hold else cells, touched, lost, hold=hold)


def _of_two(name: str, cells: np.ndarray, touched: np.ndarray) -> FoundLabels | None:
    """Two values: the one in which logs begin, and the one that marks the slip."""
    off = cells[0]
    on = next((value for value in cells.tolist() if value != off), "1")
    marked = cells == on
    if not re.search("(?i)slip", name):
        is_inside = marked.any() and touched[marked].mean() > 0.9
        is_named = marked.any() and words_of(name) & LABEL_WORDS
        contact = _by_content(name, cells, touched, [off, on])
        if contact or not (is_inside or is_named):
            return contact

    begins = np.count_nonzero(np.diff(marked.astype(np.int8)) == 1)
    if 0 < marked.sum() <= 2 * begins:
        why = f": {on!r} marks the slip, from there to the end of the contact"
        return _found(name, {on: "risky_slip"}, why, hold=True)
    return _found(name, {on: "risky_slip", off: ""}, f": {on!r} marks the slip")


def _by_content(
    name: str,
    cells: np.ndarray,
    touched: np.ndarray,
    values: Sequence[str],
    *,
    hold: bool = False,
) -> FoundLabels | None:
    """Words or numbers that say nothing, by when they stand.

    Those that stand while nothing is touched mean the empty hand, and the most frequent one of a
    touch means the grasp. What is left is listed as unknown, because a slip cannot be seen so.
    """
    shares = pd.Series(touched).groupby(cells).mean().reindex(values)
    empty = shares.index[shares < 0.3].tolist()
    grasp = pd.Series(cells[touched]).value_counts().idxmax() if touched.any() else ""
    if values[0] not in empty or not shares.get(grasp, 0.0) > 0.5 or len(values) > 8:
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
    shown = []
    for label, situation in labels.items():
        if situation:
            shown.append(label if label == situation else f"{label} = {situation}")
    rules = EventRules(column=name, hold=hold, labels=labels)  # type: ignore[arg-type]
    return FoundLabels(rules, f"column {name}, {listed(shown, most=8)}{why}", unknown)


# -- what a table of events means


def rules_of_table(
    columns: Columns, keys: set[str], file: str, known: Mapping[str, str]
) -> EventRules | None:
    """What the columns of a table of events are; None where it has no start or no label.

    A row is an event: when it starts, when it ends or how long it lasts, what it is, and which
    trial it is of. A table without labels is of one kind, by the name of the column or the file.
    keys: what logs are called, in small letters. Unit and zero come later.
    """
    trials = [name for name in columns if _names_trials(name, columns[name], keys)]
    rest = {name: columns[name] for name in columns if name not in trials[:1]}
    texts = [name for name, column in rest.items() if is_text(column)]
    numbers = [name for name in rest if name not in texts]
    start = _named(numbers, START_WORDS | ROW_WORDS)
    label = _named(texts, LABEL_WORDS)
    about = situation_of_word(start) or situation_of_word(Path(file).stem)
    if not start or not (label or about):
        return None
    numbers.remove(start)
    after = [name for name in numbers if (rest[name] >= rest[start]).all()]
    ends = [name for name in numbers if words_of(name) & END_WORDS]
    labels = {} if label else {"": about or ""}
    for cell in filter(None, text_cells(rest[label]) if label else []):
        labels[cell] = known.get(cell) or situation_of_word(cell) or ""
    if len(labels) > MOST_LABELS or not any(labels.values()):
        return None
    return EventRules(
        file=file,
        trial="".join(trials[:1]),
        start=start,
        end=next(iter([*ends, *after]), ""),
        label=label,
        labels=labels,  # type: ignore[arg-type]
    )


def _names_trials(name: str, column: Column, keys: set[str]) -> bool:
    """Whether cells are what logs are called by; numbers are so only by the column's name."""
    cells = {*map(str.casefold, text_cells(column))} - {""}
    if words_of(name) & TRIAL_WORDS or not is_text(column):
        return bool(cells) and cells <= keys and bool(words_of(name) & TRIAL_WORDS)
    return len(cells & keys) > 1


def _named(names: Sequence[str], words: set[str]) -> str:
    """The first name with one of the words, else the first one; "" for none."""
    return next((name for name in names if words_of(name) & words), "".join(names[:1]))


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


# -- the events of a trial


def read_events(source: Path, plan: ImportMap, log: Path) -> tuple[Path, pd.DataFrame]:
    """(the file of a log's events, they, in the unit of the rules); none without such a file.

    The table has `start`, `end`, `label` and `trial`. Raises ColumnError or LabelError.
    """
    rules = plan.events
    if rules is None or not rules.file:
        return Path(), NO_EVENTS
    of_log = "{name}" in rules.file
    root = source if source.is_dir() else source.parent
    path = (log.parent if of_log else root) / rules.file.replace("{name}", log.stem)
    if of_log and not path.is_file():
        return Path(), NO_EVENTS
    streams = read_log(LogPlace(path, path.stem, path.suffix.lower())).streams
    columns = max(streams, key=lambda one: rules.start in one.columns).columns
    needed = {rules.start, rules.end, rules.label, rules.trial} - {""}
    plan.require_columns(columns, path, needed)
    events = pd.DataFrame({"start": columns[rules.start]})
    events["end"] = columns.get(rules.end, np.nan)
    events = events.apply(pd.to_numeric, errors="coerce")
    if words_of(rules.end) & LENGTH_WORDS:
        events["end"] += events["start"]
    events["label"] = text_cells(columns[rules.label]) if rules.label else ""
    events["trial"] = text_cells(columns[rules.trial]) if rules.trial else ""
    # a trial without an event has an empty row
    events = events.dropna(subset="start")
    # what lasts shorter lies within what lasts longer
    order = {"trial": True, "start": True, "end": False}
    events = events.sort_values([*order], ascending=[*order.values()])
    for _, event in events[events["end"] < events["start"]].iterrows():
        raise LabelError(
            f"{event['label']!r:.60} from {event['start']:g} to {event['end']:g} "
            f"{rules.unit} is impossible",
            where=path,
            next_step="correct that line",
        )

    # an event without an end lasts to the next one of its trial
    following = events.groupby("trial")["start"].shift(-1)
    return path, events.fillna({"end": following}).fillna({"end": np.inf})


def clock_of(rules: EventRules, stamps: IntArray) -> np.ndarray:
    """[T] the time of a trial's rows as its table of events has it. stamps [T]: ns."""
    if rules.unit == ROW:
        return np.arange(len(stamps))
    zero_ns = 0 if rules.zero == "clock" else stamps[0]
    # as exact as an event is written
    return np.round((stamps - zero_ns) / NS_OF[rules.unit], 6)


def marks_of(cells: np.ndarray, rules: EventRules) -> np.ndarray:
    """A column of labels [T]; one that stands only where something begins lasts to the next."""
    if not rules.hold:
        return cells
    # the value of most rows says that nothing begins there
    usual, _ = Counter(cells.tolist()).most_common(1)[0]
    is_off = (cells == usual) & (usual not in rules.labels)
    return held(np.where(is_off, "", cells))


def held(cells: np.ndarray) -> np.ndarray:
    """Cells [T] in which an empty one repeats the one before."""
    begins = np.where(cells != "", np.arange(len(cells)), 0)
    return cells[np.maximum.accumulate(begins)]
