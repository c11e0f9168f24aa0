"""Questionnaires (TOML): items that are rated on one scale, and the score from 0 to 100.

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

from holdfast.core.reading import Json, read_toml
from holdfast.core.writing import write_whole
from holdfast.sessions.recorder.protocol import ProtocolReader
from holdfast.sessions.study.console import KEYS, LEFT_OUT, Console, Key
from holdfast.sessions.study.journal import Event, Journal, Progress
from holdfast.sessions.study.protocol import (
    FORMS,
    QUESTIONNAIRE,
    StudyProtocol,
    shipped_or_own,
)

SECTIONS = ("title", "source", "ask", "lowest", "highest", "step", "items")
ITEM_KEYS = ("name", "ask", "low", "high", "reversed")
MOST_DIGITS = 8
"""Of a rating that is typed: more would only make a longer error."""
MOST_RATING = 10**MOST_DIGITS - 1
ANSWERS = "questionnaires.json"
HELP = (
    f"a number, or {LEFT_OUT} to leave it out; or a key and Enter: s, r, n, a, p, w, q"
)


@dataclass(frozen=True)
class Item:
    """One item; reversed: a high rating counts little."""

    name: str
    ask: str
    low: str
    high: str
    reversed: bool


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
    items: list[Item]
    sha256: str

    def allows(self, rating: int) -> bool:
        """Whether an item may have this rating."""
        # Scales such as the TLX allow every fifth number only.
        is_step = (rating - self.lowest) % self.step == 0
        return self.lowest <= rating <= self.highest and is_step

    def score(self, ratings: Mapping[str, int | None]) -> float | None:
        """From 0 to 100; None where an item has no rating. ratings: by the item's name."""
        total = 0
        for item in self.items:
            rating = ratings.get(item.name)
            # A score of some items is not comparable with one of all items.
            if rating is None:
                return None
            # A reversed item counts from its other end.
            total += self.highest - rating if item.reversed else rating - self.lowest

        most = len(self.items) * (self.highest - self.lowest)
        return 100.0 * total / most


def read_questionnaire(name: str) -> Questionnaire:
    """Read one by its path, or a shipped one by its name. Raises CardError, DataNotFound."""
    path = shipped_or_own(name, FORMS, "questionnaire")
    text, raw = read_toml(path)
    return _Reader(path).questionnaire(raw, hashlib.sha256(text.encode()).hexdigest())


class _Reader(ProtocolReader):
    """Checks one questionnaire."""

    def questionnaire(self, raw: Json, sha256: str) -> Questionnaire:
        self.require_known(raw, SECTIONS, "section")
        lowest = self.rating("lowest", raw)
        highest = self.rating("highest", raw)
        step = self.rating("step", raw)
        # Steps that miss the highest rating would make the best score unreachable.
        if highest <= lowest or step < 1 or (highest - lowest) % step:
            raise self.refused("step", step, "whole steps from lowest to highest")

        allowed = "at least one [[items]] with a name and ask"
        rows = self.rows("items", raw.get("items"), allowed)
        items = []
        for k, row in enumerate(rows, 1):
            items.append(self.item(f"items[{k}]", row))

        names = [item.name for item in items]
        # Answers are kept by name: two items of one name would share a rating.
        if len(set(names)) < len(names):
            raise self.refused("items", names, "names that differ")

        return Questionnaire(
            name=self.path.stem,
            title=self.text("title", raw.get("title", "")),
            source=self.text("source", raw.get("source", "")),
            ask=self.text("ask", raw.get("ask", "")),
            lowest=lowest,
            highest=highest,
            step=step,
            items=items,
            sha256=sha256,
        )

    def item(self, key: str, row: Json) -> Item:
        self.require_known(row, ITEM_KEYS, key)
        is_reversed = row.get("reversed", False)
        if not isinstance(is_reversed, bool):
            raise self.refused(f"{key}.reversed", is_reversed, "true or false")

        return Item(
            name=self.text(f"{key}.name", row.get("name")),
            ask=self.text(f"{key}.ask", row.get("ask")),
            low=self.text(f"{key}.low", row.get("low")),
            high=self.text(f"{key}.high", row.get("high")),
            reversed=is_reversed,
        )

    def rating(self, key: str, raw: Json) -> int:
        return self.whole_number(key, raw.get(key), -MOST_RATING, MOST_RATING)


def answer_items(name: str, journal: Journal, console: Console) -> Key:
    """Ask the items without an answer; returns NEXT, or the key that interrupts it.

    REPEAT asks the item before again, and is returned only at the first item.
    """
    form = read_questionnaire(name)
    part = journal.part
    console.report(f"{form.title}. {form.ask}")
    console.report(HELP)
    # Answers of an earlier run count: a killed study goes on with the next item.
    at = sum((part, item.name) in journal.progress.answers for item in form.items)

    while at < len(form.items):
        item = form.items[at]
        place = f"{at + 1} of {len(form.items)}"
        answer = _answer(form, item, place, console)
        if answer == Key.REPEAT and at > 0:
            at -= 1
        elif isinstance(answer, Key):
            return answer
        else:
            journal.append(Event.ANSWER, part=part, item=item.name, rating=answer)
            at += 1

    return Key.NEXT


def _answer(
    form: Questionnaire, item: Item, place: str, console: Console
) -> int | Key | None:
    """A rating, None where it is left out, or a key."""
    scale = f"{form.lowest} {item.low} .. {form.highest} {item.high}"
    if form.step > 1:
        scale += f", in steps of {form.step}"

    while True:
        typed = console.text(f"{place}: {item.ask} ({scale})")
        if typed is None:
            return Key.QUIT
        if typed == LEFT_OUT:
            return None
        letter = typed.lower()
        if letter in KEYS:
            return KEYS[letter]
        # isdecimal refuses signs, points and spaces; the length bounds what int() must read.
        if typed.isdecimal() and len(typed) <= MOST_DIGITS and form.allows(int(typed)):
            return int(typed)
        console.report(f"{typed[:20]!r} is not on the scale; {HELP}")


def scores(protocol: StudyProtocol, progress: Progress) -> list[dict[str, Any]]:
    """Every questionnaire with an answer: its ratings and its score, None if one is left out."""
    answered = []
    for number, part in enumerate(protocol.parts):
        if part.kind != QUESTIONNAIRE:
            continue
        form = read_questionnaire(part.questionnaire)
        # Items without an answer are left out; a dash was answered with None.
        ratings = {}
        for item in form.items:
            if (number, item.name) in progress.answers:
                ratings[item.name] = progress.answers[number, item.name]
        if ratings:
            answered.append(
                {
                    "questionnaire": form.name,
                    "title": form.title,
                    "source": form.source,
                    "sha256": form.sha256,
                    "part": number,
                    "ratings": ratings,
                    "score": form.score(ratings),
                }
            )

    return answered


def write_answers(home: Path, protocol: StudyProtocol, progress: Progress) -> None:
    """Write questionnaires.json of a person. Raises OutputError."""
    content = {"questionnaires": scores(protocol, progress)}
    write_whole(home / ANSWERS, json.dumps(content, indent=1, allow_nan=False) + "\n")
