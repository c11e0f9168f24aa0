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

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from holdfast.core.errors import CardError, DataNotFound
from holdfast.core.schema import checked, read, text_of
from holdfast.sessions.recorder.plan import (
    Mass,
    PlanRow,
    Protocol,
    Task,
    require_action,
    require_name,
)
from holdfast.sessions.study import PROTOCOLS, shipped_protocols

Kind = Literal["say", "mount", "video", "questions", "record"]
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
    """One row, or with `objects` its rows `each` for every object and each of its actions.

    minutes: up to a working day and more. title, say, show, hand_over: texts in which braces are
    filled in. begin_object, end_object: for the room, before an object's rows and after them.
    """

    kind: Kind = "say"
    minutes: Annotated[float, msgspec.Meta(gt=0.0, le=600.0)] = 1.0
    repetitions: Annotated[int, msgspec.Meta(ge=1, le=100)] = 1
    object: str | None = None
    action: str | None = None
    title: str = ""
    say: str = ""
    show: str = ""
    hand_over: str = ""
    objects: tuple[str, ...] = ()
    each: tuple[StudyRow, ...] = ()
    begin_object: str = ""
    end_object: str = ""

    def __post_init__(self) -> None:
        if bool(self.objects) != bool(self.each):
            allowed = "objects together with [[steps.each]]"
            raise ValueError(f"objects = {list(self.objects)}; allowed: {allowed}")


class StudyCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A study's file as it is written: its steps and its title."""

    steps: Annotated[tuple[StudyRow, ...], msgspec.Meta(min_length=1)]
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
        if self.steps[0].kind == QUESTIONS:
            raise ValueError("steps[0].kind = 'questions'; allowed: after a step")
        for name in {name for row in self.steps for name in row.objects}:
            if not self.objects.get(name, StudyObject()).actions:
                allowed = f'[objects.{name}] with actions = ["pass"]'
                raise ValueError(f"objects = {name!r}; allowed: {allowed}")


@dataclass(frozen=True)
class StudyPart:
    """One row of the protocol, such as "show a video", with all its texts filled in.

    step: its number; questions have that of the step before. task, repetitions: of a trial.
    room_before, room_after: reminders for the room, such as its video.
    """

    step: int
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
class StudyProtocol(Protocol):
    """A whole study protocol; its trials are those that the recorder reads."""

    title: str
    before: tuple[str, ...]
    parts: list[StudyPart]
    first_step: int

    @property
    def last_step(self) -> int:
        """The highest number of a step."""
        return self.parts[-1].step

    @property
    def minutes(self) -> float:
        """Of all its parts together."""
        return sum(part.minutes for part in self.parts)

    def listing(self) -> list[str]:
        """The protocol as lines: step, minutes, title; and the sum."""
        lines = [self.title]
        for line in self.before:
            lines.append(f"before: {line}")

        for part in self.parts:
            times = f" x {part.repetitions}" if part.task else ""
            lines.append(f"{part.step:>4} {part.minutes:>5g} min  {part.title}{times}")

        steps = f"steps {self.first_step} to {self.last_step}"
        return [*lines, f"{steps}, {self.minutes:g} minutes"]


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
    parts = _Parts(path, card).all()
    tasks: list[Task] = []
    for part in parts:
        if part.task:
            tasks += [part.task] * part.repetitions
    return StudyProtocol(
        name=path.stem,
        text=text_of(path),
        tasks=tuple(tasks),
        mass_g=mass_g,
        title=card.title or path.stem,
        before=card.before,
        parts=parts,
        first_step=card.first_step,
    )


class _Parts:
    """Makes the parts of a card's rows; an error names the row, as steps[3] (from 0)."""

    def __init__(self, path: Path, card: StudyCard) -> None:
        self.path = path
        self.card = card
        self.step = card.first_step - 1

    def all(self) -> list[StudyPart]:
        """All parts in order, with the number of their step."""
        parts: list[StudyPart] = []
        for number, row in enumerate(self.card.steps):
            place = f"{self.path}: steps[{number}]"
            if not row.objects:
                parts.append(self.part(row, row.object, row.action, place))
            for name in row.objects:
                of_object = []
                for action in self.card.objects[name].actions:
                    for each in row.each:
                        of_object.append(self.part(each, name, action, place))
                # The room is told once an object: a video runs over all of its rows.
                of_object[0] = replace(of_object[0], room_before=row.begin_object)
                of_object[-1] = replace(of_object[-1], room_after=row.end_object)
                parts += of_object
        return parts

    def part(
        self, row: StudyRow, name: str | None, action: str | None, place: str
    ) -> StudyPart:
        """One part; name, action: of its object, None where the row has none."""
        if row.kind != QUESTIONS:
            self.step += 1
        of_object = self.card.objects.get(name or "", StudyObject())
        of_action = self.card.actions.get(action or "", StudyAction())
        names = {
            "object": of_object.name or name,
            "action": of_action.name or action,
            "how": of_action.how,
        }
        # A place without a word is an error of the text that has it.
        words = {place: word for place, word in names.items() if word}
        # "Testing: soft ball, pass" keeps two rows of one block apart.
        about = joined(", ", (names["object"], names["action"]))
        title = _filled(row.title, words, place) or row.kind.capitalize()
        task = None
        needs = ""
        if row.kind == RECORD:
            objects = [] if name is None else [name]
            trials = {"objects": objects, "action": action}
            task = checked(trials, PlanRow, place).tasks()[0]
            # What an action needs, such as a box, is handed over together with the object.
            needs = of_action.needs
        return StudyPart(
            step=self.step,
            title=joined(": ", (title, about)),
            kind=row.kind,
            minutes=row.minutes,
            say=_filled(row.say, words, place),
            show=_filled(row.show, words, place),
            hand_over=joined(" and ", (_filled(row.hand_over, words, place), needs)),
            task=task,
            repetitions=row.repetitions if task else 0,
        )


def _filled(text: str, words: dict[str, str], place: str) -> str:
    """A text on one line, with the words in place of its braces. Raises CardError."""
    try:
        return " ".join(text.format(**words).split())
    except (KeyError, ValueError, IndexError, AttributeError):
        known = ", ".join(words) or "nothing without an object"
        # A misspelt place would be read out as it stands, so it is refused.
        raise CardError(
            f"{text!r}", where=place, next_step=f"allowed in braces: {known}"
        ) from None


def joined(separator: str, texts: Iterable[str | None]) -> str:
    """The texts that are not empty, with a separator between them."""
    return separator.join(text for text in texts if text)
