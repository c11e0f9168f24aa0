"""The hand card (TOML): which sensors and bare contacts a hand has, on which side, and where.

    name = "two-pads"
    about = "A gripper with one pad on each jaw"

    [[sensors]]              # one or more a side, the thumb's first; channels are in this order
    name = "left-jaw"
    side = "thumb"           # or "opposing"
    along_mm = 0             # place along the object's axis, upwards
    across_mm = 0            # place across it

Further keys of a sensor: `pad` names the soft pad that it shares with others (taxels), which bear
the pad's load by a pressure profile; `stiffness` over that of one fingertip (default: the taxels of
a pad share one fingertip's); `sensed = false` for a contact without a sensor: it has no channels;
`measures = "yz"` (or "xz") for a sensor that measures one axis of the shear. The column of the
other axis is absent or empty, and a model gets 0.0 in its place (`fill_unmeasured`).

All contacts press along the axis from thumb to fingers; a card turns none of them.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import msgspec
import numpy as np
from msgspec import Meta

from holdfast.core.contract import AXES, BoolArray, FloatArray, Json, channel_names
from holdfast.core.schema import find_card, read, text_of
from holdfast.core.trial_layout import HAND_FILE

Side = Literal["thumb", "opposing"]
SIDES: tuple[Side, ...] = ("thumb", "opposing")
Measures = Literal["xyz", "xz", "yz"]
"""The axes that a sensor measures: its normal, and at least one axis of the shear."""
ALL_AXES: Measures = "xyz"
HANDS = Path(__file__).resolve().parent / "hands"
"""The folder of the hand cards that are installed with Holdfast."""
FEWEST_SENSORS, MOST_SENSORS = 2, 12
MOST_CONTACTS = 32
"""With those that have no sensor."""
LEVELS = 4
"""A file lies at most so many folders below its set: <person>/<object>/<action>/trial_1/."""


def too_many(n_sensors: int) -> str:
    """What to say of more sensors than a hand can have, "" for fewer."""
    if n_sensors <= MOST_SENSORS:
        return ""
    return f"{n_sensors} sensors, and {MOST_SENSORS} are the most of a hand"


FARTHEST_MM = 100.0
"""Of a place from the middle of the hand."""
Name = Annotated[str, Meta(max_length=80)]
Place = Annotated[float, Meta(ge=-FARTHEST_MM, le=FARTHEST_MM)]
Stiffness = Annotated[float, Meta(ge=0.01, le=100.0)]
"""Over that of one fingertip."""

USUAL_HAND = "six-fingertips"
"""Of a set or a model that has its number of sensors and no hand card."""
FINGERS_AT_MM = (33.0, 11.0, -11.0, -33.0)
"""Middles of index, middle, ring, little."""


class HandContact(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One place at which the hand touches: a [[sensors]] table.

    pad: empty where it lies on its own. stiffness: 0, until the card is read, for an equal part.
    """

    name: Name
    side: Side
    along_mm: Place
    across_mm: Place = 0.0
    pad: Name = ""
    stiffness: Stiffness = 0.0
    sensed: bool = True
    measures: Measures = ALL_AXES


class _Tables(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A hand card as it stands in its file."""

    sensors: Annotated[tuple[HandContact, ...], Meta(max_length=MOST_CONTACTS)]
    name: Name = ""
    about: str = ""

    def __post_init__(self) -> None:
        _require_hand(self.sensors)


@dataclass(frozen=True)
class HandCard:
    """A checked hand card; the contacts of the thumb's side come first.

    text, sha256: of the file, as it was read; empty for a hand without a file.
    """

    name: str
    contacts: tuple[HandContact, ...]
    text: str = ""
    sha256: str = ""

    @property
    def n_contacts(self) -> int:
        """S, contacts of the whole hand."""
        return len(self.contacts)

    @property
    def n_sensors(self) -> int:
        """Contacts that have a sensor; each has three channels."""
        return len(self.sensor_sides)

    @property
    def thumb(self) -> int:
        """Contacts of the thumb's side."""
        return [contact.side for contact in self.contacts].count("thumb")

    @property
    def sensor_sides(self) -> tuple[Side, ...]:
        """The side of every sensor, in the order of the channels."""
        return tuple(contact.side for contact in self.contacts if contact.sensed)

    @property
    def of_thumb(self) -> tuple[bool, ...]:
        """Whether each sensor presses from the thumb's side."""
        return tuple(side == "thumb" for side in self.sensor_sides)

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """What people call each sensor, in the order of the channels."""
        names = []
        for contact in self.contacts:
            if contact.sensed:
                names.append(contact.name.replace("-", " "))
        return tuple(names)

    @cached_property
    def measured(self) -> BoolArray:
        """[C] which channels are measured."""
        flags = []
        for contact in self.contacts:
            if contact.sensed:
                flags += [axis in contact.measures for axis in AXES]
        return np.array(flags, dtype=np.bool_)

    @cached_property
    def unmeasured_names(self) -> tuple[str, ...]:
        """The channels that are not measured, such as X1; empty for most hands."""
        names = np.array(channel_names(self.n_sensors))
        return tuple(names[~self.measured].tolist())

    @property
    def sensed(self) -> BoolArray:
        """[S] which contacts have a sensor."""
        return self._of_each("sensed").astype(np.bool_)

    @property
    def part(self) -> FloatArray:
        """[S] a contact's stiffness over that of one fingertip."""
        return self._of_each("stiffness")

    @property
    def along_m(self) -> FloatArray:
        """[S] positions of the contacts along the axis of a cylinder."""
        return 1e-3 * self._of_each("along_mm")

    @property
    def across_m(self) -> FloatArray:
        """[S] positions of the contacts across that axis."""
        return 1e-3 * self._of_each("across_mm")

    def _of_each(self, name: str) -> FloatArray:
        """[S] a value of every contact."""
        values: FloatArray = np.array(
            [getattr(contact, name) for contact in self.contacts]
        )
        return values

    @property
    def pads(self) -> list[list[int]]:
        """The contacts of each pad, in the order of the card; a contact on its own is a pad."""
        places: dict[str | int, list[int]] = {}
        for k, contact in enumerate(self.contacts):
            places.setdefault(contact.pad or k, []).append(k)
        return list(places.values())

    @property
    def has_pads(self) -> bool:
        """Whether any pad has several contacts."""
        return len(self.pads) < self.n_contacts

    def in_words(self) -> str:
        """One line for people: the card and its sensors, side by side."""
        sides = self.sensor_sides
        against = f"{sides.count('thumb')} against {sides.count('opposing')}"
        words = f"hand: {self.name}, {len(sides)} sensors ({against})"
        if self.unmeasured_names:
            words += f"; not measured: {', '.join(self.unmeasured_names)}"
        return words

    def to_json(self) -> Json:
        """For a model's metadata: the contacts and what the file was, without its text."""
        contacts = msgspec.to_builtins(self.contacts)
        for contact in contacts:
            # as cards were before there was such a key
            if contact["measures"] == ALL_AXES:
                del contact["measures"]
        return {"name": self.name, "contacts": contacts, "sha256": self.sha256}


def hand_from_json(value: Any) -> HandCard:
    """The inverse of HandCard.to_json. Raises KeyError, TypeError or ValueError."""
    contacts = msgspec.convert(value["contacts"], tuple[HandContact, ...])
    hand = HandCard(str(value["name"]), contacts, sha256=str(value["sha256"]))
    if not hand.n_sensors:
        raise ValueError("a hand without sensors")
    return hand


class Measuring(Protocol):
    """What says which channels are measured: a hand card, or a column map."""

    @property
    def measured(self) -> BoolArray:
        """[C] which channels are measured."""
        ...

    @property
    def unmeasured_names(self) -> tuple[str, ...]:
        """The channels that are not measured."""
        ...


def fill_unmeasured(values: FloatArray, hand: Measuring | None) -> FloatArray:
    """Values [.., C] with 0.0 in every channel that the hand card says is not measured.

    What stood there does not count, be it nan, noise or a bias. So this acts last, on all ways to a
    model: files, streams, replay, simulation and import. The same array where all is measured.
    """
    if hand is None or not hand.unmeasured_names:
        return values
    return np.where(hand.measured, values, 0.0)


def leave_empty(values: FloatArray, hand: Measuring | None) -> FloatArray:
    """Values [.., C] as files and streams have them: nan in every channel that is not measured."""
    if hand is None or not hand.unmeasured_names:
        return values
    return np.where(hand.measured, values, np.nan)


def hand_card_near(path: Path) -> HandCard | None:
    """The hand card of the set in which a trial's file is; None without one. Raises CardError."""
    for folder in list(path.resolve().parents)[: 1 + LEVELS]:
        if (folder / HAND_FILE).is_file():
            return read_hand_card(folder / HAND_FILE)
    return None


def find_hand_card(name: str | Path, folder: Path = Path()) -> Path:
    """A shipped hand card by name, or a file, seen from the folder first. Raises CardError."""
    return find_card(str(name), HANDS, "hand card", folder)


def read_hand_card(name: str | Path, folder: Path = Path()) -> HandCard:
    """Read and check a hand card by name or path. Raises CardError."""
    path = find_hand_card(name, folder)
    tables = read(path, _Tables)
    # Where the card says no stiffness, the taxels of a pad have equal parts of a fingertip's.
    taxels = Counter(one.pad for one in tables.sensors)
    contacts = []
    for one in tables.sensors:
        of_pad = 1.0 / taxels[one.pad] if one.pad else 1.0
        stiffness = one.stiffness or of_pad
        contacts.append(msgspec.structs.replace(one, stiffness=stiffness))
    text = text_of(path)
    digest = hashlib.sha256(text.encode()).hexdigest()
    return HandCard(tables.name or path.stem, tuple(contacts), text, digest)


def _require_hand(contacts: Sequence[HandContact]) -> None:
    """Raise ValueError for contacts that are no hand."""
    n_sensors = [contact.sensed for contact in contacts].count(True)
    if not FEWEST_SENSORS <= n_sensors <= MOST_SENSORS:
        allowed = f"{FEWEST_SENSORS} to {MOST_SENSORS} (sensed = true)"
        raise ValueError(f"{n_sensors} sensors; allowed: {allowed}")

    sides = [contact.side for contact in contacts]
    if set(sides) != set(SIDES):
        needed = "a contact on either side; one without a sensor has sensed = false"
        raise ValueError(f"all contacts are on one side; allowed: {needed}")
    if sides != sorted(sides, key=SIDES.index):
        allowed = "the contacts of the thumb's side before all others"
        raise ValueError(f"sides in mixed order; allowed: {allowed}")

    for contact in contacts:
        if contact.measures != ALL_AXES and not contact.sensed:
            stated = (
                f"{contact.name!r} has no sensor and measures = {contact.measures!r}"
            )
            raise ValueError(f"{stated}; allowed: measures only with a sensor")

    side_of_pad: dict[str, str] = {}
    for contact in contacts:
        side = side_of_pad.setdefault(contact.pad, contact.side)
        if contact.pad and side != contact.side:
            raise ValueError(
                f"pad = {contact.pad!r}; allowed: all its contacts on one side"
            )

    names: Counter[object] = Counter(contact.name for contact in contacts)
    places: Counter[object] = Counter(
        (one.side, one.along_mm, one.across_mm) for one in contacts
    )
    for what, counts in {"name": names, "place": places}.items():
        value, count = counts.most_common(1)[0]
        if count > 1:
            raise ValueError(
                f"{count} contacts have {what} {value}; allowed: each its own"
            )


@cache
def usual_hand() -> HandCard:
    """The card of a set or a model that has its number of sensors and no card."""
    return read_hand_card(USUAL_HAND)


def hand_or_usual(card: HandCard | None, n_sensors: int) -> HandCard | None:
    """A card; without one the usual hand, where that has as many sensors, else None."""
    if card is not None:
        return card
    usual = usual_hand()
    return usual if usual.n_sensors == n_sensors else None


def sensor_names(card: HandCard | None, n_sensors: int) -> tuple[str, ...]:
    """What people call each sensor; by its number where no card names it."""
    hand = hand_or_usual(card, n_sensors)
    if hand is not None:
        return hand.sensor_names
    return tuple(map("sensor {}".format, range(1, n_sensors + 1)))
