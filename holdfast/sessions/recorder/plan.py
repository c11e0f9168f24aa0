"""What a run of the recorder is asked to do: its options and its protocol.

A recording protocol (TOML) says which objects, which actions, how often; keys as in a scene.

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
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any

import msgspec

from holdfast.core.errors import DataNotFound
from holdfast.core.schema import read, text_of
from holdfast.core.trial_layout import LONGEST_NAME, NAME, SITUATION_OF_ACTION
from holdfast.sessions.camera import CameraOptions

ACTIONS = tuple(SITUATION_OF_ACTION)
"""Of scenes and of training too: a folder of trials is named after its action."""
NOTHING = "nothing"
MOST_TRIALS = 10_000
"""Beyond it a count is a slip of the key."""
Mass = Annotated[float, msgspec.Meta(gt=0.0, le=100_000.0)]
"""Grams, up to a hundred kilograms: beyond it the mass was not meant in grams."""
RATE_HZ = 150.0
"""Of a hand, where --rate gives none; the shipped model's rate."""


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


class PlanRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A row of a protocol: trials of each of its objects, none for the empty hand."""

    action: str
    objects: tuple[str, ...] = ()
    style: str = ""
    count: Annotated[int, msgspec.Meta(ge=1, le=MOST_TRIALS)] = 1

    def __post_init__(self) -> None:
        require_action(self.action)
        for name in self.objects:
            require_name(name)
        if bool(self.objects) == (self.action == NOTHING):
            allowed = "a list of objects, and none for the action nothing"
            raise ValueError(f"objects = {list(self.objects)}; allowed: {allowed}")

    def tasks(self) -> list[Task]:
        """Its trials, in whole rounds of all objects."""
        names = self.objects or (NOTHING,)
        return [Task(name, self.action, self.style) for name in names] * self.count


class ObjectMass(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a protocol says of an object."""

    mass_g: Mass


class ProtocolCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file. effects: of a simulated hand, so that one file may serve both."""

    trials: Annotated[tuple[PlanRow, ...], msgspec.Meta(min_length=1)]
    title: str = ""
    about: str = ""
    objects: dict[str, ObjectMass] = {}
    effects: dict[str, Any] = {}

    def __post_init__(self) -> None:
        for name in self.objects:
            require_name(name)


def require_action(word: str) -> None:
    """Raise ValueError for a word that is not one of ACTIONS."""
    if word not in ACTIONS:
        raise ValueError(f"action = {word!r}; allowed: {', '.join(ACTIONS)}")


def require_name(word: str) -> None:
    """Raise ValueError for a word that may not become an object's folder."""
    if not NAME.fullmatch(word) or len(word) > LONGEST_NAME or word == NOTHING:
        allowed = f"up to {LONGEST_NAME} letters, digits and dashes"
        raise ValueError(f"object = {word[:40]!r}; allowed: {allowed}")


def read_protocol(path: Path) -> Protocol:
    """Read and check a recording protocol. Raises CardError, DataNotFound."""
    try:
        card = read(path, ProtocolCard)
    except FileNotFoundError:
        raise DataNotFound(
            "no such protocol",
            where=path,
            next_step="docs/recording-and-study.md shows one",
        ) from None
    tasks: list[Task] = []
    for row in card.trials:
        tasks += row.tasks()
    mass_g = {name: one.mass_g for name, one in card.objects.items()}
    return Protocol(path.stem, text_of(path), tuple(tasks), mass_g)


# -- a run


@dataclass(frozen=True)
class RecordOptions(CameraOptions):
    """The options of a run and of its camera, by the names under which meta.json lists them.

    seconds: length of a trial; None: until a key. at_once: begin a trial without a key. protocol:
    a path, or the name of a study's protocol. rate: Hz, of a hand. hand: the name or path of its
    hand card.
    """

    source: str
    out: Path
    person: str
    calibration: Path | None = None
    protocol: Path | str | None = None
    object: str | None = None
    action: str | None = None
    seed: int = 0
    rate: float = RATE_HZ
    anyway: bool = False
    seconds: float | None = None
    trials: int | None = None
    at_once: bool = False
    intent: str | None = None
    hand: str | None = None

    @classmethod
    def of(cls, args: Any) -> RecordOptions:
        """From the words on a command line, of which a field has the name."""
        given = vars(args)
        values = {one.name: given[one.name] for one in fields(cls) if one.name in given}
        return cls(**values | {"intent": args.wearer})

    @property
    def only_a_key_ends(self) -> bool:
        """Whether a trial goes on until a key is pressed: a hand has no end of its own."""
        # not at the top: it loads numpy, which the help of a command does not need
        from holdfast.live.sources import is_hand

        return self.seconds is None and is_hand(self.source)
