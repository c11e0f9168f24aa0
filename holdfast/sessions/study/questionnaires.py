"""Questionnaires on cards (TOML): items that are rated on one scale, and the score from 0 to 100.

Every item counts from its better or lesser end: the sum of all, over what it could be, times 100.
For six scales from 0 to 100 that is the raw NASA-TLX, the mean of the six (Hart, NASA-TLX: 20 years
later, 2006). For ten items from 1 to 5 with every second one reversed it is the SUS (Brooke, 1996).

A questionnaire on the terminal: item by item, every answer in the journal at once.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.reading import CardReader, Json, read_toml
from holdfast.core.writing import write_whole
from holdfast.sessions.study import console as keys
from holdfast.sessions.study import journal as log
from holdfast.sessions.study.console import LEFT_OUT, AnyDesk
from holdfast.sessions.study.journal import Journal, Progress
from holdfast.sessions.study.shipped import QUESTIONNAIRES, found
from holdfast.sessions.study.steps import QUESTIONNAIRE, StudyCard

KEYS = ("title", "source", "ask", "lowest", "highest", "step", "items")
ITEM_KEYS = ("name", "ask", "low", "high", "reversed")
Answers = Mapping[str, int | None]
"""Item -> its rating; None: the person did not want to answer."""


@dataclass(frozen=True)
class Item:
    """One item; reversed: a high rating counts little."""

    name: str
    ask: str
    low: str
    high: str
    reversed: bool = False


@dataclass(frozen=True)
class Questionnaire:
    """A whole questionnaire; ratings go from lowest to highest in steps."""

    name: str
    title: str
    source: str
    ask: str
    lowest: int
    highest: int
    step: int
    items: tuple[Item, ...]
    sha256: str

    def allows(self, rating: int) -> bool:
        """Whether an item may have this rating."""
        return (
            self.lowest <= rating <= self.highest
            and (rating - self.lowest) % self.step == 0
        )

    def score(self, answers: Answers) -> float | None:
        """From 0 to 100; None where an item has no answer."""
        counted = [self._counted(one, answers.get(one.name)) for one in self.items]
        known = [one for one in counted if one is not None]
        if len(known) < len(counted):
            return None
        return 100.0 * sum(known) / (len(known) * (self.highest - self.lowest))

    def _counted(self, item: Item, rating: int | None) -> int | None:
        if rating is None:
            return None
        return self.highest - rating if item.reversed else rating - self.lowest


def read_questionnaire(name: str) -> Questionnaire:
    """Read one by its path, or a shipped one by its name. Raises CardError, DataNotFound."""
    path = found(name, QUESTIONNAIRES, "questionnaire")
    text, raw = read_toml(path)
    return _Reader(path).questionnaire(raw, hashlib.sha256(text.encode()).hexdigest())


class _Reader(CardReader):
    """Checks one questionnaire."""

    def questionnaire(self, raw: Json, sha256: str) -> Questionnaire:
        self.require_known(raw, KEYS, "section")
        lowest, highest, step = (self.whole(key, raw.get(key)) for key in KEYS[3:6])
        if highest <= lowest or step < 1 or (highest - lowest) % step:
            raise self.refused("step", step, "whole steps from lowest to highest")
        rows = raw.get("items")
        if not isinstance(rows, list) or not rows:
            raise self.refused(
                "items", rows, "at least one [[items]] with a name and ask"
            )
        items = tuple(self.item(f"items[{k}]", row) for k, row in enumerate(rows, 1))
        if len({one.name for one in items}) < len(items):
            raise self.refused(
                "items", [one.name for one in items], "names that differ"
            )
        title, source, ask = (self.text(key, raw.get(key, "")) for key in KEYS[:3])
        return Questionnaire(
            self.path.stem, title, source, ask, lowest, highest, step, items, sha256
        )

    def item(self, key: str, row: Any) -> Item:
        self.require_known(self.require_table(key, row), ITEM_KEYS, key)
        name, question, low, high = (
            self.text(f"{key}.{k}", row.get(k)) for k in ITEM_KEYS[:4]
        )
        turned = row.get("reversed", False)
        if not isinstance(turned, bool):
            raise self.refused(f"{key}.reversed", turned, "true or false")
        return Item(name, question, low, high, turned)

    def text(self, key: str, value: Any) -> str:
        if not isinstance(value, str):
            raise self.refused(key, value, "a text in quotes")
        return " ".join(value.split())

    def whole(self, key: str, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.refused(key, value, "a whole number")
        return value


ANSWERS = "questionnaires.json"
HELP = (
    f"a number, or {LEFT_OUT} to leave it out; or a key and Enter: s, r, n, a, p, w, q"
)


def ask(name: str, journal: Journal, desk: AnyDesk) -> str:
    """Ask the items without an answer; returns NEXT, or the key that interrupts it.

    REPEAT asks the item before again, and is returned only at the first item.
    """
    of = read_questionnaire(name)
    desk.say(f"{of.title}. {of.ask}")
    desk.say(HELP)
    part = journal.progress.part
    at = sum((part, item.name) in journal.progress.answers for item in of.items)
    while at < len(of.items):
        answer = _answer(of, of.items[at], f"{at + 1} of {len(of.items)}", desk)
        if answer == keys.REPEAT and at > 0:
            at -= 1
        elif isinstance(answer, str):
            return answer
        else:
            journal.append(log.ANSWER, part=part, item=of.items[at].name, rating=answer)
            at += 1
    return keys.NEXT


def _answer(
    of: Questionnaire, item: Item, place: str, desk: AnyDesk
) -> int | str | None:
    """A rating, None where it is left out, or a key."""
    scale = f"{of.lowest} {item.low} .. {of.highest} {item.high}"
    steps = f", in steps of {of.step}" if of.step > 1 else ""
    while True:
        typed = desk.text(f"{place}: {item.ask} ({scale}{steps})")
        if typed is None:
            return keys.QUIT
        if typed == LEFT_OUT:
            return None
        if typed.lower() in keys.KEYS and typed:
            return keys.KEYS[typed.lower()]
        if typed.isdecimal() and len(typed) < 9 and of.allows(int(typed)):
            return int(typed)
        desk.say(f"{typed[:20]!r} is not on the scale; {HELP}")


def scores(card: StudyCard, progress: Progress) -> list[dict[str, Any]]:
    """Every questionnaire with an answer: its ratings and its score, None if one is left out."""
    found = []
    for number, part in enumerate(card.parts):
        if part.kind != QUESTIONNAIRE:
            continue
        of = read_questionnaire(part.questionnaire)
        key = [(number, item.name) for item in of.items]
        answers = {
            name: progress.answers[number, name]
            for _, name in key
            if (number, name) in progress.answers
        }
        if answers:
            found.append(
                {
                    "questionnaire": of.name,
                    "title": of.title,
                    "source": of.source,
                    "sha256": of.sha256,
                    "part": number,
                    "ratings": answers,
                    "score": of.score(answers),
                }
            )
    return found


def write_answers(home: Path, card: StudyCard, progress: Progress) -> Path:
    """Write questionnaires.json of a person. Raises OutputError."""
    text = json.dumps(
        {"questionnaires": scores(card, progress)}, indent=1, allow_nan=False
    )
    return write_whole(home / ANSWERS, text + "\n")
