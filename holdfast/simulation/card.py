"""An experiment card (TOML): objects, actions and who acts, effects, what is recorded; checked.

    title = "One pull, with a noisy sensor"

    [record]
    rate_hz = 150            # samples a second
    unit = "N"               # or "uT": the field itself, where a magnet is on the card

    [physics]
    step_s = 0.0008          # step where anything can happen; docs/scenes.md shows what it costs

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
    finger = 4               # contacts on each finger

    [controller]             # a hand that acts (holdfast/simulation/closed_loop/drive.py)
    name = "holdfast"

    [camera]                 # with [effects.camera_frames]: films every trial
    fps = 60

Only the effects that the card names run.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.contract import UNITS, Unit
from holdfast.core.errors import CardError, HoldfastError, UsageError
from holdfast.core.hand_layout import HandLayout
from holdfast.core.reading import CardReader, Json, read_toml
from holdfast.edge_runtime.grip import CONTROLLERS
from holdfast.simulation.camera_frames import CAMERA
from holdfast.simulation.closed_loop.drive import MODEL, NAMES, NUMBERS, HandControl
from holdfast.simulation.effect import Effect
from holdfast.simulation.effects import EFFECTS, step_settings
from holdfast.simulation.objects import HAND, OBJECT_KEYS, OBJECTS, Thing, thing
from holdfast.simulation.protocol import ACTIONS, COMMON, least_grip_n
from holdfast.simulation.shipped import CARDS, STYLES, shipped
from holdfast.simulation.values import Parameter

MAX_GRIP_N = 70.0
"""The Michelangelo hand's greatest opposition grip."""
SECTIONS = (
    *("title", "about", "record", "physics", "trials"),
    *("effects", "objects", "camera", "hand", "controller"),
)
ROW_KEYS = ("objects", "action", "style", "count")
RECORD = {
    "rate_hz": Parameter(150.0, "Hz", 40, 10000, "samples a second"),
    "join": Parameter(
        1.0, "", 1, 1000, "trials of an object that make one long recording"
    ),
}
PHYSICS = {
    "step_s": Parameter(0.000834, "s", 1e-6, 1.0, "step where anything can happen")
}
COUNT = Parameter(1.0, "", 1, 100000, "trials of each object")


@dataclass(frozen=True)
class Row:
    """One [[trials]] of the card; values: of the action, the card's over those of the style."""

    objects: tuple[str, ...]
    action: str
    style: str
    count: int
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Card:
    """A checked card; effects: name -> values, in the order of EFFECTS; text: the file."""

    name: str
    title: str
    rate_hz: float
    unit: Unit
    join: int
    step_s: float
    rows: tuple[Row, ...]
    effects: dict[str, Json]
    objects: dict[str, Thing]
    camera: dict[str, float] | None
    hand: HandLayout
    controller: HandControl | None
    text: str

    @property
    def sha256(self) -> str:
        """Of the card's text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def find_card(name: str) -> Path:
    """A shipped card by name, or a file. Raises CardError."""
    path = CARDS / f"{name}.toml"
    if name in shipped():
        return path
    if _is_file(Path(name)):
        return Path(name)
    raise CardError(
        f"no card {name!r}",
        cause="neither a shipped card nor a file",
        next_step=f"choose from {', '.join(shipped())}",
    )


def _is_file(path: Path) -> bool:
    """Whether there is such a file; False too for names that no file can have."""
    try:
        return path.is_file()
    except OSError:
        return False


def read_card(
    name: str, *, rate_hz: float | None = None, rate_option: str = "rate_hz="
) -> Card:
    """Read and check a card by name or path.

    rate_hz replaces the card's rate; rate_option: the user's word before that number. Raises
    CardError, and UsageError for a rate_hz that the card does not allow.
    """
    path = find_card(name)
    text, raw = read_toml(path)
    return _SceneCardReader(path, "" if rate_hz is None else rate_option).card(
        raw, text, rate_hz
    )


class _SceneCardReader(CardReader):
    """Checks one card section by section, then what the sections say together.

    rate_option: the user's word before a rate that replaces the card's; empty without one.
    """

    def __init__(self, path: Path, rate_option: str = "") -> None:
        super().__init__(path)
        self.rate_option = rate_option

    def card(self, raw: Json, text: str, rate_hz: float | None) -> Card:
        self.require_known(raw, SECTIONS, "section")
        record = self.table(raw, "record")
        unit = record.pop("unit", "N")
        if unit not in UNITS[:2]:
            raise self.refused("record.unit", unit, " or ".join(UNITS[:2]))
        if rate_hz is not None:
            record["rate_hz"] = self.require_rate(rate_hz)
        numbers = self.numbers("record", record, RECORD)
        objects = OBJECTS | {
            name: self.thing(name, value)
            for name, value in self.table(raw, "objects").items()
        }
        card = Card(
            name=self.path.stem,
            title=str(raw.get("title", self.path.stem)),
            rate_hz=numbers["rate_hz"],
            unit=unit,
            join=int(numbers["join"]),
            step_s=self.numbers("physics", self.table(raw, "physics"), PHYSICS)[
                "step_s"
            ],
            rows=tuple(self.rows(raw.get("trials"), objects)),
            effects=self.effects(self.table(raw, "effects")),
            objects=objects,
            camera=self.camera(raw),
            hand=self.hand(raw),
            controller=self.controller(raw),
            text=text,
        )
        self.require_agreement(card)
        return card

    def require_rate(self, rate_hz: float) -> float:
        """The rate that replaces the card's. Raises UsageError."""
        rate = RECORD["rate_hz"]
        if rate.problem(rate_hz):
            raise self.rate_refused(rate_hz, rate.allowed())
        return rate_hz

    def rate_refused(self, rate_hz: float, allowed: str) -> HoldfastError:
        """The error for a rate, which names who gave it: the user or the card."""
        if not self.rate_option:
            return self.refused("record.rate_hz", rate_hz, allowed)
        return UsageError(
            f"{self.rate_option}{rate_hz:g} is not a sampling rate of {self.path.stem}",
            next_step=f"give {allowed}",
        )

    def rows(self, rows: Any, objects: Mapping[str, Thing]) -> list[Row]:
        if not isinstance(rows, list) or not rows:
            raise self.refused("trials", rows, "at least one [[trials]] with an action")
        for k, row in enumerate(rows):
            if not isinstance(row, dict):
                raise self.refused(f"trials[{k}]", row, "a table: [[trials]]")
        return [self.row(f"trials[{k}]", row, objects) for k, row in enumerate(rows)]

    def row(self, key: str, row: Json, objects: Mapping[str, Thing]) -> Row:
        action, style = str(row.get("action")), str(row.get("style", "author"))
        if action not in ACTIONS:
            raise self.refused(f"{key}.action", action, ", ".join(ACTIONS))
        styles = tomllib.loads(STYLES.read_text(encoding="utf-8"))
        if style not in styles:
            raise self.refused(f"{key}.style", style, ", ".join(styles))
        names = row.get("objects", [])
        if not isinstance(names, list) or (action != "nothing" and not names):
            raise self.refused(
                f"{key}.objects", names, f"a list of {', '.join(objects)}"
            )
        for name in names:
            if not isinstance(name, str) or name not in objects:
                raise self.refused(f"{key}.objects", name, ", ".join(objects))
        table = COMMON | ACTIONS[action]
        own = {name: value for name, value in row.items() if name not in ROW_KEYS}
        self.require_known(own, table, f"{key}: {action}")
        values = styles[style].get("all", {}) | styles[style].get(action, {}) | own
        self.require_possible(key, values, table)
        count = self.numbers(key, {"count": row.get("count", 1)}, {"count": COUNT})[
            "count"
        ]
        return Row(
            tuple(names), action, style, self.whole(f"{key}.count", count), values
        )

    def effects(self, effects: Json) -> dict[str, Json]:
        self.require_known(effects, EFFECTS, "effect")
        for name, values in effects.items():
            key, effect = f"effects.{name}", EFFECTS[name]
            self.require_table(key, values)
            self.require_known(values, effect.parameters, key)
            self.require_possible(key, values, effect.parameters)
            constant = values.get(effect.constant)
            if isinstance(constant, dict):
                allowed = "a number, the same for every trial"
                raise self.refused(f"{key}.{effect.constant}", constant, allowed)
        return {name: effects[name] for name in EFFECTS if name in effects}

    def camera(self, raw: Mapping[str, Any]) -> dict[str, float] | None:
        if "camera" not in raw:
            return None
        return self.numbers("camera", self.table(raw, "camera"), CAMERA)

    def hand(self, raw: Mapping[str, Any]) -> HandLayout:
        counts = self.numbers("hand", self.table(raw, "hand"), HAND)
        return HandLayout(
            **{n: self.whole(f"hand.{n}", count) for n, count in counts.items()}
        )

    def controller(self, raw: Mapping[str, Any]) -> HandControl | None:
        if "controller" not in raw:
            return None
        section = self.table(raw, "controller")
        name, model = section.pop("name", None), section.pop("model", MODEL)
        if name not in CONTROLLERS:
            raise self.refused("controller.name", name, ", ".join(CONTROLLERS))
        if not isinstance(model, str) or not model:
            raise self.refused("controller.model", model, "the path of a model file")
        self.require_known(section, [*NAMES, *NUMBERS], "controller")
        numbers = self.numbers("controller", section, NUMBERS)
        return HandControl.of(name, model, numbers, has_setting="setting" in section)

    def thing(self, name: str, value: Any) -> Thing:
        key = f"objects.{name}"
        return thing(
            name, self.numbers(key, self.require_table(key, value), OBJECT_KEYS)
        )

    def require_agreement(self, card: Card) -> None:
        """Raise CardError where keys contradict each other."""
        named = [EFFECTS[name] for name in card.effects]
        for effect in named:
            self.require_effect_fits(card, effect)
        self.require_controller_fits(card)
        self.require_camera_fits(
            card, filmed=any(one.stage == "camera" for one in named)
        )
        if card.unit != "N" and card.unit not in {one.gives_unit for one in named}:
            needed = next(
                one.name for one in EFFECTS.values() if one.gives_unit == card.unit
            )
            allowed = (
                f"only with [effects.{needed}]: an ideal force sensor has no field"
            )
            raise self.refused("record.unit", card.unit, allowed)
        average_s = step_settings(card.effects).get("average_s")
        if average_s and card.rate_hz > 1.0 / average_s:
            allowed = (
                f"at most {1.0 / average_s:.0f} Hz, which is what the chip delivers"
            )
            raise self.rate_refused(card.rate_hz, allowed)
        for k, row in enumerate(card.rows):
            self.require_holdable(f"trials[{k}].objects", row, card.objects)

    def require_effect_fits(self, card: Card, effect: Effect) -> None:
        for need in effect.needs:
            if need not in card.effects:
                allowed = f"only together with [effects.{need}]"
                raise self.refused(f"effects.{effect.name}", "on the card", allowed)
        if card.step_s > effect.longest_step_s:
            allowed = f"at most {effect.longest_step_s:g} s with effects.{effect.name}"
            raise self.refused("physics.step_s", card.step_s, allowed)
        if effect.stage == "camera" and card.camera is None:
            key = f"effects.{effect.name}"
            raise self.refused(key, "on the card", "only together with [camera]")

    def require_controller_fits(self, card: Card) -> None:
        if card.controller is None:
            return
        if card.join > 1:
            allowed = "1 with a controller: each trial has its own sensors"
            raise self.refused("record.join", card.join, allowed)
        if card.unit != "N":
            raise self.refused("record.unit", card.unit, "N with a controller")

    def require_camera_fits(self, card: Card, *, filmed: bool) -> None:
        camera = card.camera
        if camera is None:
            return
        if not filmed:
            raise self.refused(
                "camera", "on the card", "only together with [effects.camera_frames]"
            )
        if card.join > 1:
            raise self.refused(
                "record.join", card.join, "1 with a camera: it films single trials"
            )
        if 1e-3 * camera["exposure_ms"] * camera["fps"] > 1.0:
            allowed = f"at most the time of a frame, {1e3 / camera['fps']:.3g} ms"
            raise self.refused("camera.exposure_ms", camera["exposure_ms"], allowed)

    def require_holdable(
        self, key: str, row: Row, objects: Mapping[str, Thing]
    ) -> None:
        for name in row.objects if row.action != "fall" else ():
            least_n = least_grip_n(objects[name])
            if least_n > MAX_GRIP_N:
                needed = f"{name} needs {least_n:.3g} N a side, "
                needed += f"the hand grips with {MAX_GRIP_N:g} N"
                raise self.refused(
                    key, name, f"objects that the hand can hold: {needed}"
                )

    def whole(self, key: str, number: float) -> int:
        if number != int(number):
            raise self.refused(key, number, "a whole number")
        return int(number)

    def numbers(
        self, key: str, values: Mapping[str, Any], table: Mapping[str, Parameter]
    ) -> dict[str, float]:
        """Constants by name, defaults where the card has none; distributions are refused."""
        self.require_known(values, table, key)
        for name, value in values.items():
            if isinstance(value, dict) or table[name].problem(value):
                raise self.refused(f"{key}.{name}", value, table[name].allowed())
        return {name: float(values.get(name, p.default)) for name, p in table.items()}

    def require_possible(
        self, key: str, values: Mapping[str, Any], table: Mapping[str, Parameter]
    ) -> None:
        """Raise CardError for a constant or a distribution outside of its range."""
        for name, value in values.items():
            problem = table[name].problem(value)
            if problem:
                raise self.refused(f"{key}.{name}", value, problem)
