"""The tables of a proposed map that say how logs become trials: path, split, events, facts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holdfast.core.column_map import NS_OF, SensorColumns, TimeColumn
from holdfast.core.contract import SITUATIONS, Json
from holdfast.core.errors import count_of, listed
from holdfast.core.trial_layout import LABELLED_ACTIONS, UNSCRIPTED
from holdfast.interop.column_names import longest_stream, unit_of_time, words_of
from holdfast.interop.events import is_event_table
from holdfast.interop.import_map import ROW, path_pattern
from holdfast.interop.logs.find import LogPlace
from holdfast.interop.logs.log import (
    LOG_TIME,
    Column,
    Columns,
    ForeignLog,
    is_text,
    text_cells,
)
from holdfast.training.datasets.trials import action_of

WORDS = {
    "trial": {"trial", "run", "episode", "recording", "rep", "repetition", "take"}
    | {"datei", "versuch", "durchgang", "fichier", "essai", "archivo", "ensayo"},
    "person": {"person", "subject", "participant", "subj", "sub", "proband", "user"}
    | {"teilnehmer", "sujet", "sujeto", "participante"},
    "object": {"object", "item", "obj", "objekt", "gegenstand", "objet", "objeto"},
    "action": {"action", "condition", "task", "label", "class", "aktion", "tarea"},
    "start": {
        "start",
        "begin",
        "from",
        "onset",
        "t0",
        "time",
        "beginn",
        "von",
        "anfang",
    }
    | {"d\u00e9but", "debut", "inicio", "desde"},
    "end": {"end", "stop", "to", "until", "offset", "finish", "ende", "bis"}
    | {"fin", "hasta"},
    "label": {"label", "event", "what", "phase", "state", "situation", "type", "marker"}
    | {"annotation", "description", "name", "data", "class", "labels", "events"}
    | {"markers", "states", "phases", "was", "ereignis", "zustand"}
    | {"\u00e9v\u00e9nement", "evenement", "\u00e9tat", "evento", "estado"},
    ROW: {"row", "rows", "index", "frame", "sample"},
}
PERSON = re.compile(
    r"(?i)(p|s|vp|sub|subj|subject|person|participant|proband)[-_ ]?\d+"
)
TRIAL = re.compile(r"(?i)(trial|run|rep|take|t|r|episode|recording|nr|no)?[-_ ]?\d+")
SITUATION_WORDS = (
    ("", ("unlabelled", "unknown", "none", "ignore")),
    ("nothing", ("nothing", "no contact", "open", "empty", "idle", "rest", "free")),
    ("grasp", ("no slip", "noslip", "non slip", "grasp", "hold", "held", "stable")),
    ("grasp", ("still", "static", "steady")),
    ("safe_slip", ("safe", "release", "hand over", "handover", "put down", "place")),
    ("risky_slip", ("slip", "slid", "drop", "fall", "fail", "lost", "tug", "pull")),
    ("grasp", ("grip", "contact", "lift", "carry")),
)
"""Words in labels, the first that fits counts."""
ACTION_OF_SITUATION = {
    "grasp": "hold",
    "risky_slip": "slip",
    "safe_slip": "pass",
    "nothing": "nothing",
}
NEED_EVENTS = tuple(name for name in UNSCRIPTED if name not in LABELLED_ACTIONS)
"""Actions that follow no script: what happens when is known by events alone."""
LONG_GAP_S, LONG_GAP_STEPS = 0.5, 20.0
"""A step is a gap between trials from so many seconds and so many usual steps on."""
MOST_LABELS = 40


@dataclass(frozen=True)
class Example:
    """The first log of a source, others that were read, and where all are."""

    source: Path
    log: ForeignLog
    others: Sequence[ForeignLog]
    places: Sequence[LogPlace]
    time: TimeColumn
    sensors: Sequence[SensorColumns]

    @property
    def columns(self) -> Columns:
        """All columns of the log."""
        return longest_stream(self.log)

    @property
    def taken(self) -> set[str]:
        """Columns of time and sensors."""
        axes = {name.removeprefix("-") for one in self.sensors for name in one.axes}
        return axes | {self.time.column}

    @property
    def times_s(self) -> np.ndarray:
        """[T] times on the log's clock; rows for a map without a column of time."""
        if self.time.column == LOG_TIME:
            table = self.log.table(sorted(self.taken))
            return np.asarray(table[LOG_TIME], dtype=np.float64) * 1e-9
        column = self.columns.get(self.time.column, np.zeros(0))
        return np.asarray(column, dtype=np.float64) * self.time.unit_ns * 1e-9


def situation_of_word(label: str) -> str | None:
    """The situation that a label means by its words; None where it says nothing."""
    plain = " ".join(re.findall(r"[a-z]+", label.lower()))
    if plain.replace(" ", "_") in SITUATIONS:
        return plain.replace(" ", "_")
    for situation, words in SITUATION_WORDS:
        if any(word in plain for word in words):
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


def propose_split(example: Example, reasons: list[str]) -> Json:
    """[trials] by, and the columns of names."""
    table: Json = {}
    column = _column_for("trial", example)
    cells = text_cells(example.columns[column]) if column else []
    if column and 1 < len(set(cells)) <= len(cells) // 5:
        table = {"by": "column", "column": column}
        reasons.append(f"trials: one for each value of {column}")
    else:
        gap_s = _gap_s(example)
        if gap_s is not None:
            table = {"by": "gaps", "gap_s": gap_s}
            reasons.append(f"trials: one ends where no row comes for {gap_s:g} s")
    for key in ("person", "object"):
        name = _column_for(key, example)
        if name is not None:
            table[key] = name
    return table


def _column_for(key: str, example: Example) -> str | None:
    """A column whose name has a word, and that holds names and no readings."""
    for name, column in example.columns.items():
        if name in example.taken or not words_of(name) & WORDS[key]:
            continue
        if is_text(column) or column.dtype.kind in "iu":
            return name
    return None


def _gap_s(example: Example) -> float | None:
    """How long a gap between trials is; None without gaps."""
    if example.time.rate_hz is not None:
        return None
    times_s = example.times_s
    steps = np.diff(times_s)
    if len(steps) < 2 or not np.isfinite(steps).all():
        return None
    usual_s = float(np.median(steps))
    gaps = steps[steps > max(LONG_GAP_S, LONG_GAP_STEPS * usual_s)]
    if not len(gaps):
        return None
    return float(f"{max(LONG_GAP_S, 0.5 * float(gaps.min())):.2g}")


def propose_path(places: Sequence[LogPlace], reasons: list[str]) -> Json:
    """[trials] path, where all names are built alike and say something."""
    split = [re.split(r"([/_])", place.name) for place in places]
    first = split[0]
    if any(len(one) != len(first) or one[1::2] != first[1::2] for one in split):
        return {}
    fields: dict[int, str] = {}
    tokens = [[one[k] for one in split] for k in range(0, len(first), 2)]
    for k, values in enumerate(tokens):
        if "action" not in fields.values() and all(map(action_of_word, values)):
            fields[k] = "action"
        elif "person" not in fields.values() and all(map(PERSON.fullmatch, values)):
            fields[k] = "person"
        elif k == len(tokens) - 1 and all(map(TRIAL.fullmatch, values)):
            fields[k] = "trial"
    left = [k for k in range(len(tokens)) if k not in fields and tokens[k][0]]
    if "action" in fields.values() or "person" in fields.values():
        # what is left beside a person or an action is what was held
        named = [k for k in left if not all(v.isdecimal() for v in tokens[k])][:1]
        fields |= dict.fromkeys(named, "object")
    if not set(fields.values()) - {"trial"}:
        return {}
    parts = []
    for k, values in enumerate(tokens):
        same = len(set(values)) == 1
        parts.append(f"{{{fields[k]}}}" if k in fields else values[0] if same else "*")
    separators = [*first[1::2], ""]
    path = "".join(a + b for a, b in zip(parts, separators, strict=True))
    reasons.append(f"names: {path}, by the paths of {count_of(len(places), 'log')}")
    for k, field in fields.items():
        if field == "object" and len(set(tokens[k])) > 1:
            names = listed(list(dict.fromkeys(tokens[k])), most=4)
            reasons.append(
                f"object: {names}: a guess; where they are people, write {{person}} instead, "
                "because a model is judged on people that it has not seen"
            )
    return {"path": path}


def propose_events(
    example: Example,
    tables: Sequence[ForeignLog],
    trials: Mapping[str, object],
    reasons: list[str],
) -> Json:
    """[events], from a table beside the logs or from a column of labels."""
    chosen: Json = {}
    for table in tables:
        columns = table.streams[0].columns
        found = _events_of_table(table, columns, example, trials)
        if found and not chosen:
            reasons.append(f"events: {table.path.name}, by its columns")
            chosen = found
        elif not _is_of_same_tables(table, tables, chosen):
            names = listed(list(columns), most=12)
            reasons.append(
                f"skipped: {table.path.name}, which has no sensor (columns {names}); if it holds "
                "events, write [events] file, start, end, label and trial"
            )
    if chosen:
        return chosen
    for name, column in example.columns.items():
        if name in example.taken or not words_of(name) & WORDS["label"]:
            continue
        changes = len(set(_labels(column))) > 1
        labels = _labels(column)
        for other in example.others:
            labels += _labels(longest_stream(other).get(name, np.zeros(0)))
        situations = _situations(labels)
        if changes and is_text(column) and any(situations.values()):
            reasons.append(f"events: column {name}")
            return _with_labels({"column": name}, situations, reasons)
    return {}


def _is_of_same_tables(
    table: ForeignLog, tables: Sequence[ForeignLog], chosen: Json
) -> bool:
    """Whether a table is another log's table of events, as {name} says."""
    file = str(chosen.get("file", ""))
    if "{name}" not in file:
        return False
    before, after = file.split("{name}")
    name = table.path.as_posix()
    return name.endswith(after) and Path(before).name in table.path.name


def _events_of_table(
    table: ForeignLog, columns: Columns, example: Example, trials: Mapping[str, object]
) -> Json:
    """[events] for a table; nothing where it has no start or no labels."""
    if not is_event_table(columns):
        return {}
    numbers = {name: c for name, c in columns.items() if not is_text(c)}
    texts = {name: c for name, c in columns.items() if is_text(c)}
    trial = _trial_column(columns, example, trials)
    times = [name for name in numbers if name != trial]
    start = _first_named("start", numbers)
    if start is None and trial is not None and len(times) in (1, 2):
        # a sheet whose cells name the logs, with headings in another language
        start = times[0]
    if start is None:
        return {}
    end = _first_named("end", {n: c for n, c in numbers.items() if n != start})
    if end is None and len(times) == 2 and start == times[0]:
        later = columns[times[1]].astype(np.float64) >= columns[start].astype(
            np.float64
        )
        end = times[1] if later.all() else None
    others = {name: column for name, column in texts.items() if name != trial}
    label = _first_named("label", others) or next(iter(others), None)
    if label is None:
        return {}
    root = example.source if example.source.is_dir() else example.source.parent
    found: Json = {"file": table.path.relative_to(root).as_posix()}
    named = table.path.stem.replace(example.log.path.stem, "{name}")
    if "{name}" in named:
        found["file"] = named + table.path.suffix
    if trial is not None:
        found["trial"] = trial
    found["start"] = start
    if end is not None:
        found["end"] = end
    found["label"] = label
    latest = float(np.nanmax(columns[end or start].astype(np.float64)))
    found |= _time_of_events(start, latest, example)
    if found.get("zero") is None and trials.get("by") == "column" and trial is not None:
        found["zero"] = "trial"
    return _with_labels(found, _situations(_labels(columns[label])), [])


def _trial_column(
    columns: Columns, example: Example, trials: Mapping[str, object]
) -> str | None:
    """The column whose cells name logs, or values of the column of trials."""
    names = {place.name.casefold() for place in example.places}
    names |= {place.path.name.casefold() for place in example.places}
    names |= {place.path.stem.casefold() for place in example.places}
    values: set[str] = set()
    if trials.get("by") == "column":
        values = set(text_cells(example.columns[str(trials["column"])]))
    for name, column in columns.items():
        cells = {cell.casefold() for cell in text_cells(column) if cell}
        is_named = bool(words_of(name) & (WORDS["trial"] | {"file", "log"}))
        # a name that no log has becomes a fault, not an event of all logs
        if is_text(column) and 2 * len(cells & names) > len(cells):
            return name
        if cells and values and is_named and cells <= {v.casefold() for v in values}:
            return name
    return None


def _time_of_events(start: str, latest: float, example: Example) -> Json:
    """unit and zero, by the name of the start and the length of the log."""
    if set(words_of(start)) & WORDS[ROW]:
        return {"unit": ROW}
    times_s = example.times_s
    named = unit_of_time(start)
    if not len(times_s):
        return {"unit": named or "s"}
    lasts_s = float(times_s[-1] - times_s[0])
    for unit in (named,) if named else NS_OF:
        latest_s = latest * NS_OF[unit] * 1e-9
        if 0.02 * lasts_s < latest_s <= 1.1 * lasts_s:
            return {"unit": unit}
        if times_s[0] < latest_s <= times_s[-1] + 0.1 * lasts_s:
            return {"unit": unit, "zero": "clock"}
    return {"unit": named or "s"}


def _first_named(key: str, columns: Mapping[str, Column]) -> str | None:
    for name in columns:
        words = {*words_of(name), name.lower(), *re.split(r"[^a-z0-9]", name.lower())}
        if words & WORDS[key] or (key == "start" and words & WORDS[ROW]):
            return name
    return None


def _labels(column: Column) -> list[str]:
    return [cell.strip() for cell in text_cells(column)]


def _situations(labels: Sequence[str]) -> dict[str, str]:
    """Label -> situation by its words, "" where they say nothing; none for many labels."""
    different = [label for label in dict.fromkeys(labels) if label]
    if len(different) > MOST_LABELS:
        return {}
    return {label: situation_of_word(label) or "" for label in different}


def _with_labels(
    events: Json, situations: Mapping[str, str], reasons: list[str]
) -> Json:
    """The events with labels, and what a closed hand does where only slips are known."""
    meant = {situation for situation in situations.values() if situation}
    if meant and meant <= {"safe_slip", "risky_slip"}:
        events["rest"] = "grasp"
    return {**events, "labels": dict(situations)}


def propose_facts(
    example: Example, parts: Json, events: Json, reasons: list[str]
) -> tuple[Json, Json]:
    """([actions], [facts]): the action of each trial; "" is a hole."""
    trials = parts.setdefault("trials", {})
    path = str(trials.get("path", ""))
    actions: Json = {}
    facts: Json = {}
    if "{action}" in path:
        pattern = path_pattern(path)
        for place in example.places:
            match = pattern.fullmatch(place.name)
            word = match["action"] if match else ""
            meant = action_of_word(word, has_events=bool(events))
            if word and action_of(word) != meant:
                actions[word] = meant
    else:
        is_known = _action_column(example, trials, actions, events) or events
        if not is_known and not example.log.about.get("action"):
            reasons.append("action: nothing says it; write one of docs/your-data.md")
            facts["action"] = ""
    if not trials:
        del parts["trials"]
    return actions, facts


def _action_column(example: Example, trials: Json, actions: Json, events: Json) -> bool:
    """Whether a column says the action of each trial; it is added with its words."""
    for name, column in example.columns.items():
        if name in example.taken or not words_of(name) & WORDS["action"]:
            continue
        words = [cell for cell in dict.fromkeys(_labels(column)) if cell]
        # a word that changes within a trial is an event
        is_event = len(words) > 1 and trials.get("by") != "column"
        if is_event or name == events.get("column"):
            continue
        if is_text(column) and 0 < len(words) <= MOST_LABELS:
            known = {w: action_of_word(w, has_events=bool(events)) for w in words}
            if all(known.values()):
                trials["action"] = name
                actions |= {w: a for w, a in known.items() if action_of(w) != a}
                return True
    return False
