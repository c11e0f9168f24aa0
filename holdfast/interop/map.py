"""The column map of an import: the tables that say how logs become trials.

[trials]
path = "{person}/{object}_{action}_{trial} | nothing_*"   # what the paths of the logs say: * is
                                  # any text; of several patterns the first that fits
fingers = ["thumb", "index"]     # words of the files of one trial, a file for each finger
column = "run"                   # a trial for each of its values
person = "subject"               # columns that hold names; also object, action

[facts]                          # what is the same in all trials; also object, action, and for
person = "p01"                   # meta.json kind and action_at_s

[actions]                        # words of the logs -> actions
"torn away" = "pull"

unwrap = true                    # above all tables: readings of 16 bits went over their end

[masses_g]
mug = 198

[events]                         # when it slips: a column of the log, or a table of events
column = "state"
hold = true                      # a label holds until the next one; an empty cell says nothing
# instead of column: file = "events.xlsx" for all logs (or "*_events.csv": that beside each), its
# columns trial, start, end and label, unit = "s" (or ms, us, ns, row) and zero = "log" (the trial's
# first row) or "clock"

[events.labels]                  # labels -> situations, "" for none; the label "" where there is
"slipping" = "risky_slip"        # no column of labels
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from holdfast.core.column_map import ColumnMap, Name
from holdfast.core.contract import SITUATIONS
from holdfast.core.errors import LabelError, UsageError
from holdfast.core.schema import read
from holdfast.core.trial_layout import SITUATION_OF_ACTION
from holdfast.data.datasets.trials import FOLDERS, action_of
from holdfast.interop.words import NUMBERED, TOGETHER

NAMES = ("person", "object", "action")
"""What a trial is called by."""
Situation = Literal["", "nothing", "grasp", "safe_slip", "risky_slip"]
Positive = Annotated[float, Meta(gt=0.0, le=1e6)]


class Table(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True
):
    """A table of a map."""


class TrialRules(Table, frozen=True):
    """[trials]: which rows of which files are a trial, and what it is called."""

    path: Name = ""
    fingers: tuple[str, ...] = ()
    column: Name = ""
    person: Name = ""
    object: Name = ""
    action: Name = ""

    def names_of(self, name: str, where: Path) -> dict[str, str]:
        """What the path of a log says by the pattern. Raises LabelError."""
        if not self.path:
            return {}
        for pattern in self.path.split(" | "):
            match = re.fullmatch(_regex(pattern), name)
            if match is not None:
                return match.groupdict()
        raise LabelError(
            f"{name} is not {self.path} (trials.path)",
            where=where,
            next_step="correct it: {person}, {object}, {action} and {trial}, each once",
        )


def _regex(pattern: str) -> str:
    """A pattern of paths as a regular expression."""
    # what is one word is not taken for two
    whole = rf"(?!{TOGETHER}(?:[/_ .-]|$))"
    forms = dict.fromkeys(NAMES, f"{TOGETHER}|{whole}[^/]+?")
    forms["trial"] = f"{NUMBERED.pattern}[a-z]?"
    if "-" in pattern:
        # soft-ball-slip is a soft-ball
        forms["action"] = f"{TOGETHER}|{whole}[^/_ .-]+"
    regex = re.escape(pattern).replace(r"\*", "[^/]*")
    for key, form in forms.items():
        group = f"(?P<{key}>(?i:{form}))"
        regex = regex.replace(rf"\{{{key}\}}", group, 1)
    return regex


class Facts(Table, frozen=True):
    """[facts]: what is the same in all trials."""

    person: Name = ""
    object: Name = ""
    action: Name = ""
    kind: Name = ""
    action_at_s: Positive | None = None


class EventRules(Table, frozen=True):
    """[events]: where the labels of a trial come from."""

    column: Name = ""
    file: Name = ""
    trial: Name = ""
    start: Name = ""
    end: Name = ""
    label: Name = ""
    unit: Literal["s", "ms", "us", "ns", "row"] = "s"
    zero: Literal["log", "clock"] = "log"
    hold: bool = False
    labels: dict[str, Situation] = {}

    def __post_init__(self) -> None:
        is_table = self.file and self.start and (self.label or self.labels)
        if bool(self.column) == bool(is_table):
            raise ValueError(
                "no labels; allowed: column, or file with start and label or labels"
            )

    @property
    def place(self) -> str:
        """The column or the file."""
        return self.column or self.file

    @property
    def rest(self) -> Situation:
        """What a closed hand does where no label says it; "" where the labels say it all."""
        situations = set(self.labels.values())
        return "" if "grasp" in situations and "" not in situations else "grasp"


class ImportMap(ColumnMap, frozen=True):
    """A column map with its tables."""

    trials: TrialRules = TrialRules()
    facts: Facts = Facts()
    actions: Mapping[str, str] = {}
    masses_g: Mapping[str, Positive] = {}
    events: EventRules | None = None
    unwrap: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for action in (*self.actions.values(), self.facts.action or FOLDERS[0]):
            if action_of(action) is None:
                raise ValueError(f"action {action!r}; allowed: {', '.join(FOLDERS)}")

    def action(self, word: str) -> str | None:
        """The action that a word of the log stands for; None for one that is not known."""
        return action_of(self.actions.get(word, word))

    def situation(self, label: str) -> str | None:
        """The situation of a label, "" for none; None for a label that is not known."""
        if self.events and label in self.events.labels:
            return self.events.labels[label]
        if label in self.actions:
            return SITUATION_OF_ACTION.get(self.action(label) or "", "")
        return label if label in ("", *SITUATIONS) else None


# -- as a file


def read_import_map(path: Path) -> ImportMap:
    """Read and check a map with all its tables. Raises CardError and UsageError."""
    try:
        plan = read(path, ImportMap)
    except FileNotFoundError:
        raise UsageError(
            "no such column map", where=path, next_step="check the path"
        ) from None

    plan.hand_card(path.parent)
    return plan


def map_text(plan: ColumnMap) -> str:
    """A map as TOML, with a mark of its content in its first line."""
    return _marked(toml_text(msgspec.to_builtins(plan)))


def is_changed(path: Path) -> bool:
    """Whether a file that is there is no map of ours, or was changed by hand."""
    if not path.exists():
        return False
    text = path.read_text("utf-8", errors="replace")
    return text != _marked(text.partition("\n")[2])


def _marked(body: str) -> str:
    mark = sha256(body.encode()).hexdigest()[:16]
    return f"# Written by holdfast import, {mark}: a changed file is kept.\n{body}"


def toml_text(table: Mapping[str, Any], within: str = "") -> str:
    """A table of TOML: its own keys, then the tables within it, and lists of tables.

    within: what its name begins with, such as `events.`
    """
    lines, tables = "", ""
    for key, value in table.items():
        key = key if re.fullmatch("[A-Za-z0-9_-]+", key) else json.dumps(key)
        name = f"{within}{key}"
        if isinstance(value, dict):
            inner = toml_text(value, f"{name}.")
            tables += f"\n[{name}]\n{inner}" if inner else ""
        elif isinstance(value, list | tuple) and isinstance(value[0], dict):
            tables += "".join(f"\n[[{name}]]\n{toml_text(one)}" for one in value)
        else:
            # a text, a number or a list of such is written as in JSON
            lines += f"{key} = {json.dumps(value, ensure_ascii=False)}\n"

    # TOML forbids the one control character that JSON leaves as it is.
    return (lines + tables).replace("\x7f", "\\u007f")
