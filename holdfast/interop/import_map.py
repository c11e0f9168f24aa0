"""What a column map says beyond columns: how logs become trials, for `holdfast import`.

[table]                      # of text tables and sheets; found by itself where it is not given
separator = ";"
decimal = ","
comment = "#"
encoding = "cp1252"
sheet = "Data"

[trials]
by = "file"                  # or "column", "gaps", "events": where one trial ends
path = "{person}/{object}_{action}_{trial}"   # names in the log's path; * is any text
column = "run"               # by = "column": a trial for each value of it
gap_s = 2                    # by = "gaps": a trial ends where no row comes for so long
person = "subject"           # columns that hold the names
object = "item"
action = "condition"
skip = ["pilot/*"]           # logs that are left out

[facts]                      # what is the same in all trials
person = "p01"
object = "mug"
action = "slip"
action_at_s = 5              # and further keys of a set's meta.json
[actions]                    # words of the log -> actions of docs/your-data.md
"torn away" = "pull"
[masses_g]
mug = 198

[events]
file = "events.xlsx"         # seen from the source; {name} is the log's own name
sheet = "Events"
trial = "file"               # its column that names the log (or the value of trials.column)
start = "from"
end = "to"                   # without it, an event lasts to the next one
label = "what"
column = "state"             # instead of a file: a column of the log that holds the labels
situation = "risky_slip"     # instead of labels
unit = "s"                   # s, ms, us, ns or row
zero = "log"                 # times count from the first row of the log, of the trial, or by
                             # the log's own clock: "log", "trial", "clock"
rest = "grasp"               # what a closed hand does outside all events
[events.labels]              # label -> situation, or "" for none
"slipping" = "risky_slip"
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.column_map import NS_OF, ColumnMap, MapReader, column_map_of
from holdfast.core.contract import SITUATIONS, Json
from holdfast.core.errors import CardError, LabelError
from holdfast.core.reading import read_toml
from holdfast.core.toml_lines import line_of
from holdfast.interop.logs.layout import TableFormat
from holdfast.training.datasets.trials import EMPTY_HAND, FOLDERS, action_of

ROW = "row"
"""The unit of events that are counted in rows, from 0."""
NAMES = ("person", "object", "action")
SPLITS = ("file", "column", "gaps", "events")
ZEROS = ("log", "trial", "clock")
ACTIONS = tuple(dict.fromkeys((*FOLDERS, EMPTY_HAND)))
FACTS = (*NAMES, "name", "kind", "recordings by", "redistributable", "action_at_s")
TABLE_KEYS = ("separator", "decimal", "comment", "encoding", "sheet")
TRIAL_KEYS = ("by", "path", "column", "gap_s", *NAMES, "skip")
EVENT_TEXTS = ("file", "sheet", "trial", "start", "end", "label", "column")
EVENT_KEYS = (*EVENT_TEXTS, "situation", "unit", "zero", "rest", "labels")
GAPS = (
    ("time.rate_hz", "0", "rows a second, or name the column of time instead"),
    ("sensors[0].x", '""', "columns of the first sensor; a table for each further one"),
    ("facts.action", '""', "what is done in every trial"),
)
"""Holes of a proposed map: key, how it is written where nothing says it, and what belongs there."""


@dataclass(frozen=True)
class TrialRules:
    """[trials]. columns: name of a fact -> the column that holds it."""

    by: str
    path: str
    column: str
    gap_s: float
    columns: Mapping[str, str]
    skip: tuple[str, ...]


@dataclass(frozen=True)
class EventRules:
    """[events]. labels: label -> situation, "" for none; empty texts are not given."""

    file: str
    sheet: str
    trial: str
    start: str
    end: str
    label: str
    column: str
    situation: str
    unit: str
    zero: str
    rest: str
    labels: Mapping[str, str]


@dataclass(frozen=True)
class ImportMap:
    """A whole map. facts: of all trials. actions: word -> action. events: None without."""

    columns: ColumnMap
    table: TableFormat
    trials: TrialRules
    facts: Json
    actions: Mapping[str, str]
    masses_g: Mapping[str, float]
    events: EventRules | None

    def action(self, word: str) -> str | None:
        """The action that a word of the log stands for; None for one that is not known."""
        return self.actions.get(word) or action_of(word)

    def situation(self, label: str) -> str | None:
        """The situation of an event's label, "" for none; None for a label that is not known."""
        labels = self.events.labels if self.events else {}
        if label in labels:
            return labels[label]
        plain = label.strip().lower().replace(" ", "_").replace("-", "_")
        return plain if plain in SITUATIONS else None


def read_import_map(path: Path) -> ImportMap:
    """Read and check a map with all its tables. Raises CardError and FileNotFoundError."""
    text, raw = read_toml(path)
    missing = gaps_of(text)
    # one alone is refused where it is read, with what is allowed there
    if len(missing) > 1:
        raise CardError(
            f"not whole: {'; '.join(missing)}",
            where=path,
            next_step="write what is missing",
        )
    return import_map_of(MapReader(path, text).column_map(raw))


def gaps_of(text: str) -> list[str]:
    """What nothing in the logs says and every map needs, with its line."""
    found = []
    for key, empty, what in GAPS:
        number = line_of(text, key)
        if number and text.split("\n")[number - 1].endswith(f"= {empty}"):
            found.append(f"line {number}: {key} = {empty}: {what}")
    return found


def import_map_of_text(text: str, path: Path) -> ImportMap:
    """The same of a text. Raises CardError."""
    return import_map_of(column_map_of(text, path))


def import_map_of(columns: ColumnMap) -> ImportMap:
    """The checked tables of a map. Raises CardError."""
    reader = _Reader(columns.path, columns.text)
    tables = columns.tables
    columns.hand_card()
    found = ImportMap(
        columns=columns,
        table=reader.table_format(reader.table(tables, "table")),
        trials=reader.trials(reader.table(tables, "trials")),
        facts=reader.facts(reader.table(tables, "facts")),
        actions=reader.actions(reader.table(tables, "actions")),
        masses_g=reader.masses(reader.table(tables, "masses_g")),
        events=reader.events(tables["events"]) if "events" in tables else None,
    )
    if found.trials.by == "events" and found.events is None:
        raise reader.refused("trials.by", "events", "that with a table [events]")
    return found


class _Reader(MapReader):
    """Checks of the tables of an import."""

    def table_format(self, table: Json) -> TableFormat:
        """[table]. Raises CardError."""
        self.require_known(table, TABLE_KEYS, "table")
        texts = {}
        for key, value in table.items():
            texts[key] = self.name(f"table.{key}", value, empty=key == "comment")
        for key in ("separator", "decimal", "comment"):
            if len(texts.get(key, "")) > 1:
                raise self.refused(f"table.{key}", texts[key], "one character")
        if texts.get("decimal", ".") not in (".", ","):
            raise self.refused("table.decimal", texts["decimal"], '"." or ","')
        return TableFormat(**texts)

    def trials(self, table: Json) -> TrialRules:
        """[trials]. Raises CardError."""
        self.require_known(table, TRIAL_KEYS, "trials")
        by = self.one_of("trials.by", table.get("by", "file"), SPLITS)
        path = self.name("trials.path", table.get("path", ""), empty=True)
        column = self.name("trials.column", table.get("column", ""), empty=True)
        gap_s = self.number("trials.gap_s", table.get("gap_s", 1.0), 1e-3, 1e6)
        if by == "column" and not column:
            raise self.refused("trials.column", None, "a column, for by = column")
        columns = {}
        for key in NAMES:
            if key in table:
                columns[key] = self.name(f"trials.{key}", table[key])
        self.require_pattern(path)
        skip = table.get("skip", [])
        if not isinstance(skip, list) or not all(isinstance(one, str) for one in skip):
            raise self.refused("trials.skip", skip, 'a list such as ["pilot/*"]')
        return TrialRules(by, path, column, gap_s, columns, tuple(skip))

    def require_pattern(self, path: str) -> None:
        """Raise CardError for a pattern with a name in {} that is not known, or twice."""
        fields = re.findall(r"\{([^}]*)\}", path)
        for field in fields:
            if field not in (*NAMES, "trial") or fields.count(field) > 1:
                allowed = "{person}, {object}, {action} and {trial}, each once"
                raise self.refused("trials.path", path, allowed)

    def facts(self, table: Json) -> Json:
        """[facts]. Raises CardError."""
        self.require_known(table, FACTS, "facts")
        for key, value in table.items():
            if key == "redistributable":
                if not isinstance(value, bool):
                    raise self.refused(f"facts.{key}", value, "true or false")
            elif key == "action_at_s":
                self.number(f"facts.{key}", value, 1e-3, 1e6)
            elif key == "action":
                if not isinstance(value, str) or action_of(value) is None:
                    raise self.refused("facts.action", value, ", ".join(ACTIONS))
            else:
                self.name(f"facts.{key}", value)
        return table

    def actions(self, table: Json) -> dict[str, str]:
        """[actions]. Raises CardError."""
        found = {}
        for word, action in table.items():
            known = action_of(action) if isinstance(action, str) else None
            if known is None:
                allowed = f"one of {', '.join(ACTIONS)}"
                raise self.refused(f"actions.{word}", action, allowed)
            found[word] = known
        return found

    def masses(self, table: Json) -> dict[str, float]:
        """[masses_g]. Raises CardError."""
        return {
            name: self.number(f"masses_g.{name}", mass, 1e-3, 1e6)
            for name, mass in table.items()
        }

    def events(self, raw: Any) -> EventRules:
        """[events]. Raises CardError."""
        table = self.require_table("events", raw)
        self.require_known(table, EVENT_KEYS, "events")
        texts = {}
        for key in EVENT_TEXTS:
            texts[key] = self.name(f"events.{key}", table.get(key, ""), empty=True)
        self.require_source(texts, table)
        labels = self.require_table("events.labels", table.get("labels", {}))
        for label, situation in labels.items():
            self.one_of(f"events.labels.{label}", situation, (*SITUATIONS, ""))
        situation = table.get("situation", "")
        rest = table.get("rest", "")
        return EventRules(
            **texts,
            situation=self.one_of("events.situation", situation, (*SITUATIONS, "")),
            unit=self.one_of("events.unit", table.get("unit", "s"), (*NS_OF, ROW)),
            zero=self.one_of("events.zero", table.get("zero", "log"), ZEROS),
            rest=self.one_of("events.rest", rest, (*SITUATIONS, "")),
            labels=labels,
        )

    def require_source(self, texts: Mapping[str, str], table: Json) -> None:
        """Raise CardError unless events come from one place and have what they need."""
        if bool(texts["file"]) == bool(texts["column"]):
            allowed = "events.file or events.column, one of both"
            raise self.refused("events", "file and column", allowed)
        if texts["file"] and not texts["start"]:
            raise self.refused("events.start", None, "the column of the times")
        if texts["file"] and not texts["label"] and not table.get("situation"):
            raise self.refused("events.label", None, "a column, or events.situation")

    def one_of(self, key: str, value: Any, allowed: tuple[str, ...]) -> str:
        """A word that is allowed. Raises CardError."""
        if not isinstance(value, str) or value not in allowed:
            words = ", ".join(word or '""' for word in allowed)
            raise self.refused(key, value, words)
        return value


def path_pattern(path: str) -> re.Pattern[str]:
    """A pattern such as `{person}/{object}_{trial}` as a regular expression; * is any text."""
    parts = re.split(r"(\{\w+\}|\*)", path)
    found = []
    for part in parts:
        if part == "*":
            found.append("[^/]*")
        elif part.startswith("{") and part.endswith("}"):
            found.append(f"(?P<{part[1:-1]}>[^/]+?)")
        else:
            found.append(re.escape(part))
    return re.compile("".join(found))


def names_of_path(path: str, name: str, where: Path) -> dict[str, str]:
    """What the log's path says by the pattern. Raises LabelError."""
    if not path:
        return {}
    match = path_pattern(path).fullmatch(name)
    if match is None:
        raise LabelError(
            f"{name} is not {path} (trials.path)",
            where=where,
            next_step="correct trials.path in the column map, or leave it out: [trials] skip",
        )
    return {key: text for key, text in match.groupdict().items() if key in NAMES}


def safe_name(text: str) -> str:
    """A name as a folder: letters, digits and dashes.

    >>> safe_name("Soft ball #2")
    'Soft-ball-2'
    """
    plain = re.sub(r"[^\w-]+", "-", text.strip(), flags=re.ASCII)
    return plain.strip("-_")[:60]
