"""What a run of the recorder was asked to do: its options, and the trials that follow from them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from holdfast.core.errors import UsageError
from holdfast.core.trial_layout import checked_name
from holdfast.live.sources import is_hand
from holdfast.sessions.camera import CameraOptions
from holdfast.sessions.recorder.folder import done
from holdfast.sessions.recorder.keys import Keys
from holdfast.sessions.recorder.protocol import (
    NOTHING,
    Protocol,
    Task,
    read_protocol,
    tasks_left,
)

ENDLESS = 100_000
"""Trials where --trials sets no number: more than anyone records."""
NO_CAMERA = CameraOptions()
RATE_HZ = 150.0
"""Of a hand, where --rate gives none; the shipped model's rate."""


@dataclass(frozen=True)
class RecordOptions:
    """The options of a run, by the names under which meta.json lists them.

    seconds: length of a trial; None: until a key. at_once: begin a trial without a key. protocol:
    a path, or the name of a study's protocol. rate: Hz, of a hand. hand: the name or path of its
    hand card.
    """

    source: str
    out: Path
    person: str
    camera: CameraOptions = NO_CAMERA
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
        camera = CameraOptions(args.camera, args.tag_mm, args.fps, args.exposure_ms)
        given = {}
        for field in fields(cls):
            if hasattr(args, field.name):
                given[field.name] = getattr(args, field.name)
        return cls(**given | {"camera": camera, "intent": args.wearer})

    @property
    def only_a_key_ends(self) -> bool:
        """Whether a trial goes on until a key is pressed: a hand has no end of its own."""
        return self.seconds is None and is_hand(self.source)


@dataclass(frozen=True)
class Plan:
    """Trials of a protocol, or one object and action repeatedly.

    done: trials of it that were kept before.
    """

    protocol: Protocol | None
    tasks: list[Task]
    done: int

    @property
    def mass_g(self) -> dict[str, float]:
        """Masses that the protocol gives, by object."""
        return self.protocol.mass_g if self.protocol else {}


def planned(options: RecordOptions) -> Plan:
    """The tasks that are left. Raises UsageError, CardError."""
    trials = options.trials
    name = options.object
    action = options.action
    before = done(options.out, options.person)
    if options.protocol is not None and name is None and action is None:
        protocol = read_protocol(Path(options.protocol))
        ordered = protocol.ordered(options.seed, options.person)
        # The order is drawn for the whole protocol, so a second run continues the first one's.
        tasks = tasks_left(ordered, before)
        return Plan(protocol, tasks[:trials], len(ordered) - len(tasks))

    # The empty hand holds no object.
    goes_together = (name is None) == (action == NOTHING)
    if options.protocol is not None or action is None or not goes_together:
        raise UsageError(
            "no trials given: --protocol alone, or --object and --action",
            next_step="--protocol PROTOCOL, or --object soft-ball --action pull",
        )
    task = Task(checked_name(name, "object") if name else NOTHING, action)
    count = ENDLESS if trials is None else trials
    return Plan(None, [task] * count, before.count(task))


def require_keys(options: RecordOptions, plan: Plan, keys: Keys) -> None:
    """Raise UsageError where a trial of the plan needs a key and none can be pressed."""
    missing = {}
    if not options.at_once:
        missing["begins"] = "--at-once"
    if options.only_a_key_ends:
        missing["ends"] = "--seconds 8"
    if plan.tasks and missing and keys.ended():
        raise UsageError(
            f"only a key {' and '.join(missing)} a trial, and no key can be pressed",
            cause="standard input is at its end (</dev/null) or is the source, or the program is "
            "in the background",
            next_step=f"run it in a terminal, or add {' '.join(missing.values())}",
        )
