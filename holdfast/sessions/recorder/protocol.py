"""A recording protocol (TOML): which objects, which actions, how often; keys as in a scene.

    title = "Five objects, thirty minutes"

    [[trials]]
    objects = ["soft-ball", "my-cup"]
    action = "pull"
    style = "author"         # a word for how the person acts, kept with the trial
    count = 10               # trials of each object

    [[trials]]
    action = "nothing"       # the empty hand
    count = 2

    [objects.my-cup]
    mass_g = 212             # needed for objects that are not in the built-in table

Every person gets a random order, drawn from the seed and the pseudonym, so it is always the same.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import DataNotFound, UsageError
from holdfast.core.reading import CardReader, read_toml
from holdfast.core.trial_layout import (
    LONGEST_NAME,
    NAME,
    SITUATION_OF_ACTION,
    checked_name,
)

if TYPE_CHECKING:
    from holdfast.core.contract import Json

ACTIONS = tuple(SITUATION_OF_ACTION)
"""Of scenes and of training too: a folder of trials is named after its action."""
NOTHING = "nothing"
MOST_TRIALS = 10_000
"""Beyond it a count is a slip of the key."""
MOST_MASS_G = 100_000.0
"""A hundred kilograms: beyond it the mass was not meant in grams."""
SECTIONS = ("title", "about", "trials", "objects", "effects")
"""Effects are of a simulated hand; they are allowed so that one file may serve both."""
ROW_KEYS = ("objects", "action", "style", "count")


@dataclass(frozen=True)
class Task:
    """One trial to record; object: "nothing" for the empty hand."""

    object: str
    action: str
    style: str = ""


@dataclass(frozen=True)
class Protocol:
    """All trials in the order of the file, masses by object, and the file's name and text."""

    name: str
    text: str
    tasks: tuple[Task, ...]
    mass_g: dict[str, float]

    @property
    def sha256(self) -> str:
        """Of the file's text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def ordered(self, seed: int, person: str) -> list[Task]:
        """The trials in the random order of a seed and a person."""
        import numpy as np

        # Python's own hash of a text differs from run to run, so the order would not continue.
        digest = hashlib.sha256(person.encode()).digest()
        of_person = int.from_bytes(digest[:4])
        rng = np.random.default_rng([seed, of_person])
        order = rng.permutation(len(self.tasks))
        return [self.tasks[k] for k in order]


def tasks_left(planned: Iterable[Task], done: Iterable[Task]) -> list[Task]:
    """What is left to record: the plan without one task for each trial that is done."""
    counts = Counter(done)
    left = []
    for task in planned:
        # Every trial that is done stands for one of its kind, whichever it was.
        if counts[task]:
            counts[task] -= 1
        else:
            left.append(task)
    return left


def read_protocol(path: Path) -> Protocol:
    """Read and check a recording protocol. Raises CardError, DataNotFound."""
    try:
        text, raw = read_toml(path)
    except FileNotFoundError:
        raise DataNotFound(
            "no such protocol", where=path, next_step="docs/recording.md shows one"
        ) from None
    return _TrialsReader(path).protocol(raw, text)


def is_list_of(value: Any, kind: type) -> bool:
    """Whether a value is a list, and all in it are of one type."""
    return isinstance(value, list) and all(isinstance(item, kind) for item in value)


class ProtocolReader(CardReader):
    """Checks that recording and study protocols share.

    Every method returns the value of a key, or raises CardError with what is allowed.
    """

    def text(self, key: str, value: Any) -> str:
        """A text, its white space made single spaces."""
        if not isinstance(value, str):
            raise self.refused(key, value, "a text in quotes")
        # A text over several lines of the file is one line on the console.
        return " ".join(value.split())

    def whole_number(self, key: str, value: Any, least: int, most: int) -> int:
        """A whole number within bounds."""
        # In Python True is a whole number; in a protocol it is a mistake.
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        if not is_whole or not least <= value <= most:
            raise self.refused(key, value, f"a whole number from {least} to {most}")
        return int(value)

    def positive(self, key: str, value: Any, most: float, unit: str) -> float:
        """A number above 0."""
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        # nan fails the comparison, so it is refused as well.
        if not is_number or not 0 < value <= most:
            allowed = f"{unit}, a number above 0 and at most {most:g}"
            raise self.refused(key, value, allowed)
        return float(value)

    def mass_g(self, key: str, value: Any) -> float:
        """The mass of an object."""
        return self.positive(key, value, MOST_MASS_G, "grams")

    def rows(self, key: str, value: Any, allowed: str) -> list[Json]:
        """A list of tables, at least one."""
        if not value or not is_list_of(value, dict):
            raise self.refused(key, value, allowed)
        return list(value)

    def action(self, key: str, value: Any) -> str:
        """One of ACTIONS."""
        if value not in ACTIONS:
            raise self.refused(key, value, ", ".join(ACTIONS))
        return str(value)

    def object_name(self, key: str, value: Any) -> str:
        """A name that may become a folder."""
        try:
            return checked_name(value if isinstance(value, str) else "", "object")
        except UsageError:
            allowed = f"up to {LONGEST_NAME} letters, digits and dashes"
            raise self.refused(key, value, allowed) from None


class _TrialsReader(ProtocolReader):
    """Checks one recording protocol."""

    def protocol(self, raw: Json, text: str) -> Protocol:
        self.require_known(raw, SECTIONS, "section")
        tasks: list[Task] = []
        allowed = "at least one [[trials]] with an action"
        for k, row in enumerate(self.rows("trials", raw.get("trials"), allowed)):
            tasks += self.tasks(f"trials[{k}]", row)

        if len(tasks) > MOST_TRIALS:
            raise self.refused("trials", len(tasks), f"at most {MOST_TRIALS} in all")

        mass_g = {}
        for name, value in self.table(raw, "objects").items():
            key = f"objects.{self.object_name('objects', name)}"
            table = self.require_table(key, value)
            self.require_known(table, ("mass_g",), key)
            mass_g[name] = self.mass_g(f"{key}.mass_g", table.get("mass_g"))

        return Protocol(self.path.stem, text, tuple(tasks), mass_g)

    def tasks(self, key: str, row: Json) -> list[Task]:
        """The trials of one row."""
        self.require_known(row, ROW_KEYS, key)
        action = self.action(f"{key}.action", row.get("action"))
        count = self.whole_number(f"{key}.count", row.get("count", 1), 1, MOST_TRIALS)
        style = row.get("style", "")
        names = row.get("objects", [])
        is_word = isinstance(style, str) and NAME.fullmatch(style)
        if style != "" and not is_word:
            allowed = "a word of letters, digits and dashes"
            raise self.refused(f"{key}.style", style, allowed)
        is_empty_hand = action == NOTHING
        if not isinstance(names, list) or bool(names) == is_empty_hand:
            allowed = "a list of objects, and none for the action nothing"
            raise self.refused(f"{key}.objects", names, allowed)

        objects = [self.object_name(f"{key}.objects", name) for name in names]
        tasks = [Task(name, action, style) for name in objects or [NOTHING]]
        # Whole rounds of all objects; `ordered` shuffles them anyway.
        return tasks * count
