"""What marks situations: words, columns of labels, tables of events.

Two values in a column mark the slip; English words name situations in any column; other words are
known by when they stand: while the hand is empty, and for most of a touch. A label that stands only
in the row where something begins holds until the next one. Whatever marks it, the events of a trial
are one table: `start` and `end`, and the `label` that lasts from one to the other.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import replace as changed

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import FloatArray, IntArray
from holdfast.core.errors import LabelError, listed
from holdfast.core.trial_layout import LABELLED_ACTIONS, UNSCRIPTED
from holdfast.data.datasets.trials import action_of
from holdfast.interop.columns import unit_of_time, words_of
from holdfast.interop.logs import LogPlace, read_log
from holdfast.interop.map import EventRules, ImportMap
from holdfast.interop.streams import Column, Columns, is_text, text_cells
from holdfast.interop.tables import pd

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
SITUATION_WORDS = {
    r"unlabel|unknown|none|ignore": "",
    r"nothing|no contact|open|empty|idle|rest|free|no touch": "nothing",
    r"no slip|noslip|non slip|not slip|stable|still|static|steady": "grasp",
    r"safe|release|hand ?over|put down|place": "safe_slip",
    r"risky|slip|slid|drop|fall|fell|fail|lost|tug|pull|torn": "risky_slip",
    r"grasp|hold|held|grip|contact|lift|carry|touch|success": "grasp",
}
"""Beginnings of words in labels -> what they mean; the first that fits counts."""
ENDS = {"end", "stop", "finish", "off", "offset"}
OFF = {"", "0", "no", "false", "off", "n", "f", ".", "-", "none", "nein", "non"}
"""What stands where a mark is not."""
MOST_CODE = 1000
"""Numbers that mark a situation are smaller; those of a clock are not."""
ACTION_OF_SITUATION = {
    "grasp": "hold",
    "risky_slip": "slip",
    "safe_slip": "pass",
    "nothing": "nothing",
}
MOST_LABELS = 40
EVENT = {"start": np.nan, "end": np.nan, "label": "", "trial": ""}
"""The columns of a table of events, and what stands in a column that a table has not."""
NO_EVENTS = pd.DataFrame(columns=[*EVENT], dtype=object)


def situation_of_word(label: str) -> str | None:
    """The situation that a label means by its words, "" for none; None where they say nothing."""
    parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", label).lower()
    words = re.findall(r"[a-z]+", parted)
    if len(words) > 1 and ENDS & {words[0], words[-1]}:
        return ""
    for beginnings, situation in SITUATION_WORDS.items():
        if re.search(rf"\b({beginnings})", " ".join(words)):
            return situation

    return None


def action_of_word(word: str, *, has_events: bool = False) -> str | None:
    """The action that a word means; None where it says nothing.

    has_events: else an action that needs its phases is only a slip or a hold.
    """
    known = action_of(word)
    if known and (has_events or known not in UNSCRIPTED or known in LABELLED_ACTIONS):
        return known
    return ACTION_OF_SITUATION.get(situation_of_word(word) or "")


# -- what a column of labels means


@dataclass(frozen=True)
class FoundLabels:
    """Rules, and the labels whose situation nothing says.

    is_contact: whether only a touch is marked, by no word, so that a slip would not be.
    """

    rules: EventRules
    unknown: Sequence[str] = ()
    is_contact: bool = False

    @property
    def text(self) -> str:
        """What the labels of a column mean."""
        labels = self.rules.labels.items()
        shown = [f"{label} = {meaning or 'none'}" for label, meaning in labels]
        holds = "; each holds to the next, or to the end of the contact"
        return listed(shown, most=8) + (holds if self.rules.hold else "")


def is_mark(name: str, column: Column) -> bool:
    """Whether a column can hold labels: texts, or few whole numbers that seldom change."""
    if is_text(column):
        return len(pd.unique(column)) <= MOST_LABELS
    cells = column[np.isfinite(column)]
    if (cells % 1 != 0).any() or (np.abs(cells) >= MOST_CODE).any():
        return False
    kinds = len(pd.unique(cells))
    is_named = bool(words_of(name) & LABEL_WORDS)
    seldom = np.count_nonzero(np.diff(cells)) < 0.1 * len(column)
    return bool(seldom) and (1 < kinds <= 8 or (kinds == 1 and is_named))


def labels_of(
    name: str, cells: np.ndarray, touched: np.ndarray, known: Mapping[str, str]
) -> FoundLabels | None:
    """What a column of labels means; None for one that marks nothing.

    cells, touched [T]: of all logs, one after the other; touched: whether the hand touches
    something. known: label -> situation, as given; else a label means what its words say, else what
    it is by when it stands.
    """
    kinds = [*dict.fromkeys(cells.tolist())]
    if len(kinds) > MOST_LABELS:
        return None
    words = _by_words(kinds, known)
    # a label in a row or two lasts on; the value of most rows says that nothing begins there
    usual = _usual(cells)
    on = cells != usual
    hold = not words.get(usual) and bool(0 < on.sum() <= 2 * _begins(on).sum())
    content = _by_content(held(np.where(on, cells, "")) if hold else cells, touched)
    is_two = len(kinds) <= 2 and not all(map(words.get, kinds))
    if is_two and (not content or "slip" in name.lower()):
        content = _of_two(name, cells, kinds, touched)
    labels = content | words
    labels.pop(usual if hold else "", None)
    if not any(labels.values()):
        return None
    unknown = {*kinds} - {"", usual if hold else "", *labels}
    if any(words.values()):
        # words that say nothing are none of the situations
        labels |= dict.fromkeys(sorted(unknown), "")
        unknown = set()
    rules = EventRules(column=name, hold=hold, labels=labels)  # type: ignore[arg-type]
    is_contact = not (words or unknown) and {*labels.values()} == {"nothing", "grasp"}
    return FoundLabels(rules, sorted(unknown, key=kinds.index), is_contact)


def _by_words(kinds: Iterable[str], known: Mapping[str, str]) -> dict[str, str]:
    """Label -> situation, "" for none, as given or by its words; none where they say nothing."""
    meanings = {}
    for kind in kinds:
        meaning = known.get(kind, situation_of_word(kind))
        if meaning is not None:
            meanings[kind] = meaning
    return meanings


def _usual(cells: np.ndarray) -> str:
    """The value of most rows."""
    return str(Counter(cells.tolist()).most_common(1)[0][0])


def _begins(on: np.ndarray) -> np.ndarray:
    """[T] the first rows of runs in which something is on."""
    return on & ~np.append(False, on[:-1])


def _of_two(
    name: str, cells: np.ndarray, kinds: Sequence[str], touched: np.ndarray
) -> dict[str, str]:
    """Label -> situation of two values: the one that says no, or begins, and the one of a slip.

    A mark without a name that says so begins within a touch, as a slip does.
    """
    off = next((kind for kind in kinds if kind.lower() in OFF), kinds[0])
    on = next((kind for kind in kinds if kind != off), "1")
    begins = _begins(cells == on)
    is_named = bool(words_of(name) & LABEL_WORDS)
    is_mark = begins.any() and (is_named or touched[begins].mean() > 0.9)
    return {off: "", on: "risky_slip"} if is_mark or "slip" in name.lower() else {}


def _by_content(cells: np.ndarray, touched: np.ndarray) -> dict[str, str]:
    """Label -> situation by when it stands; none where that says nothing.

    Those that stand while nothing is touched mean the empty hand, and the most frequent one of a
    touch means the grasp. A slip cannot be seen so.
    """
    shares = (
        pd.Series(touched).groupby(cells, sort=False).mean().drop("", errors="ignore")
    )
    empty = shares.index[shares < 0.3].tolist()
    grasp = pd.Series(cells[touched]).value_counts().idxmax() if touched.any() else ""
    is_clear = shares.index[:1].isin(empty).any() and shares.get(grasp, 0.0) > 0.5
    if not is_clear or len(shares) > 8:
        return {}
    return {**dict.fromkeys(empty, "nothing"), grasp: "grasp"}


# -- what a table of events means


def rules_of_table(
    columns: Columns, keys: set[str], file: str, known: Mapping[str, str]
) -> FoundLabels | None:
    """What the columns of a table of events are; None where it has no start or no label.

    A row is an event: when it starts, when it ends or how long it lasts, what it is, and which
    trial it is of. A table without labels is of one kind, by the name of the column or the file.
    keys: what logs are called, in small letters. Unit and zero come later.
    """
    trial = next((name for name in columns if _are_trials(name, columns, keys)), "")
    names = [name for name in columns if name != trial]
    numbers = [name for name in names if not is_text(columns[name])]
    start = _named(numbers, START_WORDS | ROW_WORDS)
    label = _named([name for name in names if name not in numbers], LABEL_WORDS)
    if not start or set(columns[start]) <= {0, 1}:
        return None
    ends = []
    for name in numbers:
        is_after = (columns[name] >= columns[start]).all() or words_of(name) & END_WORDS
        ends += [name] if is_after and name != start else []
    kinds = [*filter(None, text_cells(columns[label]))] if label else []
    about = situation_of_word(start) or situation_of_word(Path(file).stem) or ""
    words = _by_words(kinds, known) if label else {"": about}
    unknown = [kind for kind in dict.fromkeys(kinds) if kind not in words]
    labels = words | dict.fromkeys(unknown, "")
    is_known = any(words.values())
    # words that say nothing are labels where an end and a trial stand beside them
    if len(labels) > MOST_LABELS or not (is_known or (unknown and ends and trial)):
        return None
    rules = EventRules(
        file=file,
        trial=trial,
        start=start,
        end=_named(ends, END_WORDS),
        label=label,
        labels=labels,  # type: ignore[arg-type]
    )
    return FoundLabels(rules, [] if is_known else unknown)


def _are_trials(name: str, columns: Columns, keys: set[str]) -> bool:
    """Whether cells are what logs are called by; numbers are so only by the column's name."""
    found = keys & {*map(str.casefold, text_cells(columns[name]))}
    if words_of(name) & TRIAL_WORDS:
        return bool(found)
    return is_text(columns[name]) and len(found) > 1


def _named(names: Sequence[str], words: set[str]) -> str:
    """The first name with one of the words, else the first one; "" for none."""
    return next((name for name in names if words_of(name) & words), "".join(names[:1]))


def timed(rules: EventRules, columns: Columns, stamps_s: FloatArray) -> EventRules:
    """The rules of a table with the unit of its times, and whether they count from a log's begin.

    stamps_s [T]: of the log. The first unit counts with which the last event lies within it.
    """
    if words_of(rules.start) & ROW_WORDS:
        return changed(rules, unit=ROW)
    latest = np.nanmax(columns[rules.start].astype(np.float64))
    lasts_s = stamps_s[-1] - stamps_s[0]
    named = unit_of_time(rules.start)
    for unit in (named,) if named else NS_OF:
        latest_s = latest * NS_OF[unit] * 1e-9
        if 0.02 * lasts_s < latest_s <= 1.1 * lasts_s:
            return changed(rules, unit=unit)
        if stamps_s[0] < latest_s <= stamps_s[-1] + 0.1 * lasts_s:
            return changed(rules, unit=unit, zero="clock")

    return changed(rules, unit=named or "s")


# -- the events of a trial


def read_events(source: Path, plan: ImportMap, log: Path) -> tuple[Path, pd.DataFrame]:
    """(the file of a log's events, they, in the unit of the rules); none without such a file.

    The table has the columns of EVENT. Raises ColumnError or LabelError.
    """
    rules = plan.events or EventRules(column="-")
    of_log = "{name}" in rules.file
    root = log.parent if of_log else source if source.is_dir() else source.parent
    path = root / rules.file.replace("{name}", log.stem)
    if not rules.file or (of_log and not path.is_file()):
        return Path(), NO_EVENTS
    streams = read_log(LogPlace(path, path.stem, path.suffix.lower())).streams
    columns = max(streams, key=lambda one: rules.start in one.columns).columns
    names = {key: getattr(rules, key) for key in EVENT}
    plan.require_columns(columns, path, {*names.values()} - {""})
    events = pd.DataFrame(
        {key: columns.get(name, EVENT[key]) for key, name in names.items()}
    )
    for key in ("label", "trial"):
        events[key] = text_cells(events[key].to_numpy())
    times = events[["start", "end"]].apply(pd.to_numeric, errors="coerce")
    if words_of(rules.end) & LENGTH_WORDS:
        times["end"] += times["start"]
    # a point has no end
    times["end"] = times["end"].where(times["end"] != times["start"])
    # a trial without an event has an empty row
    events = events.assign(**times).dropna(subset="start")
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
    usual = _usual(cells)
    is_off = (cells == usual) & (usual not in rules.labels)
    return held(np.where(is_off, "", cells))


def held(cells: np.ndarray) -> np.ndarray:
    """Cells [T] in which an empty one repeats the one before."""
    begins = np.where(cells != "", np.arange(len(cells)), 0)
    return cells[np.maximum.accumulate(begins)]
