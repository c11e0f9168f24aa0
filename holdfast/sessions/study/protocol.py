"""A study protocol (TOML): its steps in order, each with minutes and what the operator reads out.

    title = "One object, two actions"

    [objects.soft-ball]
    name = "soft ball"
    actions = ["pass", "pull"]

    [[steps]]
    title = "Welcome"
    kind = "say"                      # say, mount, video, questions, record
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

A row of the kind `questions` belongs to the step before it. All
others are counted from first_step (1). Protocols that ship are found by name.
"""

from __future__ import annotations

import hashlib
import string
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import DataNotFound
from holdfast.core.reading import read_toml
from holdfast.sessions.recorder.protocol import (
    NOTHING,
    Protocol,
    ProtocolReader,
    Task,
    is_list_of,
)

if TYPE_CHECKING:
    from holdfast.core.contract import Json

PROTOCOLS = Path(__file__).with_name("protocols")
"""Folder of the study protocols that ship."""
SAY = "say"
MOUNT = "mount"
VIDEO = "video"
QUESTIONS = "questions"
RECORD = "record"
KINDS = (SAY, MOUNT, VIDEO, QUESTIONS, RECORD)
TITLES = {
    SAY: SAY,
    MOUNT: "Mounting",
    VIDEO: "Video",
    QUESTIONS: "Questions",
    RECORD: "Recording",
}
"""Of a row without a title, by its kind."""
OPTIONAL_SECTIONS = ("title", "about", "before", "first_step")
SECTIONS = (*OPTIONAL_SECTIONS, "actions", "objects", "steps")
TEXTS = ("title", "say", "show", "hand_over")
"""Texts of a row, in which braces are filled in."""
CHOICES = ("kind", "minutes", "repetitions", "object", "action")
ROW_KEYS = (*CHOICES, *TEXTS)
BLOCK_KEYS = ("objects", "each", "begin_object", "end_object")
MOST_MINUTES = 600.0
"""Of one row: a working day and more."""
MOST_REPETITIONS = 100
MOST_PARTS = 1000
"""Rows of all blocks together."""


def names_in(folder: Path) -> list[str]:
    """Names of the shipped files in PROTOCOLS or FORMS, sorted."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def shipped_or_own(name: str, folder: Path, what: str) -> Path:
    """A file by its path, or a shipped one by its name. Raises DataNotFound."""
    path = Path(name)
    if path.is_file():
        return path

    names = names_in(folder)
    if name in names:
        return folder / f"{name}.toml"

    raise DataNotFound(
        f"no such {what}",
        where=name,
        cause="a name misspelt, or a path from another folder",
        next_step=f"give a TOML file, or one of {', '.join(names)}",
    )


@dataclass(frozen=True)
class StudyPart:
    """One row of the protocol, such as "show a video", with all its texts filled in.

    step: its number; None for questions. task, repetitions: of a trial. room_before,
    room_after: reminders for the room, such as its video.
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
    room_before: str = ""
    room_after: str = ""

    @property
    def has_number(self) -> bool:
        """Whether it is a step of its own."""
        return self.kind != QUESTIONS


@dataclass(frozen=True)
class StudyProtocol:
    """A whole study protocol. mass_g: of objects that it defines."""

    name: str
    text: str
    title: str
    before: list[str]
    parts: list[StudyPart]
    first_step: int
    mass_g: dict[str, float]

    @property
    def sha256(self) -> str:
        """Of the file's text."""
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

    def listing(self) -> list[str]:
        """The protocol as lines: step, minutes, title; and the sum."""
        lines = [self.title]
        for line in self.before:
            lines.append(f"before: {line}")

        for part in self.parts:
            number = "" if part.step is None else str(part.step)
            title = part.title
            if part.repetitions:
                title += f" x {part.repetitions}"
            lines.append(f"{number:>4} {part.minutes:>5g} min  {title}")

        steps = f"steps {self.first_step} to {self.last_step}"
        return [*lines, f"{steps}, {self.minutes:g} minutes"]

    def recording_protocol(self) -> Protocol:
        """Its trials, as the recorder reads them."""
        tasks: list[Task] = []
        for part in self.parts:
            if part.task:
                tasks += [part.task] * part.repetitions
        return Protocol(self.name, self.text, tuple(tasks), self.mass_g)


def read_study(name: str | Path) -> StudyProtocol:
    """Read a protocol by its path, or a shipped one by its name. Raises CardError, DataNotFound."""
    path = shipped_or_own(str(name), PROTOCOLS, "study protocol")
    text, raw = read_toml(path)
    return _StudyReader(path, raw).protocol(text)


class _StudyReader(ProtocolReader):
    """Checks one protocol; an error names the row, as steps[3] (from 1), and what is allowed."""

    def __init__(self, path: Path, raw: Json) -> None:
        super().__init__(path)
        self.require_known(raw, SECTIONS, "section")
        self.raw = raw
        self.actions = self.table(raw, "actions")
        self.objects = self.table(raw, "objects")

    def protocol(self, text: str) -> StudyProtocol:
        raw = self.raw
        name = self.path.stem
        first_step = raw.get("first_step", 1)
        first_step = self.whole_number("first_step", first_step, 0, MOST_PARTS)
        self.check_actions()
        mass_g = self.check_objects()
        self.text("about", raw.get("about", ""))
        parts: list[StudyPart] = []
        allowed = "at least one [[steps]] with a kind"
        rows = self.rows("steps", raw.get("steps"), allowed)

        for number, row in enumerate(rows, 1):
            parts += self.parts(f"steps[{number}]", row)

        if len(parts) > MOST_PARTS:
            allowed = f"at most {MOST_PARTS} rows in all"
            raise self.refused("steps", len(parts), allowed)

        return StudyProtocol(
            name=name,
            text=text,
            title=self.text("title", raw.get("title", name)),
            before=self.texts("before", raw),
            parts=self.numbered(parts, first_step),
            first_step=first_step,
            mass_g=mass_g,
        )

    # -- sections

    def check_actions(self) -> None:
        for name, table in self.actions.items():
            key = f"actions.{name}"
            self.action(key, name)
            self.require_table(key, table)
            self.require_known(table, ("name", "how", "needs"), key)
            for word, value in table.items():
                self.text(f"{key}.{word}", value)

    def check_objects(self) -> dict[str, float]:
        """Check them all; returns the masses that are given."""
        mass_g = {}
        for name, table in self.objects.items():
            key = f"objects.{name}"
            self.object_name(key, name)
            self.require_table(key, table)
            self.require_known(table, ("name", "actions", "mass_g"), key)
            self.text(f"{key}.name", table.get("name", ""))
            for action in self.texts("actions", table, f"{key}."):
                self.action(f"{key}.actions", action)
            if "mass_g" in table:
                mass_g[name] = self.mass_g(f"{key}.mass_g", table["mass_g"])

        return mass_g

    def numbered(self, parts: list[StudyPart], first_step: int) -> list[StudyPart]:
        """The rows with their step's number: questions belong to the step before."""
        if not parts[0].has_number:
            allowed = "a step that it can follow"
            raise self.refused("steps[1].kind", parts[0].kind, allowed)

        numbered = []
        number = first_step - 1

        for part in parts:
            # True counts as one.
            number += part.has_number
            numbered.append(replace(part, step=number))

        return numbered

    # -- rows

    def parts(self, key: str, row: Json) -> list[StudyPart]:
        """The parts of one row, or of all objects that it names."""
        if "objects" not in row:
            name = row.get("object")
            action = row.get("action")
            return [self.part(key, row, name, action)]

        self.require_known(row, BLOCK_KEYS, f"{key}, with objects")
        allowed = "at least one [[steps.each]] with a kind"
        each = self.rows(f"{key}.each", row.get("each"), allowed)
        # Said before the first row of an object, and after its last.
        begins = self.text(f"{key}.begin_object", row.get("begin_object", ""))
        ends = self.text(f"{key}.end_object", row.get("end_object", ""))

        parts: list[StudyPart] = []
        for name in self.texts("objects", row, f"{key}."):
            # The room is told once an object: a video runs over all of its rows.
            of_object = self.parts_of_object(key, each, name)
            of_object[0] = replace(of_object[0], room_before=begins)
            of_object[-1] = replace(of_object[-1], room_after=ends)
            parts += of_object

        return parts

    def parts_of_object(self, key: str, each: list[Json], name: str) -> list[StudyPart]:
        """The rows of one object: all of `each` for each of its actions."""
        actions = self.objects.get(name, {}).get("actions")
        if not actions:
            allowed = f'[objects.{name}] with actions = ["pass"]'
            raise self.refused(f"{key}.objects", name, allowed)

        parts = []
        for action in actions:
            for k, row in enumerate(each, 1):
                place = f"{key}.each[{k}]"
                parts.append(self.part(place, row, name, action))

        return parts

    def part(self, key: str, row: Json, name: Any, action: Any) -> StudyPart:
        """One part; name, action: of its object, None where the row has none."""
        self.require_known(row, ROW_KEYS, key)
        kind = row.get("kind")
        if kind not in KINDS:
            raise self.refused(f"{key}.kind", kind, ", ".join(KINDS))

        task = None
        repetitions = 0
        needs = ""
        if kind == RECORD:
            task = self.task(key, name, action)
            times = row.get("repetitions", 1)
            counted = f"{key}.repetitions"
            repetitions = self.whole_number(counted, times, 1, MOST_REPETITIONS)
            # What an action needs, such as a box, is handed over together with the object.
            needs = self.actions.get(task.action, {}).get("needs", "")
        elif "repetitions" in row:
            allowed = "only with kind = 'record'"
            raise self.refused(f"{key}.repetitions", row["repetitions"], allowed)

        words = self.words(name, action)
        texts = {}
        for text in TEXTS:
            given = row.get(text, "")
            texts[text] = self.filled(f"{key}.{text}", given, words)

        minutes = row.get("minutes")
        minutes = self.positive(f"{key}.minutes", minutes, MOST_MINUTES, "minutes")
        title = texts["title"] or TITLES[kind]
        # "Testing: soft ball, pass" tells two rows of one block apart.
        about = joined(", ", (words.get("object"), words.get("action")))

        return StudyPart(
            step=None,
            title=joined(": ", (title, about)),
            kind=kind,
            minutes=minutes,
            say=texts["say"],
            show=texts["show"],
            hand_over=joined(" and ", (texts["hand_over"], needs)),
            task=task,
            repetitions=repetitions,
        )

    def task(self, key: str, name: Any, action: Any) -> Task:
        # The empty hand is a task without an object.
        if action == NOTHING and name is None:
            return Task(NOTHING, NOTHING)
        action = self.action(f"{key}.action", action)
        return Task(self.object_name(f"{key}.object", name), action)

    # -- texts

    def words(self, name: Any, action: Any) -> dict[str, str]:
        """What stands in a text for {object}, {action} and {how}, where that is known."""
        of_object = self.objects.get(name, {}) if isinstance(name, str) else {}
        of_action = self.actions.get(action, {}) if isinstance(action, str) else {}
        words = {
            "object": of_object.get("name", name),
            "action": of_action.get("name", action),
            "how": of_action.get("how"),
        }
        # A place without a word is an error of the text that has it.
        return {place: str(word) for place, word in words.items() if word}

    def texts(self, name: str, table: Json, within: str = "") -> list[str]:
        """A list of texts, empty where the table has none."""
        values = table.get(name, [])
        if not is_list_of(values, str):
            raise self.refused(within + name, values, "a list of texts in quotes")
        return list(values)

    def filled(self, key: str, value: Any, words: dict[str, str]) -> str:
        """A text with the words in place of its braces."""
        text = self.text(key, value)
        try:
            fields = list(string.Formatter().parse(text))
        except ValueError:
            allowed = "braces in pairs, around object, action or how"
            raise self.refused(key, text, allowed) from None

        # A misspelt place would be read out as it stands, so it is refused.
        for _, place, _, _ in fields:
            if place is not None and place not in words:
                known = [f"{{{word}}}" for word in words]
                allowed = ", ".join(known) or "no {..} without an object"
                if place == "how":
                    allowed += "; {how} where [actions.NAME] has a how"
                raise self.refused(key, f"{{{place}}}", allowed)

        return text.format(**words)


def joined(separator: str, texts: Iterable[str | None]) -> str:
    """The texts that are not empty, with a separator between them."""
    return separator.join(text for text in texts if text)
