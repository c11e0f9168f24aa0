"""Objects: mass, size, shape, friction and stiffness.

Masses and sizes are the thesis'. Friction against silicone and stiffness are our assumptions for
foam, PET, rubber and printed plastic; the scene varies them from trial to trial. A scene file may
add objects.

The hand of a scene file: how many contacts its thumb and its four fingers have.

    [hand]
    thumb = 4                # contacts on the thumb, default 2
    finger = 4               # contacts on each of the four fingers, default 1; 20 in all here

or a hand card, which says where its sensors are. Without a card each contact has an equal part of
its finger's stiffness, and of the object's under it, so more contacts do not make a finger stiffer.
Along a cylinder they lie side by side over the finger's width. All press along the thumb's axis:
there is no palm, and a finger does not bend between its contacts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.hand_card import (
    FINGERS_AT_MM,
    HandCard,
    HandContact,
    fill_unmeasured,
)
from holdfast.core.trial_layout import MASSES_G
from holdfast.simulation.effects.effect import Parameter, Reported

THUMB_MM, FINGER_MM = 48.0, 22.0
"""Widths along the object's axis, contacts of a hand without a card spread evenly over each."""
OBJECT_KEYS = {
    "mass_g": Parameter(100.0, "g", 0.1, 5000.0, "mass"),
    "radius_mm": Parameter(
        30.0, "mm", 5.0, 60.0, "radius of curvature across the grip"
    ),
    "axial_radius_mm": Parameter(
        0.0, "mm", 0.0, 1000.0, "radius of curvature along the axis; 0: a cylinder"
    ),
    "half_length_mm": Parameter(
        0.0, "mm", 0.0, 500.0, "half the straight length of a cylinder; 0 for a ball"
    ),
    "friction": Parameter(0.7, "", 0.0, 3.0, "static friction coefficient on silicone"),
    "kinetic_share": Parameter(0.8, "", 0.0, 1.0, "kinetic over static friction"),
    "crush_n": Parameter(
        0.0, "N", 0.0, 1e4, "grip of either side that crushes it; 0: none does"
    ),
    "stiffness_n_per_m": Parameter(
        1e4, "N/m", 50.0, 1e7, "stiffness, in series with a finger's"
    ),
}
EDGE_RADIUS_MM = 5.0
"""Radius of the rounded edge in which a cylinder ends, mm."""


@dataclass(frozen=True)
class HeldObject:
    """One object, by the numbers of OBJECT_KEYS.

    A ball where axial_radius_mm is above zero, else a cylinder with rounded ends.
    """

    name: str
    mass_g: float
    radius_mm: float
    axial_radius_mm: float
    half_length_mm: float
    friction: float
    kinetic_share: float
    stiffness_n_per_m: float
    crush_n: float = 0.0

    @property
    def mass_kg(self) -> float:
        return 1e-3 * self.mass_g

    @property
    def curvature_per_m(self) -> tuple[float, float]:
        """(across the grip, along the axis or at its edge), 1/m."""
        # A cylinder is flat along its axis and curved only at its edge.
        axial_mm = self.axial_radius_mm or EDGE_RADIUS_MM
        return 1e3 / self.radius_mm, 1e3 / axial_mm


def held_object(name: str, values: Mapping[str, Any]) -> HeldObject:
    """An object from a scene file's table; missing values have their defaults."""
    numbers = {}
    for key, parameter in OBJECT_KEYS.items():
        numbers[key] = float(values.get(key, parameter.default))
    return HeldObject(name, **numbers)


_SHIPPED: Mapping[str, Mapping[str, float]] = {
    "soft-ball": {
        "friction": 0.8,
        "stiffness_n_per_m": 1.5e3,
        "radius_mm": 34.5,
        "axial_radius_mm": 34.5,
    },
    # bottles: cylinders of 63 mm diameter, straight over 200 mm
    "empty-bottle": {
        "friction": 0.6,
        "stiffness_n_per_m": 3e3,
        "radius_mm": 31.5,
        "half_length_mm": 100.0,
    },
    "basket-ball": {
        "friction": 0.8,
        "stiffness_n_per_m": 5e3,
        "axial_radius_mm": 30.0,
    },
    "hard-ball": {"friction": 0.6, "stiffness_n_per_m": 1e5, "axial_radius_mm": 30.0},
    "full-bottle": {
        "friction": 0.6,
        "stiffness_n_per_m": 2e4,
        "radius_mm": 31.5,
        "half_length_mm": 100.0,
    },
    # taller than wide
    "apple": {
        "friction": 0.5,
        "stiffness_n_per_m": 2e4,
        "radius_mm": 33.25,
        "axial_radius_mm": 43.25,
    },
}
OBJECTS = {
    name: held_object(name, {"mass_g": MASSES_G[name], **values})
    for name, values in _SHIPPED.items()
}
"""Shipped objects by name; their masses are the thesis'."""
NO_OBJECT = held_object("no-object", {"mass_g": 0.1})
"""In the files of an empty hand that is touched: nothing, which weighs next to nothing."""


def sensed_of(hand: HandCard, forces_n: FloatArray) -> FloatArray:
    """Of forces [.., S, 3] those on contacts that have a sensor; the same array where all have."""
    if hand.n_sensors == hand.n_contacts:
        return forces_n
    return forces_n[..., hand.sensed, :]


def read_of(hand: HandCard, rows: Reported) -> Reported:
    """Rows [n, S, 3] with 0.0 on the axes that the hand does not measure; after all effects."""
    if not hand.unmeasured_names:
        return rows
    flat = rows.values.reshape(len(rows.values), -1)
    values = fill_unmeasured(flat, hand).reshape(rows.values.shape)
    return replace(rows, values=values)


HELD = {
    "mass_g": OBJECT_KEYS["mass_g"],
    "friction": OBJECT_KEYS["friction"],
    "kinetic_share": OBJECT_KEYS["kinetic_share"],
}
"""Numbers of the object that a row may draw for every trial."""
HOLD = {
    **HELD,
    "used": Parameter(0.4, "", 0.01, 1.0, "friction used by the hold's largest load"),
    "fingers_down": Parameter(
        0.0,
        "",
        -1,
        1,
        "share of gravity along the thumb's axis, 1: the fingers lie below",
    ),
    "turn_deg": Parameter(
        0.0, "deg", -360, 360, "hand turned about the thumb's axis, 0: held upright"
    ),
    "push_along_thumb": Parameter(
        0.0, "", -1, 1, "share of the taking along the thumb's axis"
    ),
    "push_turn_deg": Parameter(
        0.0, "deg", -360, 360, "direction of taking, 0: away from the palm, 90: up"
    ),
}
"""Further parameters of every action, drawn only where a row names them."""

TOUCH = {
    "touching": Parameter(
        6.0, "", 2, 32, "pads that touch, at least one a side; the others stay open"
    ),
    "patch_mm": Parameter(
        {"uniform": [6, 12]}, "mm", 0.5, 100, "radius of contact of a soft pad"
    ),
    "press_off_mm": Parameter(
        2.0, "mm", 0, 50, "middle of that contact off the middle of the pad (sd)"
    ),
}
"""Parameters of how a hand touches: drawn only where the scene gives one or the hand has pads."""


def touch_parameters(values: Mapping[str, Any], hand: HandCard) -> dict[str, Parameter]:
    """Those of TOUCH that matter for a trial; none for a hand of single sensors."""
    names = [name for name in TOUCH if name in values]
    if hand.has_pads:
        names += [name for name in ("patch_mm", "press_off_mm") if name not in names]
    return {name: TOUCH[name] for name in TOUCH if name in names}


def load_factors(
    hand: HandCard, drawn: Mapping[str, float], rng: np.random.Generator
) -> FloatArray:
    """[S] how the hand touches, as factors of the contacts' shares: 0 for one that stays open."""
    factors = np.ones(hand.n_contacts)
    for pad in hand.pads:
        if len(pad) > 1:
            off_m = 1e-3 * drawn["press_off_mm"] * rng.normal(size=2)
            patch_m = 1e-3 * drawn["patch_mm"]
            factors[pad] = pad_pressure(hand, pad, patch_m, off_m)
    if "touching" in drawn:
        factors[open_contacts(hand, round(drawn["touching"]), rng)] = 0.0
    return factors


def pad_pressure(
    hand: HandCard, pad: list[int], patch_m: float, off_m: FloatArray
) -> FloatArray:
    """Pressure on each taxel of a soft pad, over that in the middle of the contact.

    p ~ sqrt(1 - (r / a)^2), r the distance from the middle of contact and a its radius patch_m
    (Hertz; Johnson, "Contact mechanics", 1985, 3.57). off_m [2]: that middle across and along, from
    the middle of the pad. Where no taxel lies in the contact, the nearest bears all.
    """
    places_m = np.stack([hand.across_m[pad], hand.along_m[pad]])
    from_middle_m = places_m - places_m.mean(axis=1, keepdims=True) - off_m[:, None]
    distance_m = np.hypot(from_middle_m[0], from_middle_m[1])

    inside = 1.0 - (distance_m / patch_m) ** 2
    pressure: FloatArray = np.sqrt(np.maximum(inside, 0.0))
    if not pressure.any():
        pressure[distance_m.argmin()] = 1.0
    return pressure


def open_contacts(hand: HandCard, touching: int, rng: np.random.Generator) -> list[int]:
    """The contacts of the pads that stay open, chosen at random; one pad a side touches."""
    pads = hand.pads
    touched_sides = set()
    others = []
    for k in rng.permutation(len(pads)):
        is_thumb = pads[k][0] < hand.thumb
        if is_thumb in touched_sides:
            others.append(pads[k])
        touched_sides.add(is_thumb)

    still_open: list[int] = []
    for pad in others[max(0, touching - 2) :]:
        still_open += pad
    return still_open


def hand_of_counts(thumb: int = 2, finger: int = 1) -> HandCard:
    """A hand by its numbers of contacts on thumb and each finger; default: the thesis' hand.

    Each contact has an equal part of its finger's stiffness, the thumb's being that of two.
    """
    contacts = []
    for k, place_mm in enumerate(_spread(THUMB_MM, thumb), 1):
        contacts.append(
            HandContact(f"thumb-{k}", "thumb", place_mm, stiffness=2.0 / thumb)
        )
    for number, middle_mm in enumerate(FINGERS_AT_MM, 1):
        for k, place_mm in enumerate(_spread(FINGER_MM, finger), 1):
            contacts.append(
                HandContact(
                    f"finger-{number}-{k}",
                    "opposing",
                    place_mm + middle_mm,
                    stiffness=1.0 / finger,
                )
            )
    return HandCard(f"{thumb} and {finger} contacts", tuple(contacts))


def _spread(width_mm: float, count: int) -> list[float]:
    """Middles of equal parts of a width, centred on 0, the uppermost first."""
    places: list[float] = (width_mm * (0.5 - (np.arange(count) + 0.5) / count)).tolist()
    return places
