"""A protocol card of a study (TOML): its steps in order, each with minutes and what to say.

    title = "One object, two actions"
    questionnaires = ["sus"]          # after the last step, not in the minutes

    [objects.soft-ball]
    name = "soft ball"
    actions = ["pass", "pull"]

    [[steps]]
    title = "Welcome"
    kind = "say"                      # say, mount, video, questions, record, questionnaire
    minutes = 2
    say = "We record what the hand feels."

    [[steps]]                         # for each object and each of its actions
    objects = ["soft-ball"]

    [[steps.each]]
    title = "Testing"
    kind = "record"
    minutes = 2
    repetitions = 3
    say = "Please do this three times: {how}."

A row of the kind `questions` belongs to the step before it; a questionnaire has no number. All
others are counted from first_step (1).
"""

from __future__ import annotations

import hashlib
import string
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from holdfast.core.reading import CardReader, Json, read_toml
from holdfast.sessions.recorder.protocol import ACTIONS, NOTHING, WORD, Protocol, Task
from holdfast.sessions.study.shipped import CARDS, QUESTIONNAIRES, found, names_in

SAY, MOUNT, VIDEO, QUESTIONS = "say", "mount", "video", "questions"
RECORD, QUESTIONNAIRE = "record", "questionnaire"
KINDS = (SAY, MOUNT, VIDEO, QUESTIONS, RECORD, QUESTIONNAIRE)
TITLES = {
    QUESTIONS: "Questions",
    VIDEO: "Video",
    MOUNT: "Mounting",
    RECORD: "Recording",
}
SECTIONS = (
    "title",
    "about",
    "before",
    "first_step",
    "questionnaires",
    "actions",
    "objects",
    "steps",
)
TEXTS = ("title", "say", "show", "hand_over")
ROW_KEYS = (
    "kind",
    "minutes",
    "repetitions",
    "questionnaire",
    "object",
    "action",
    *TEXTS,
)
BLOCK_KEYS = ("objects", "each", "begin_object", "end_object")
PLACES = ("object", "action", "how")
"""Names in braces that a text may hold where an object and an action are known."""
MOST_MINUTES, MOST_REPETITIONS, MOST_PARTS = 600, 100, 1000


@dataclass(frozen=True)
class Part:
    """One row of the protocol, such as "show a video", with all its texts filled in.

    step: its number on the card; None for a questionnaire. tasks: repetitions of one trial. first,
    last: reminders for the room before and after it, such as its video.
    """

    step: int | None
    title: str
    kind: str
    minutes: float
    say: str = ""
    show: str = ""
    hand_over: str = ""
    task: Task | None = None
    repetitions: int = 0
    questionnaire: str = ""
    first: str = ""
    last: str = ""


@dataclass(frozen=True)
class StudyCard:
    """A whole card. last_step: the highest number of a step. mass_g: of objects of its own."""

    name: str
    text: str
    title: str
    about: str
    before: tuple[str, ...]
    parts: tuple[Part, ...]
    first_step: int
    mass_g: dict[str, float]

    @property
    def sha256(self) -> str:
        """Of the card's text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def last_step(self) -> int:
        """The highest number of a step."""
        return max(part.step for part in self.parts if part.step is not None)

    @property
    def minutes(self) -> float:
        """Of all its parts together."""
        return sum(part.minutes for part in self.parts)

    def minutes_after(self, number: int) -> float:
        """Planned minutes of the parts after part `number`, from 0."""
        return sum(part.minutes for part in self.parts[number + 1 :])

    def protocol(self) -> Protocol:
        """Its trials, as the recorder reads them."""
        tasks = [
            part.task
            for part in self.parts
            if part.task
            for _ in range(part.repetitions)
        ]
        return Protocol(self.name, self.text, tuple(tasks), self.mass_g)


def read_study(name: str | Path) -> StudyCard:
    """Read a card by its path, or a shipped one by its name. Raises CardError, DataNotFound."""
    path = found(str(name), CARDS, "protocol card")
    text, raw = read_toml(path)
    return _StudyReader(path).card(raw, text)


class _StudyReader(CardReader):
    """Checks one card; an error names the row, as steps[3] (from 1), and what is allowed."""

    def card(self, raw: Json, text: str) -> StudyCard:
        self.require_known(raw, SECTIONS, "section")
        first = self.whole("first_step", raw.get("first_step", 1), 0, MOST_PARTS)
        self.actions = self.table(raw, "actions")
        self.objects = self.table(raw, "objects")
        for name in self.actions:
            self.action(f"actions.{name}", name)
            self.about_one(
                f"actions.{name}", self.actions[name], ("name", "how", "needs")
            )
        masses = dict(self.masses())
        rows = [
            part
            for k, row in enumerate(self.rows(raw), 1)
            for part in self.step(k, row)
        ]
        rows += [self.questionnaire(name) for name in self.texts(raw, "questionnaires")]
        if len(rows) > MOST_PARTS:
            raise self.refused("steps", len(rows), f"at most {MOST_PARTS} rows in all")
        return StudyCard(
            self.path.stem,
            text,
            self.string("title", raw.get("title", self.path.stem)),
            self.string("about", raw.get("about", "")),
            tuple(self.texts(raw, "before")),
            tuple(self.numbered(rows, first)),
            first,
            masses,
        )

    def rows(self, raw: Json) -> list[Json]:
        rows = raw.get("steps")
        if (
            not isinstance(rows, list)
            or not rows
            or not all(isinstance(row, dict) for row in rows)
        ):
            raise self.refused("steps", rows, "at least one [[steps]] with a kind")
        return rows

    def numbered(self, rows: list[Part], first: int) -> Iterator[Part]:
        """The rows with their step's number: questions belong to the step before."""
        number = first - 1
        if rows[0].kind in (QUESTIONS, QUESTIONNAIRE):
            raise self.refused(
                "steps[1].kind", rows[0].kind, "a step that it can follow"
            )
        for row in rows:
            number += row.kind not in (QUESTIONS, QUESTIONNAIRE)
            yield replace(row, step=None if row.kind == QUESTIONNAIRE else number)

    def step(self, number: int, row: Json) -> list[Part]:
        key = f"steps[{number}]"
        if "objects" not in row:
            return [self.part(key, row, row.get("object"), row.get("action"))]
        self.require_known(row, BLOCK_KEYS, f"{key}, with objects")
        each = row.get("each")
        if (
            not isinstance(each, list)
            or not each
            or not all(isinstance(one, dict) for one in each)
        ):
            raise self.refused(
                f"{key}.each", each, "at least one [[steps.each]] with a kind"
            )
        names = self.texts(row, "objects", key)
        return [part for name in names for part in self.of_object(key, row, each, name)]

    def of_object(self, key: str, row: Json, each: list[Json], name: str) -> list[Part]:
        """The rows of one object: all of `each` for each of its actions."""
        actions = self.objects.get(name, {}).get("actions")
        if not actions:
            raise self.refused(
                f"{key}.objects", name, f'[objects.{name}] with actions = ["pass"]'
            )
        parts = [
            self.part(f"{key}.each[{k}]", one, name, action)
            for action in actions
            for k, one in enumerate(each, 1)
        ]
        begins, ends = (
            self.string(f"{key}.{k}", row.get(k, "")) for k in BLOCK_KEYS[2:]
        )
        parts[0] = replace(parts[0], first=begins)
        parts[-1] = replace(parts[-1], last=ends)
        return parts

    def part(self, key: str, row: Json, thing: Any, action: Any) -> Part:
        self.require_known(row, ROW_KEYS, key)
        kind = row.get("kind")
        if not isinstance(kind, str) or kind not in KINDS:
            raise self.refused(f"{key}.kind", kind, ", ".join(KINDS))
        if kind == QUESTIONNAIRE:
            return self.questionnaire(row.get("questionnaire"), f"{key}.questionnaire")
        task = self.task(key, kind, thing, action)
        named = self.named(thing, action)
        texts = {
            name: self.filled(f"{key}.{name}", row.get(name, ""), named)
            for name in TEXTS
        }
        about = ", ".join(filter(None, (named.get("object"), named.get("action"))))
        title = texts.pop("title") or TITLES.get(kind, kind)
        needs = self.actions.get(action, {}).get("needs", "") if task else ""
        texts["hand_over"] = " and ".join(filter(None, (texts["hand_over"], needs)))
        repetitions = row.get("repetitions", 1 if task else 0)
        if task is None and "repetitions" in row:
            raise self.refused(
                f"{key}.repetitions", repetitions, "only with kind = 'record'"
            )
        minutes = self.number(f"{key}.minutes", row.get("minutes"))
        times = self.whole(
            f"{key}.repetitions", repetitions, int(bool(task)), MOST_REPETITIONS
        )
        whole = f"{title}: {about}" if about else title
        return Part(None, whole, kind, minutes, task=task, repetitions=times, **texts)

    def questionnaire(self, name: Any, key: str = "questionnaires") -> Part:
        """A questionnaire takes no planned time: it is not part of the protocol's minutes."""
        if not isinstance(name, str) or not (
            name in names_in(QUESTIONNAIRES) or Path(name).is_file()
        ):
            allowed = f"{', '.join(names_in(QUESTIONNAIRES))}, or a TOML file"
            raise self.refused(key, name, allowed)
        return Part(
            None,
            f"Questionnaire: {Path(name).stem}",
            QUESTIONNAIRE,
            0.0,
            questionnaire=name,
        )

    # -- one value

    def task(self, key: str, kind: str, thing: Any, action: Any) -> Task | None:
        if kind != RECORD:
            return None
        if action == NOTHING and thing is None:
            return Task(NOTHING, NOTHING)
        self.action(f"{key}.action", action)
        return Task(self.thing(f"{key}.object", thing), action)

    def action(self, key: str, value: Any) -> str:
        if not isinstance(value, str) or value not in ACTIONS:
            raise self.refused(key, value, ", ".join(ACTIONS))
        return value

    def thing(self, key: str, value: Any) -> str:
        if not isinstance(value, str) or not WORD.fullmatch(value) or len(value) > 24:
            raise self.refused(key, value, "up to 24 letters, digits and dashes")
        return value

    def named(self, thing: Any, action: Any) -> dict[str, str]:
        """Texts for PLACES; none of them where a row has no object."""
        of_action = self.actions.get(action, {}) if isinstance(action, str) else {}
        of_object = self.objects.get(thing, {}) if isinstance(thing, str) else {}
        values = (
            of_object.get("name", thing),
            of_action.get("name", action),
            of_action.get("how", ""),
        )
        return {
            key: str(value) for key, value in zip(PLACES, values, strict=True) if value
        }

    def masses(self) -> Iterator[tuple[str, float]]:
        for name, table in self.objects.items():
            key = f"objects.{name}"
            self.thing(key, name)
            self.about_one(key, table, ("name",), ("actions", "mass_g"))
            for action in self.texts(table, "actions", key):
                self.action(f"{key}.actions", action)
            if "mass_g" in table:
                yield (
                    name,
                    self.number(f"{key}.mass_g", table["mass_g"], 100_000.0, "grams"),
                )

    def about_one(
        self, key: str, table: Any, texts: tuple[str, ...], more: tuple[str, ...] = ()
    ) -> None:
        """Check the table of an object or an action."""
        self.require_known(self.require_table(key, table), (*texts, *more), key)
        for name in texts:
            self.string(f"{key}.{name}", table.get(name, ""))

    def string(self, key: str, value: Any) -> str:
        if not isinstance(value, str):
            raise self.refused(key, value, "a text in quotes")
        return " ".join(value.split())

    def texts(self, table: Json, name: str, key: str = "") -> list[str]:
        values = table.get(name, [])
        if not isinstance(values, list) or not all(
            isinstance(one, str) for one in values
        ):
            raise self.refused(
                f"{key}.{name}".lstrip("."), values, "a list of texts in quotes"
            )
        return values

    def filled(self, key: str, value: Any, named: dict[str, str]) -> str:
        """A text with its places filled."""
        text = self.string(key, value)
        try:
            used = [
                place
                for _, place, _, _ in string.Formatter().parse(text)
                if place is not None
            ]
        except ValueError:
            raise self.refused(
                key, text, "braces in pairs, around object, action or how"
            ) from None
        for place in used:
            if place not in named:
                known = (
                    ", ".join(f"{{{name}}}" for name in named)
                    or "no {..} without an object"
                )
                known += (
                    "; {how} where [actions.NAME] has a how" if place == "how" else ""
                )
                raise self.refused(key, f"{{{place}}}", known)
        return text.format(**named)

    def number(
        self, key: str, value: Any, most: float = MOST_MINUTES, what: str = "minutes"
    ) -> float:
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not 0 < value <= most
        ):
            raise self.refused(
                key, value, f"{what}, a number above 0 and at most {most:g}"
            )
        return float(value)

    def whole(self, key: str, value: Any, least: int, most: int) -> int:
        if (
            isinstance(value, bool)
            or not isinstance(value, int)
            or not least <= value <= most
        ):
            raise self.refused(key, value, f"a whole number from {least} to {most}")
        return value
