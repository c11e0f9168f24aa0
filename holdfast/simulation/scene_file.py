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
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.contract import UNITS, Json, Unit
from holdfast.core.errors import HoldfastError, UsageError
from holdfast.core.hand_card import HandCard, hand_of_counts, hand_of_section
from holdfast.core.reading import read_toml
from holdfast.simulation import STYLES, find_scene_file
from holdfast.simulation.effect import (
    EFFECT_MODULES,
    Effect,
    NumberReader,
    Parameter,
    all_effects,
    effect_named,
    step_settings,
)
from holdfast.simulation.objects import (
    HAND,
    OBJECT_KEYS,
    OBJECTS,
    TOUCH,
    HeldObject,
    held_object,
)
from holdfast.simulation.protocol import (
    ALL_ACTIONS,
    EMPTY_HANDED,
    HOLD_KEYS,
    TrialsRow,
    least_grip_n,
    parameters_of,
)

MAX_GRIP_N = 70.0
"""Greatest opposition grip of the Michelangelo hand, N a side (thesis, 5.1.1)."""
SECTIONS = (
    "title",
    "about",
    "record",
    "physics",
    "every_trial",
    "trials",
    "effects",
    "objects",
    "hand",
)
"""Keys and sections at the top of a scene file."""
ROW_KEYS = {"objects", "action", "style", "count"}
"""Keys of [[trials]] that are no parameters of the action."""
RATE = Parameter(150.0, "Hz", 40, 10000, "samples a second")
"""Sampling rate of a recording."""
RECORD = {
    "rate_hz": RATE,
    "join": Parameter(
        1.0, "", 1, 1000, "trials of an object that make one long recording"
    ),
}
PHYSICS = {
    "step_s": Parameter(0.000834, "s", 1e-6, 1.0, "step where anything can happen")
}
"""Numbers of the section [physics]."""
COUNT = {"count": Parameter(1.0, "", 1, 100000, "trials of each object")}
"""Number of one [[trials]] that is no parameter of its action."""


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
        """Of the file's text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def read_scene_file(
    name: str, *, rate_hz: float | None = None, rate_option: str = "rate_hz="
) -> SceneFile:
    """Read and check a scene by name or path.

    rate_hz replaces the file's rate; rate_option: the user's word before that number. Raises
    CardError, and UsageError for a rate_hz that the file does not allow.
    """
    path = find_scene_file(name)
    text, raw = read_toml(path)
    reader = _SceneReader(path, "" if rate_hz is None else rate_option)
    return reader.scene(raw, text, rate_hz)


class _SceneReader(NumberReader):
    """Checks one file section by section, then what the sections state together.

    rate_option: the user's word before a rate that replaces the file's; empty without one.
    """

    def __init__(self, path: Path, rate_option: str) -> None:
        super().__init__(path)
        self.rate_option = rate_option

    def scene(self, raw: Json, text: str, rate_hz: float | None) -> SceneFile:
        """Read every section, then check them against each other.

        rate_hz replaces the rate of the file. Raises CardError, and UsageError for that rate.
        """
        self.require_known(raw, SECTIONS, "section")
        record = self.table(raw, "record")
        unit = record.pop("unit", "N")
        if unit not in UNITS[:2]:
            raise self.refused("record.unit", unit, " or ".join(UNITS[:2]))

        # A rate given by the user is checked first, so that the error names the option and not the
        # file.
        if rate_hz is not None:
            if RATE.problem(rate_hz):
                raise self.rate_refused(rate_hz, RATE.allowed())
            record["rate_hz"] = rate_hz

        numbers = self.numbers("record", record, RECORD)
        physics = self.numbers("physics", self.table(raw, "physics"), PHYSICS)
        objects = dict(OBJECTS)
        for name, value in self.table(raw, "objects").items():
            objects[name] = self.object(name, value)

        scene = SceneFile(
            name=self.path.stem,
            title=str(raw.get("title", self.path.stem)),
            rate_hz=numbers["rate_hz"],
            unit=unit,
            join=int(numbers["join"]),
            step_s=physics["step_s"],
            rows=self.rows(raw, objects),
            effects=self.effects(self.table(raw, "effects")),
            objects=objects,
            hand=self.hand(raw),
            text=text,
        )
        self.require_agreement(scene)
        return scene

    def rate_refused(self, rate_hz: float, allowed: str) -> HoldfastError:
        """The error for a rate, which names who gave it: the user or the file."""
        if not self.rate_option:
            return self.refused("record.rate_hz", rate_hz, allowed)
        return UsageError(
            f"{self.rate_option}{rate_hz:g} is not a sampling rate of {self.path.stem}",
            next_step=f"give {allowed}",
        )

    def object(self, name: str, value: Any) -> HeldObject:
        """One [objects.NAME] table. Raises CardError."""
        key = f"objects.{name}"
        table = self.require_table(key, value)
        return held_object(name, self.numbers(key, table, OBJECT_KEYS))

    def rows(
        self, raw: Mapping[str, Any], objects: Mapping[str, HeldObject]
    ) -> tuple[TrialsRow, ...]:
        """All [[trials]] of the file, at least one, over [every_trial]. Raises CardError."""
        rows = raw.get("trials")
        every = self.table(raw, "every_trial")
        self.require_known(ROW_KEYS & every.keys(), (), "every_trial")
        if not isinstance(rows, list) or not rows:
            raise self.refused("trials", rows, "at least one [[trials]] with an action")

        for k, row in enumerate(rows):
            if not isinstance(row, dict):
                raise self.refused(f"trials[{k}]", row, "a table: [[trials]]")

        styles = tomllib.loads(STYLES.read_text(encoding="utf-8"))
        checked = []
        for k, row in enumerate(rows):
            checked.append(self.row(f"trials[{k}]", every | row, objects, styles))

        return tuple(checked)

    def row(
        self, key: str, row: Json, objects: Mapping[str, HeldObject], styles: Json
    ) -> TrialsRow:
        """One [[trials]], its values over those of its style. Raises CardError."""
        action = str(row.get("action"))
        style = str(row.get("style", "author"))

        # Action and style first, because the allowed keys follow from them.
        if action not in ALL_ACTIONS:
            raise self.refused(f"{key}.action", action, ", ".join(ALL_ACTIONS))
        if style not in styles:
            raise self.refused(f"{key}.style", style, ", ".join(styles))

        names = row.get("objects", [])
        missing = action not in EMPTY_HANDED and not names
        if not isinstance(names, list) or missing:
            allowed = f"a list of {', '.join(objects)}"
            raise self.refused(f"{key}.objects", names, allowed)

        # Every name is checked, so that the error names the wrong one.
        for name in names:
            if not isinstance(name, str) or name not in objects:
                raise self.refused(f"{key}.objects", name, ", ".join(objects))

        given = {name: value for name, value in row.items() if name not in ROW_KEYS}
        table = parameters_of(action) | TOUCH
        if any(name in given for name in HOLD_KEYS):
            from holdfast.simulation.holds import HOLD

            table = table | HOLD
        self.require_known(given, table, f"{key}: {action}")
        # The file's values take precedence over those of the style.
        style_values = styles[style]
        for_all = style_values.get("all", {})
        for_action = style_values.get(action, {})
        values = for_all | for_action | given
        self.require_possible(key, values, table)
        counts = self.numbers(key, {"count": row.get("count", 1)}, COUNT)
        count = self.whole(f"{key}.count", counts["count"])

        return TrialsRow(tuple(names), action, style, count, values)

    def effects(self, effects: Json) -> dict[str, Json]:
        """Effects with their values, in the order in which they run. Raises CardError."""
        self.require_known(effects, EFFECT_MODULES, "effect")
        for name, values in effects.items():
            key = f"effects.{name}"
            effect = effect_named(name)
            self.require_table(key, values)
            self.require_known(values, effect.parameters, key)
            self.require_possible(key, values, effect.parameters)

            # Trials are stepped together, so a constant of the step cannot be drawn for each.
            constant = values.get(effect.constant)
            if isinstance(constant, dict):
                allowed = "a number, the same for every trial"
                raise self.refused(f"{key}.{effect.constant}", constant, allowed)

        # The order is that in which effects run, not that of the file.
        return {name: effects[name] for name in EFFECT_MODULES if name in effects}

    def hand(self, raw: Mapping[str, Any]) -> HandCard:
        """The hand of a card, or of numbers of contacts. Raises CardError."""
        section = self.table(raw, "hand")
        if "card" in section:
            return hand_of_section(section, self.path)
        counts = self.numbers("hand", section, HAND)
        thumb = self.whole("hand.thumb", counts["thumb"])
        return hand_of_counts(thumb, self.whole("hand.finger", counts["finger"]))

    def require_agreement(self, scene: SceneFile) -> None:
        """Raise CardError where keys contradict each other."""
        for name in scene.effects:
            self.require_effect_fits(scene, effect_named(name))

        self.require_unit_given(scene)
        # A chip that averages cannot read faster than it converts.
        average_s = step_settings(scene.effects).get("average_s")
        if average_s and scene.rate_hz > 1.0 / average_s:
            fastest_hz = f"{1.0 / average_s:.0f} Hz"
            allowed = f"at most {fastest_hz}, which is what the chip delivers"
            raise self.rate_refused(scene.rate_hz, allowed)

        for k, row in enumerate(scene.rows):
            self.require_holdable(f"trials[{k}].objects", row, scene.objects)

    def require_unit_given(self, scene: SceneFile) -> None:
        """A field is recorded only where an effect makes one of the forces."""
        given = {effect_named(name).gives_unit for name in scene.effects}
        if scene.unit == "N" or scene.unit in given:
            return

        # The error names the effect that is missing.
        gives = [e.name for e in all_effects().values() if e.gives_unit == scene.unit]
        allowed = f"only with [effects.{gives[0]}]: an ideal force sensor has no field"
        raise self.refused("record.unit", scene.unit, allowed)

    def require_effect_fits(self, scene: SceneFile, effect: Effect) -> None:
        """Raise CardError for an effect without what it needs, or with too long a step."""
        key = f"effects.{effect.name}"
        for need in effect.needs:
            if need not in scene.effects:
                allowed = f"only together with [effects.{need}]"
                raise self.refused(key, "in the scene", allowed)

        numbers = scene.effects[effect.name].get("sensors", [])
        if max(numbers, default=0) > scene.hand.n_sensors:
            allowed = f"sensors from 1 to {scene.hand.n_sensors}"
            raise self.refused(f"{key}.sensors", numbers, allowed)
        if effect.only_unit not in (None, scene.unit):
            allowed = f'only with record.unit = "{effect.only_unit}"'
            raise self.refused(key, "in the scene", allowed)
        if scene.step_s > effect.longest_step_s:
            allowed = f"at most {effect.longest_step_s:g} s with {key}"
            raise self.refused("physics.step_s", scene.step_s, allowed)

    def require_holdable(
        self, key: str, row: TrialsRow, objects: Mapping[str, HeldObject]
    ) -> None:
        """An object must be one that the hand can hold, unless it is to fall."""
        if row.action == "fall":
            return

        for name in row.objects:
            least_n = least_grip_n(objects[name])
            if least_n > MAX_GRIP_N:
                needed = f"{name} needs {least_n:.3g} N a side, "
                needed += f"the hand grips with {MAX_GRIP_N:g} N"
                allowed = f"objects that the hand can hold: {needed}"
                raise self.refused(key, name, allowed)
