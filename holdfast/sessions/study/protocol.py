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
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import msgspec

from holdfast.core.errors import CardError, DataNotFound
from holdfast.core.schema import checked, read, text_of
from holdfast.sessions.recorder.protocol import (
    Mass,
    Protocol,
    Task,
    TrialsRow,
    require_action,
    require_name,
)

PROTOCOLS = Path(__file__).with_name("protocols")
"""Folder of the study protocols that ship."""
Kind = Literal["say", "mount", "video", "questions", "record"]
KINDS: tuple[Kind, ...] = get_args(Kind)
QUESTIONS, RECORD = "questions", "record"


class StudyAction(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How an action is called and done. needs: is handed over together with the object."""

    name: str = ""
    how: str = ""
    needs: str = ""


class StudyObject(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How an object is called, and the actions that a block repeats for it."""

    name: str = ""
    actions: tuple[str, ...] = ()
    mass_g: Mass | None = None

    def __post_init__(self) -> None:
        for action in self.actions:
            require_action(action)


class StudyRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One row. title, say, show, hand_over: texts in which braces are filled in.

    minutes: up to a working day and more. repetitions: of a recording, 1 where none are given.
    """

    kind: Kind
    minutes: Annotated[float, msgspec.Meta(gt=0.0, le=600.0)]
    repetitions: Annotated[int, msgspec.Meta(ge=1, le=100)] | None = None
    object: str | None = None
    action: str | None = None
    title: str = ""
    say: str = ""
    show: str = ""
    hand_over: str = ""

    def __post_init__(self) -> None:
        if self.repetitions is not None and self.kind != RECORD:
            allowed = "only with kind = 'record'"
            raise ValueError(f"repetitions = {self.repetitions}; allowed: {allowed}")


class StudyBlock(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rows of `each` for every object and each of its actions.

    begin_object, end_object: for the room, before an object's first row and after its last.
    """

    objects: tuple[str, ...]
    each: Annotated[tuple[StudyRow, ...], msgspec.Meta(min_length=1)]
    begin_object: str = ""
    end_object: str = ""


class StudyCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file. steps: a StudyBlock where a row names objects, else a StudyRow."""

    steps: Annotated[tuple[dict[str, Any], ...], msgspec.Meta(min_length=1)]
    title: str = ""
    about: str = ""
    before: tuple[str, ...] = ()
    first_step: Annotated[int, msgspec.Meta(ge=0, le=1000)] = 1
    actions: dict[str, StudyAction] = {}
    objects: dict[str, StudyObject] = {}

    def __post_init__(self) -> None:
        for action in self.actions:
            require_action(action)
        for name in self.objects:
            require_name(name)


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


def shipped_protocols() -> list[str]:
    """Names of the study protocols that ship, sorted."""
    return sorted(path.stem for path in PROTOCOLS.glob("*.toml"))


def read_study(name: str | Path) -> StudyProtocol:
    """Read a protocol by its path, or a shipped one by its name. Raises CardError, DataNotFound."""
    path = Path(name)
    if not path.is_file():
        path = PROTOCOLS / f"{name}.toml"
    try:
        card = read(path, StudyCard)
    except FileNotFoundError:
        raise DataNotFound(
            "no such study protocol",
            where=str(name),
            cause="a name misspelt, or a path from another folder",
            next_step=f"give a TOML file, or one of {', '.join(shipped_protocols())}",
        ) from None

    mass_g = {}
    for of_object, entry in card.objects.items():
        if entry.mass_g is not None:
            mass_g[of_object] = entry.mass_g
    return StudyProtocol(
        name=path.stem,
        text=text_of(path),
        title=_one_line(card.title) or path.stem,
        before=list(card.before),
        parts=_Rows(path, card).parts(),
        first_step=card.first_step,
        mass_g=mass_g,
    )


@dataclass(frozen=True)
class _Rows:
    """Makes the parts of a card's rows; an error names the row, as steps[3] (from 1)."""

    path: Path
    card: StudyCard

    def parts(self) -> list[StudyPart]:
        """All parts in order, with the number of their step."""
        parts: list[StudyPart] = []
        for number, raw in enumerate(self.card.steps, 1):
            place = f"{self.path}: steps[{number}]"
            if "objects" in raw:
                parts += self.block(checked(raw, StudyBlock, place), place)
            else:
                row = checked(raw, StudyRow, place)
                parts.append(self.part(row, row.object, row.action, place))

        if parts[0].kind == QUESTIONS:
            what = "steps[1].kind = 'questions'"
            raise _refused(self.path, what, "a step that questions can follow")
        return self.numbered(parts)

    def numbered(self, parts: list[StudyPart]) -> list[StudyPart]:
        """The parts with their step's number: questions belong to the step before."""
        numbered = []
        number = self.card.first_step - 1
        for part in parts:
            if part.kind != QUESTIONS:
                number += 1
            numbered.append(replace(part, step=number))
        return numbered

    def block(self, block: StudyBlock, place: str) -> list[StudyPart]:
        """The parts of a block: all its rows for each action of each object."""
        parts: list[StudyPart] = []
        for name in block.objects:
            entry = self.card.objects.get(name, StudyObject())
            if not entry.actions:
                allowed = f'[objects.{name}] with actions = ["pass"]'
                raise _refused(place, f"objects = {name!r}", allowed)
            of_object = []
            for action in entry.actions:
                for k, row in enumerate(block.each):
                    of_row = f"{place}.each[{k}]"
                    of_object.append(self.part(row, name, action, of_row))
            # The room is told once an object: a video runs over all of its rows.
            begins = _one_line(block.begin_object)
            ends = _one_line(block.end_object)
            of_object[0] = replace(of_object[0], room_before=begins)
            of_object[-1] = replace(of_object[-1], room_after=ends)
            parts += of_object

        return parts

    def part(
        self, row: StudyRow, name: str | None, action: str | None, place: str
    ) -> StudyPart:
        """One part, without a number; name, action: of its object, None where the row has none."""
        task = None
        needs = ""
        if row.kind == RECORD:
            task = _task(name, action, place)
            # What an action needs, such as a box, is handed over together with the object.
            needs = self.card.actions.get(task.action, StudyAction()).needs

        words = self.words(name, action)
        title = _filled(row.title, words, place) or row.kind.capitalize()
        # "Testing: soft ball, pass" keeps two rows of one block apart.
        about = joined(", ", (words.get("object"), words.get("action")))
        hand_over = _filled(row.hand_over, words, place)
        return StudyPart(
            step=None,
            title=joined(": ", (title, about)),
            kind=row.kind,
            minutes=row.minutes,
            say=_filled(row.say, words, place),
            show=_filled(row.show, words, place),
            hand_over=joined(" and ", (hand_over, needs)),
            task=task,
            repetitions=(row.repetitions or 1) if task else 0,
        )

    def words(self, name: str | None, action: str | None) -> dict[str, str]:
        """What stands in a text for {object}, {action} and {how}, where that is known."""
        of_object = self.card.objects.get(name or "", StudyObject())
        of_action = self.card.actions.get(action or "", StudyAction())
        words = {
            "object": of_object.name or name,
            "action": of_action.name or action,
            "how": of_action.how,
        }
        # A place without a word is an error of the text that has it.
        return {place: _one_line(word) for place, word in words.items() if word}


def _task(name: str | None, action: str | None, place: str) -> Task:
    """The task of a recording. Raises CardError."""
    objects = [] if name is None else [name]
    row = checked({"objects": objects, "action": action}, TrialsRow, place)
    return row.tasks()[0]


def _one_line(text: str) -> str:
    """A text over several lines of the file as one line of the console."""
    return " ".join(text.split())


def _filled(text: str, words: dict[str, str], place: str) -> str:
    """A text with the words in place of its braces. Raises CardError."""
    try:
        return _one_line(text).format(**words)
    except (KeyError, ValueError, IndexError, AttributeError):
        # A misspelt place would be read out as it stands, so it is refused.
        known = ", ".join(f"{{{word}}}" for word in words)
        allowed = known or "no {..} without an object"
        raise _refused(place, f"{text!r}", f"{allowed}, in pairs of braces") from None


def _refused(where: Path | str, what: str, allowed: str) -> CardError:
    return CardError(what, where=where, next_step=f"allowed: {allowed}")


def joined(separator: str, texts: Iterable[str | None]) -> str:
    """The texts that are not empty, with a separator between them."""
    return separator.join(text for text in texts if text)
