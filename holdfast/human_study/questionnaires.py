"""Questionnaires on cards (TOML): items that are rated on one scale, and the score from 0 to 100.

Every item counts from its better or lesser end: the sum of all, over what it could be, times 100.
For six scales from 0 to 100 that is the raw NASA-TLX, the mean of the six (Hart, NASA-TLX: 20 years
later, 2006). For ten items from 1 to 5 with every second one reversed it is the SUS (Brooke, 1996).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from holdfast.edge_runtime.card_file import CardReader, read_toml
from holdfast.edge_runtime.reading import Json
from holdfast.human_study.shipped import QUESTIONNAIRES, found

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
        return self.lowest <= rating <= self.highest and (rating - self.lowest) % self.step == 0

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
            raise self.refused("items", rows, "at least one [[items]] with a name and ask")
        items = tuple(self.item(f"items[{k}]", row) for k, row in enumerate(rows, 1))
        if len({one.name for one in items}) < len(items):
            raise self.refused("items", [one.name for one in items], "names that differ")
        title, source, ask = (self.text(key, raw.get(key, "")) for key in KEYS[:3])
        return Questionnaire(
            self.path.stem, title, source, ask, lowest, highest, step, items, sha256
        )

    def item(self, key: str, row: Any) -> Item:
        self.require_known(self.require_table(key, row), ITEM_KEYS, key)
        name, question, low, high = (self.text(f"{key}.{k}", row.get(k)) for k in ITEM_KEYS[:4])
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
