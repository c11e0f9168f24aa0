"""A scene file (TOML): objects, actions and who acts, effects, what is recorded; checked.

    title = "One pull, with a noisy sensor"

    [record]
    rate_hz = 150            # samples a second
    unit = "N"               # or "uT": the field itself, where the scene has a magnet

    [physics]
    step_s = 0.0008          # step where anything can happen; docs/scenes.md shows what it costs

    [every_trial]            # values of all [[trials]] that do not give their own
    used = 0.4               # share of friction that the hold uses (holds.py)

    [[trials]]
    objects = ["soft-ball", "hard-ball"]
    action = "pull"
    style = "author"         # ranges of a style; values given here take precedence
    count = 10               # trials of each object
    hold_s = { uniform = [2, 3] }

    [effects.brush]
    count = 5
    [effects.hall_noise]

    [hand]                   # a hand with other contacts than the default six
    card = "two-pad-gripper" # a hand card by name or path

Only the effects that the file names run.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from holdfast.core.contract import Json, Unit
from holdfast.core.errors import CardError, UsageError
from holdfast.core.hand_card import HandCard, read_hand_card
from holdfast.core.schema import checked, find_card, read, text_of
from holdfast.simulation import SCENES, STYLES
from holdfast.simulation.actions import ACTION_MODULES, EMPTY_HANDED, parameters_of
from holdfast.simulation.effects.effect import (
    EFFECT_MODULES,
    Parameter,
    effect_named,
    step_settings,
)
from holdfast.simulation.physics.objects import (
    HOLD,
    OBJECT_KEYS,
    OBJECTS,
    TOUCH,
    HeldObject,
    hand_of_counts,
    held_object,
)
from holdfast.simulation.scenes.protocol import TrialsRow, least_grip_n

MAX_GRIP_N = 70.0
"""Greatest opposition grip of the Michelangelo hand, N a side (thesis, 5.1.1)."""
ROW_KEYS = {"objects", "action", "style", "count"}
"""Keys of [[trials]] that are no parameters of the action."""
MOST_TRIALS = 100_000
"""Of each object in one [[trials]]."""
Rate = Annotated[float, Meta(ge=40.0, le=10_000.0)]
"""A sampling rate, Hz."""
STEP_S = 0.000834
"""Step where anything can happen, where the file names none."""


class _Record(msgspec.Struct, forbid_unknown_fields=True):
    """The section [record]; join: trials of an object that make one long recording."""

    rate_hz: Rate = 150.0
    unit: Literal["N", "uT"] = "N"
    join: Annotated[int, Meta(ge=1, le=1000)] = 1


class _Physics(msgspec.Struct, forbid_unknown_fields=True):
    """The section [physics] of a scene, checked."""

    step_s: Annotated[float, Meta(ge=1e-6, le=1.0)] = STEP_S


class _Hand(msgspec.Struct, forbid_unknown_fields=True):
    """The section [hand]: a card, else contacts on the thumb and on each of the four fingers."""

    card: str = ""
    thumb: Annotated[int, Meta(ge=2, le=20)] = 2
    finger: Annotated[int, Meta(ge=1, le=20)] = 1


class _Tables(msgspec.Struct, forbid_unknown_fields=True):
    """A whole file; rows of trials, effects and objects are checked against their parameters."""

    trials: Annotated[list[Json], Meta(min_length=1)]
    title: str | None = None
    about: str = ""
    record: _Record = msgspec.field(default_factory=_Record)
    physics: _Physics = msgspec.field(default_factory=_Physics)
    every_trial: Json = msgspec.field(default_factory=dict)
    effects: dict[str, Json] = msgspec.field(default_factory=dict)
    objects: dict[str, Json] = msgspec.field(default_factory=dict)
    hand: _Hand = msgspec.field(default_factory=_Hand)


@dataclass(frozen=True)
class SceneFile:
    """A checked scene file.

    name, title  of the file, for the record of a set
    rate_hz      samples a second
    unit         of the recorded samples
    join         trials of an object that make one long recording
    step_s       step where anything can happen
    rows         the file's [[trials]]
    effects      name -> values, in the order in which they run
    objects      all objects that a trial may name, the shipped ones included
    hand         its contacts and sensors
    text         of the file, as it was read
    """

    name: str
    title: str
    rate_hz: float
    unit: Unit
    join: int
    step_s: float
    rows: tuple[TrialsRow, ...]
    effects: dict[str, Json]
    objects: dict[str, HeldObject]
    hand: HandCard
    text: str

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.text.encode()).hexdigest()


def read_scene_file(name: str, *, rate_hz: float | None = None) -> SceneFile:
    """Read and check a scene by name or path.

    rate_hz replaces the file's rate. Raises CardError, and UsageError for a rate_hz beyond Rate.
    """
    path = find_card(name, SCENES, "scene")
    tables = read(path, _Tables)
    if rate_hz is not None:
        where = "sampling rate, Hz"
        tables.record.rate_hz = checked(rate_hz, Rate, where, UsageError)

    hand = hand_of_counts(tables.hand.thumb, tables.hand.finger)
    if tables.hand.card:
        hand = read_hand_card(tables.hand.card, path.parent)
    try:
        return _scene(tables, path, hand)
    except ValueError as reason:
        what, _, allowed = str(reason).partition("; ")
        raise CardError(what, where=path, next_step=allowed) from None


def _scene(tables: _Tables, path: Path, hand: HandCard) -> SceneFile:
    """The scene of a file's tables, checked against each other. Raises ValueError."""
    objects = dict(OBJECTS)
    for name, values in tables.objects.items():
        _require_possible(f"objects.{name}", values, OBJECT_KEYS, OBJECT_KEYS)
        objects[name] = held_object(name, values)

    styles = tomllib.loads(STYLES.read_text(encoding="utf-8"))
    rows = []
    for k, row in enumerate(tables.trials):
        rows.append(_row(f"trials[{k}]", tables.every_trial | row, objects, styles))

    _require_known(tables.effects, EFFECT_MODULES, "effect")
    for name, values in tables.effects.items():
        effect = effect_named(name)
        # Trials are stepped together, so a constant of the step cannot be drawn for each.
        key = f"effects.{name}"
        _require_possible(key, values, effect.parameters, (effect.constant,))

    record = tables.record
    # The order is that in which effects run, not that of the file.
    in_order = [name for name in EFFECT_MODULES if name in tables.effects]
    scene = SceneFile(
        name=path.stem,
        title=tables.title or path.stem,
        rate_hz=record.rate_hz,
        unit=record.unit,
        join=record.join,
        step_s=tables.physics.step_s,
        rows=tuple(rows),
        effects={name: tables.effects[name] for name in in_order},
        objects=objects,
        hand=hand,
        text=text_of(path),
    )
    _require_effects_fit(scene)
    return scene


def _refused(key: str, value: Any, allowed: str) -> ValueError:
    """The error for a value that a key cannot have."""
    return ValueError(f"{key} = {value!r:.80}; allowed: {allowed}")


def _require_known(names: Collection[str], allowed: Collection[str], what: str) -> None:
    """Raise ValueError for a name that is not among those allowed."""
    for name in names:
        if name not in allowed:
            listed = ", ".join(allowed)
            raise ValueError(f"{what}: {name!r} is not known; allowed: {listed}")


def _require_possible(
    key: str,
    values: Json,
    table: Mapping[str, Parameter],
    constants: Collection[str] = (),
) -> None:
    """Raise ValueError for an unknown name, and for a value outside of its range.

    constants: names of those that cannot be drawn from a distribution.
    """
    _require_known(values, table, key)
    for name, value in values.items():
        problem = table[name].problem(value)
        if name in constants and isinstance(value, dict):
            problem = f"{table[name].allowed()}, the same for every trial"
        if problem:
            raise _refused(f"{key}.{name}", value, problem)


def _row(
    key: str, row: Json, objects: Mapping[str, HeldObject], styles: Json
) -> TrialsRow:
    """One [[trials]], its values over those of its style. Raises ValueError."""
    action: Any = row.get("action")
    style = row.get("style", "author")
    count = row.get("count", 1)
    names = row.get("objects", [])

    # Action and style first, because the allowed keys follow from them.
    _require_known([action], ACTION_MODULES, f"{key}.action")
    _require_known([style], styles, f"{key}.style")
    if count not in range(1, MOST_TRIALS + 1):
        allowed = f"a whole number from 1 to {MOST_TRIALS}"
        raise _refused(f"{key}.count", count, allowed)
    if action not in EMPTY_HANDED and not names:
        raise _refused(f"{key}.objects", names, f"a list of {', '.join(objects)}")
    _require_known(names, objects, f"{key}.objects")
    for name in names:
        # An object must be one that the hand can hold, unless it is to fall.
        least_n = least_grip_n(objects[name])
        if action != "fall" and least_n > MAX_GRIP_N:
            allowed = f"what {MAX_GRIP_N:g} N a side hold: it needs {least_n:.3g} N"
            raise _refused(f"{key}.objects", name, allowed)

    given = {name: value for name, value in row.items() if name not in ROW_KEYS}
    _require_possible(key, given, parameters_of(action) | TOUCH | HOLD)

    # The file's values take precedence over those of the style.
    of_style = styles[style]
    values = of_style.get("all", {}) | of_style.get(action, {}) | given
    return TrialsRow(tuple(names), action, style, count, values)


def _require_effects_fit(scene: SceneFile) -> None:
    """Raise ValueError for effects without what they need, or with too long a step or rate."""
    hand = scene.hand
    if hand.unmeasured_names and scene.unit != "N":
        # a field is read, and calibrated, on all three axes
        allowed = (
            f'"N", because hand.card leaves out {", ".join(hand.unmeasured_names)}'
        )
        raise _refused("record.unit", scene.unit, allowed)

    units = {"N"}
    for name, values in scene.effects.items():
        effect = effect_named(name)
        units.add(effect.gives_unit or "N")
        key = f"effects.{name}"
        for need in effect.needs:
            if need not in scene.effects:
                allowed = f"only together with [effects.{need}]"
                raise _refused(key, "in the scene", allowed)

        numbers = values.get("sensors", [])
        if max(numbers, default=0) > scene.hand.n_sensors:
            allowed = f"sensors from 1 to {scene.hand.n_sensors}"
            raise _refused(f"{key}.sensors", numbers, allowed)
        # low and high go together, each with a number for every channel
        for name in effect.by_channel if set(effect.by_channel) & set(values) else ():
            given = values.get(name, [])
            if len(given) != len(hand.measured):
                allowed = f"a list of {len(hand.measured)} numbers, one a channel"
                raise _refused(f"{key}.{name}", given, allowed)
        if effect.only_unit not in (None, scene.unit):
            allowed = f'only with record.unit = "{effect.only_unit}"'
            raise _refused(key, "in the scene", allowed)
        if scene.step_s > effect.longest_step_s:
            allowed = f"at most {effect.longest_step_s:g} s with {key}"
            raise _refused("physics.step_s", scene.step_s, allowed)

    # A field is recorded only where an effect makes one of the forces.
    if scene.unit not in units:
        allowed = "only with [effects.dipole]: an ideal force sensor has no field"
        raise _refused("record.unit", scene.unit, allowed)
    # A chip that averages cannot read faster than it converts.
    average_s = step_settings(scene.effects).get("average_s", 0.0)
    if scene.rate_hz * average_s > 1.0:
        allowed = f"at most {1.0 / average_s:.0f} Hz, which is what the chip delivers"
        raise _refused("record.rate_hz", scene.rate_hz, allowed)
