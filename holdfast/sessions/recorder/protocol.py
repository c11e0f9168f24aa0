"""A protocol card (TOML): which objects, which actions, how often; keys as on a scene's card.

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
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.errors import DataNotFound, UsageError
from holdfast.core.reading import CardReader, Json, read_toml, require_file
from holdfast.core.trial_layout import DISCARDED, SITUATION_OF_ACTION

ACTIONS = tuple(SITUATION_OF_ACTION)
NOTHING = "nothing"
WORD = re.compile(r"[A-Za-z0-9]+(-[A-Za-z0-9]+)*")
LONGEST_WORD = 24
MOST_TRIALS = 10_000
SECTIONS, ROW_KEYS = (
    ("title", "about", "trials", "objects", "effects"),
    ("objects", "action", "style", "count"),
)
"""Effects are of a simulated hand; they are allowed so that one card may serve both."""
OBJECT_KEYS = ("mass_g",)


@dataclass(frozen=True)
class Task:
    """One trial to record; thing: "nothing" for the empty hand."""

    thing: str
    action: str
    style: str = ""


@dataclass(frozen=True)
class Protocol:
    """All trials of a card in its own order, masses by object, and the card's name and text."""

    name: str
    text: str
    tasks: tuple[Task, ...]
    mass_g: dict[str, float]

    @property
    def sha256(self) -> str:
        """Of the card's text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def ordered(self, seed: int, person: str) -> list[Task]:
        """The trials in the random order of a seed and a person."""
        import numpy as np

        of_person = int.from_bytes(hashlib.sha256(person.encode()).digest()[:4])
        return [
            self.tasks[k]
            for k in np.random.default_rng([seed, of_person]).permutation(
                len(self.tasks)
            )
        ]


def left(plan: Sequence[Task], done: Sequence[Task]) -> list[Task]:
    """What is left to record: the plan without one task for each trial that is done."""
    counts: dict[Task, int] = {}
    for task in done:
        counts[task] = counts.get(task, 0) + 1
    still = []
    for task in plan:
        if counts.get(task, 0):
            counts[task] -= 1
        else:
            still.append(task)
    return still


def word(text: str, what: str) -> str:
    """A pseudonym or a name that may become a folder. Raises UsageError."""
    if (
        not WORD.fullmatch(text)
        or len(text) > LONGEST_WORD
        or text.lower() in (NOTHING, DISCARDED)
    ):
        raise UsageError(
            f"{what} {text[:40]!r} is not allowed",
            cause="an address, a path, or a reserved word",
            next_step=f"up to {LONGEST_WORD} letters, digits and dashes, such as p01; no real name",
        )
    return text


def read_protocol(path: Path) -> Protocol:
    """Read and check a card. Raises CardError, DataNotFound."""
    try:
        require_file(path)
        text, raw = read_toml(path)
    except FileNotFoundError:
        raise DataNotFound(
            "no such card", where=path, next_step="docs/recording.md shows one"
        ) from None
    return _ProtocolReader(path).protocol(raw, text)


class _ProtocolReader(CardReader):
    """Checks one protocol card."""

    def protocol(self, raw: Json, text: str) -> Protocol:
        self.require_known(raw, SECTIONS, "section")
        rows = raw.get("trials")
        if (
            not isinstance(rows, list)
            or not rows
            or not all(isinstance(row, dict) for row in rows)
        ):
            raise self.refused("trials", rows, "at least one [[trials]] with an action")
        tasks = [
            task for k, row in enumerate(rows) for task in self.row(f"trials[{k}]", row)
        ]
        if len(tasks) > MOST_TRIALS:
            raise self.refused("trials", len(tasks), f"at most {MOST_TRIALS} in all")
        return Protocol(
            self.path.stem, text, tuple(tasks), self.masses(self.table(raw, "objects"))
        )

    def row(self, key: str, row: Json) -> list[Task]:
        self.require_known(row, ROW_KEYS, key)
        action, style = row.get("action"), row.get("style", "")
        count, names = row.get("count", 1), row.get("objects", [])
        if not isinstance(action, str) or action not in ACTIONS:
            raise self.refused(f"{key}.action", action, ", ".join(ACTIONS))
        if (
            not isinstance(count, int)
            or isinstance(count, bool)
            or not 1 <= count <= MOST_TRIALS
        ):
            raise self.refused(
                f"{key}.count", count, f"a whole number from 1 to {MOST_TRIALS}"
            )
        if not isinstance(style, str) or (style and not WORD.fullmatch(style)):
            raise self.refused(
                f"{key}.style", style, "a word of letters, digits and dashes"
            )
        if not isinstance(names, list) or bool(names) == (action == NOTHING):
            allowed = "a list of objects, and none for the action nothing"
            raise self.refused(f"{key}.objects", names, allowed)
        things = [self.thing(f"{key}.objects", name) for name in names] or [NOTHING]
        return [Task(thing, action, style) for _ in range(count) for thing in things]

    def masses(self, objects: Json) -> dict[str, float]:
        return {
            self.thing("objects", name): self.mass(f"objects.{name}", table)
            for name, table in objects.items()
        }

    def mass(self, key: str, table: Any) -> float:
        mass_g = self.require_table(key, table).get("mass_g")
        self.require_known(table, OBJECT_KEYS, key)
        if isinstance(mass_g, bool) or not isinstance(mass_g, int | float):
            raise self.refused(f"{key}.mass_g", mass_g, "grams, a number")
        if not 0.0 < mass_g < math.inf:
            raise self.refused(f"{key}.mass_g", mass_g, "grams, above 0")
        return float(mass_g)

    def thing(self, key: str, name: Any) -> str:
        try:
            return word(name if isinstance(name, str) else "", "object")
        except UsageError:
            raise self.refused(
                key, name, "a word of letters, digits and dashes"
            ) from None
