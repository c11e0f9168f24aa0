"""An experiment card (TOML): which objects, which actions by whom, which effects, what is recorded.
Read and checked.

    title = "One pull, with a noisy sensor"

    [record]
    rate_hz = 150            # samples a second
    unit = "N"               # or "uT": the field itself, where a magnet is on the card

    [physics]
    step_s = 0.0008          # where anything can happen; a stated choice (docs/scenes.md has the curve)

    [[trials]]
    objects = ["soft-ball", "hard-ball"]
    action = "pull"
    style = "author"         # ranges of a style; what stands here goes before them
    count = 10               # trials of each object
    hold_s = { uniform = [2, 3] }

    [effects.brush]
    count = 5
    [effects.hall_noise]

    [hand]                   # another than the thesis' (six contacts)
    finger = 4               # contacts on each finger

    [camera]                 # with [effects.camera_frames]: films every trial, tags on object and hand
    fps = 60

What is not on the card does not run. Every error names the key, the value, and what is allowed.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge_runtime.contract import UNITS, Unit
from edge_runtime.errors import CardError
from edge_runtime.reading import text_of
from simulation.camera.frames import CAMERA
from simulation.effects import EFFECTS, conversion_s
from simulation.hand import HAND, Hand
from simulation.objects import OBJECT_KEYS, OBJECTS, Thing, thing
from simulation.protocol import ACTIONS, COMMON, least_grip_n
from simulation.shipped import CARDS, STYLES, shipped
from simulation.values import Parameter

LONGEST_STEP_S = {"texture": 1e-3}
CONSTANTS = {"averaging": "averages", "brush": "count"}
"""What all trials of a card have in common, so that they can be stepped together."""
MAX_GRIP_N = 70.0
"""The Michelangelo hand's greatest opposition grip."""
SECTIONS = ("title", "about", "record", "physics", "trials", "effects", "objects", "camera", "hand")
ROW_KEYS = ("objects", "action", "style", "count")
RECORD = {
    "rate_hz": Parameter(150.0, "Hz", 40, 10000, "samples a second"),
    "join": Parameter(1.0, "", 1, 1000, "so many trials of an object make one long recording"),
}
PHYSICS = {"step_s": Parameter(0.000834, "s", 1e-6, 1.0, "step where anything can happen")}
COUNT = Parameter(1.0, "", 1, 100000, "trials of each object")


@dataclass(frozen=True)
class Row:
    """One line of the card: objects, action, style, trials of each, and values over the style's."""

    objects: tuple[str, ...]
    action: str
    style: str
    count: int
    told: Mapping[str, Any]


@dataclass(frozen=True)
class Card:
    """A checked card. effects: name -> what the card says of it, in the order of the table; text:
    the file."""

    name: str
    title: str
    rate_hz: float
    unit: Unit
    join: int
    step_s: float
    rows: tuple[Row, ...]
    effects: dict[str, dict[str, Any]]
    objects: dict[str, Thing]
    camera: dict[str, float] | None
    hand: Hand
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
    """Also of names that no file can have."""
    try:
        return path.is_file()
    except OSError:
        return False


def read_card(name: str, *, rate_hz: float | None = None) -> Card:
    """Read and check a card by name or path; rate_hz goes before the card's. Raises CardError."""
    path = find_card(name)
    try:
        text = text_of(path)
        raw = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise CardError("cannot be read as text", where=path, cause=type(error).__name__) from None
    except RecursionError:
        raise CardError(
            "no TOML: nested too deep", where=path, next_step="take the brackets away"
        ) from None
    except ValueError as error:  # TOMLDecodeError, and what Python says of a number of 5000 digits
        raise CardError(f"no TOML: {error}", where=path, next_step="mend that line") from None
    return _Reader(path).card(raw, text, rate_hz)


class _Reader:
    """Checks one card; every complaint names the file, the key, the value and what is allowed."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def card(self, raw: dict[str, Any], text: str, rate_hz: float | None) -> Card:
        self.known(raw, SECTIONS, "section")
        record = self.table(raw, "record")
        unit = record.pop("unit", "N")
        if unit not in UNITS[:2]:
            self.refuse("record.unit", unit, " or ".join(UNITS[:2]))
        if rate_hz is not None:
            record["rate_hz"] = rate_hz
        said = self.numbers("record", record, RECORD)
        step_s = self.numbers("physics", self.table(raw, "physics"), PHYSICS)["step_s"]
        objects = OBJECTS | {
            name: self.thing(name, told) for name, told in self.table(raw, "objects").items()
        }
        effects = self.effects(self.table(raw, "effects"))
        card = Card(
            self.path.stem,
            str(raw.get("title", self.path.stem)),
            said["rate_hz"],
            unit,
            int(said["join"]),
            step_s,
            tuple(self.rows(raw.get("trials"), objects)),
            effects,
            objects,
            self.camera(raw),
            self.hand(raw),
            text,
        )
        self.agree(card)
        return card

    def rows(self, told: Any, objects: Mapping[str, Thing]) -> list[Row]:
        if not isinstance(told, list) or not told:
            self.refuse("trials", told, "at least one [[trials]] with an action")
        for k, row in enumerate(told):
            if not isinstance(row, dict):
                self.refuse(f"trials[{k}]", row, "a table: [[trials]]")
        return [self.row(f"trials[{k}]", row, objects) for k, row in enumerate(told)]

    def row(self, key: str, told: dict[str, Any], objects: Mapping[str, Thing]) -> Row:
        action, style = str(told.get("action")), str(told.get("style", "author"))
        if action not in ACTIONS:
            self.refuse(f"{key}.action", action, ", ".join(ACTIONS))
        styles = tomllib.loads(STYLES.read_text(encoding="utf-8"))
        if style not in styles:
            self.refuse(f"{key}.style", style, ", ".join(styles))
        names = told.get("objects", [])
        if not isinstance(names, list) or (action != "nothing" and not names):
            self.refuse(f"{key}.objects", names, f"a list of {', '.join(objects)}")
        for name in names:
            if not isinstance(name, str) or name not in objects:
                self.refuse(f"{key}.objects", name, ", ".join(objects))
        table = COMMON | ACTIONS[action]
        values = {name: value for name, value in told.items() if name not in ROW_KEYS}
        self.known(values, table, f"{key}: {action}")
        values = styles[style].get("all", {}) | styles[style].get(action, {}) | values
        self.check(key, values, table)
        count = self.numbers(key, {"count": told.get("count", 1)}, {"count": COUNT})["count"]
        if count != int(count):
            self.refuse(f"{key}.count", count, "a whole number")
        return Row(tuple(names), action, style, int(count), values)

    def effects(self, told: dict[str, Any]) -> dict[str, dict[str, Any]]:
        self.known(told, EFFECTS, "effect")
        for name, values in told.items():
            if not isinstance(values, dict):
                self.refuse(f"effects.{name}", values, f"a table: [effects.{name}]")
            self.known(values, EFFECTS[name].parameters, f"effects.{name}")
            self.check(f"effects.{name}", values, EFFECTS[name].parameters)
            constant = CONSTANTS.get(name, "")
            if isinstance(values.get(constant), dict):
                self.refuse(
                    f"effects.{name}.{constant}",
                    values[constant],
                    "a number, the same for every trial",
                )
        return {name: told[name] for name in EFFECTS if name in told}

    def camera(self, raw: Mapping[str, Any]) -> dict[str, float] | None:
        return (
            self.numbers("camera", self.table(raw, "camera"), CAMERA) if "camera" in raw else None
        )

    def hand(self, raw: Mapping[str, Any]) -> Hand:
        counts = self.numbers("hand", self.table(raw, "hand"), HAND)
        for name, count in counts.items():
            if count != int(count):
                self.refuse(f"hand.{name}", count, "a whole number")
        return Hand(**{name: int(count) for name, count in counts.items()})

    def thing(self, name: str, told: Any) -> Thing:
        key = f"objects.{name}"
        if not isinstance(told, dict):
            self.refuse(key, told, f"a table: [{key}]")
        return thing(name, self.numbers(key, told, OBJECT_KEYS))

    def agree(self, card: Card) -> None:
        """What no single key shows: needs, steps, rates, grips."""
        for name in card.effects:
            for need in EFFECTS[name].needs:
                if need not in card.effects:
                    self.refuse(
                        f"effects.{name}", "on the card", f"only together with [effects.{need}]"
                    )
            if card.step_s > LONGEST_STEP_S.get(name, 1.0):
                self.refuse(
                    "physics.step_s",
                    card.step_s,
                    f"at most {LONGEST_STEP_S[name]:g} s with effects.{name}",
                )
        if "camera_frames" in card.effects and card.camera is None:
            self.refuse("effects.camera_frames", "on the card", "only together with [camera]")
        if card.camera is not None:
            self.camera_agrees(card, card.camera)
        if card.unit == "uT" and "dipole" not in card.effects:
            self.refuse(
                "record.unit",
                "uT",
                "only with [effects.dipole]: an ideal force sensor has no field",
            )
        if "averaging" in card.effects:
            told = card.effects["averaging"].get("averages", 32.0)
            fastest = 1.0 / conversion_s(float(told) if isinstance(told, (int, float)) else 32.0)
            if card.rate_hz > fastest:
                self.refuse(
                    "record.rate_hz",
                    card.rate_hz,
                    f"at most {fastest:.0f} Hz, what the chip delivers",
                )
        for k, row in enumerate(card.rows):
            for name in row.objects if row.action not in ("fall",) else ():
                least = least_grip_n(card.objects[name])
                if least > MAX_GRIP_N:
                    self.refuse(
                        f"trials[{k}].objects",
                        name,
                        f"what the hand can hold: {name} needs {least:.3g} N a side, it grips {MAX_GRIP_N:g} N",
                    )

    def camera_agrees(self, card: Card, camera: Mapping[str, float]) -> None:
        if "camera_frames" not in card.effects:
            self.refuse("camera", "on the card", "only together with [effects.camera_frames]")
        if card.join > 1:
            self.refuse("record.join", card.join, "1 with a camera: it films single trials")
        if 1e-3 * camera["exposure_ms"] * camera["fps"] > 1.0:
            self.refuse(
                "camera.exposure_ms",
                camera["exposure_ms"],
                f"at most a frame, {1e3 / camera['fps']:.3g} ms",
            )

    def table(self, raw: Mapping[str, Any], name: str) -> dict[str, Any]:
        value = raw.get(name, {})
        if not isinstance(value, dict):
            self.refuse(name, value, f"a table: [{name}]")
        return dict(value)

    def numbers(
        self, key: str, told: Mapping[str, Any], table: Mapping[str, Parameter]
    ) -> dict[str, float]:
        """Constants only."""
        self.known(told, table, key)
        for name, value in told.items():
            if isinstance(value, dict) or table[name].problem(value):
                self.refuse(f"{key}.{name}", value, table[name].allowed())
        return {name: float(told.get(name, p.default)) for name, p in table.items()}

    def check(self, key: str, told: Mapping[str, Any], table: Mapping[str, Parameter]) -> None:
        for name, value in told.items():
            problem = table[name].problem(value)
            if problem:
                self.refuse(f"{key}.{name}", value, problem)

    def known(self, told: Mapping[str, Any], allowed: Any, what: str) -> None:
        for name in told:
            if name not in allowed:
                raise CardError(
                    f"{what}: {name!r} is not known",
                    where=self.path,
                    next_step=f"allowed: {', '.join(allowed)}",
                )

    def refuse(self, key: str, value: Any, allowed: str) -> None:
        raise CardError(f"{key} = {value!r}", where=self.path, next_step=f"allowed: {allowed}")
