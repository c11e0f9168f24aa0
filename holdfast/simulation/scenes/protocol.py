"""How a trial is drawn: the object, the grip, and every parameter of its action."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.hand_card import HandCard
from holdfast.simulation.actions import EMPTY_HANDED, parameters_of
from holdfast.simulation.effects.effect import draw_all, stream
from holdfast.simulation.physics.body import GRAVITY_M_S2
from holdfast.simulation.physics.objects import (
    HeldObject,
    load_factors,
    touch_parameters,
)


@dataclass(frozen=True)
class TrialsRow:
    """One [[trials]] of the file.

    objects  names of the objects; empty for the empty hand
    action   what happens
    style    whose ranges the values are drawn from
    count    trials of each object
    values   of the action's parameters: the file's over those of the style
    """

    objects: tuple[str, ...]
    action: str
    style: str
    count: int
    values: Mapping[str, Any]


@dataclass(frozen=True)
class PlannedTrial:
    """One trial to simulate, all its numbers drawn; only effects draw more.

    number          counts the trials of a scene and picks every random stream
    object          what the hand holds
    action, style   what happens, and whose ranges it was drawn from
    drawn           value of every parameter
    supported       a person keeps supporting a weak grip
    grip_n          normal force of either side
    share           [S] part of its side's grip that each contact bears
    finger_n_per_m  [S] normal stiffness of the finger at each contact
    at_m            [2, S] (y, z) of each contact
    push            [3] direction of taking
    hand            its contacts
    down            [3] direction of gravity where the row draws one; None: that of tilt and roll
    refused         draws of its hold that were refused (holds.py)
    """

    number: int
    object: HeldObject
    action: str
    style: str
    drawn: dict[str, float]
    supported: bool
    grip_n: float
    share: np.ndarray
    finger_n_per_m: np.ndarray
    at_m: np.ndarray
    push: np.ndarray
    hand: HandCard
    down: np.ndarray | None = None
    refused: int = 0

    @property
    def holds_object(self) -> bool:
        """Whether there is an object in the hand."""
        return self.action not in EMPTY_HANDED

    @property
    def kinetic_friction(self) -> float:
        """Of the object in this trial, while it slides."""
        held = self.object
        return held.friction * self.drawn["friction_factor"] * held.kinetic_share


Trials = Sequence[PlannedTrial]
"""Trials of a batch or of a set, in their order."""


def of_each(things: Sequence[Any], name: str) -> Any:
    """[B] an attribute of every trial or object of a batch."""
    return np.array([getattr(thing, name) for thing in things])


def draw_trial(
    number: int,
    held: HeldObject,
    row: TrialsRow,
    seed: int,
    hand: HandCard,
) -> PlannedTrial:
    """Draw a trial of a row from the stream of its number."""
    action = row.action
    # The order of the draws is part of the format: another one changes every simulated set.
    rng = stream(seed, number, "protocol")
    drawn = draw_all(parameters_of(action), row.values, rng)

    # Thumb and fingers press equally hard against each other: each side's shares have the sum 1.
    share = 1.0 + drawn["share_spread"] * rng.uniform(-1.0, 1.0, hand.n_contacts)
    touch: dict[str, float] = {}
    touch_table = touch_parameters(row.values, hand)
    if touch_table:
        # A stream of its own: how the hand touches shifts no other draw.
        touch_rng = stream(seed, number, "touch")
        touch = draw_all(touch_table, row.values, touch_rng)
        share = share[_leads(hand)] * load_factors(hand, touch, touch_rng)
    share[: hand.thumb] /= share[: hand.thumb].sum()
    share[hand.thumb :] /= share[hand.thumb :].sum()

    # Only a grip too weak for the weight lets an object fall.
    weak = rng.uniform() < drawn["weak_share"] or action == "fall"
    # The contacts of a hand are not equally stiff: each differs by up to a quarter.
    stiffness = rng.uniform(0.8, 1.25, hand.n_contacts)[_leads(hand)]

    return PlannedTrial(
        number,
        held,
        action,
        row.style,
        drawn | touch,
        supported=weak,
        grip_n=_grip_n(held, action, drawn, weak),
        share=share,
        finger_n_per_m=drawn["finger_n_per_m"] * stiffness * hand.part,
        at_m=_places_m(held, drawn, rng, hand),
        push=_direction(rng),
        hand=hand,
    )


def least_grip_n(held: HeldObject, friction_factor: float = 1.0) -> float:
    """Normal force a side, N, that just holds the weight by kinetic friction; inf without."""
    friction = held.friction * held.kinetic_share * friction_factor
    if friction <= 0.0:
        return np.inf
    # Both sides hold the weight, each with friction times its normal force.
    weight_n = held.mass_kg * GRAVITY_M_S2
    return weight_n / (2.0 * friction)


def _grip_n(
    held: HeldObject, action: str, drawn: dict[str, float], weak: bool
) -> float:
    """The grip of either side, N: strong enough for the weight, or weak on purpose."""
    least = least_grip_n(held, drawn["friction_factor"])
    if not weak:
        return max(drawn["grip_n"], drawn["spare"] * least)

    # A share of the least grip can be 0.03 N for a light object, which no hand can hold and no
    # sensor can see. Only an object that must fall is held with so little.
    gentlest_n = 0.0 if action == "fall" else drawn["gentlest_n"]
    return max(drawn["weak_grip"] * least, gentlest_n)


def _places_m(
    held: HeldObject,
    drawn: dict[str, float],
    rng: np.random.Generator,
    hand: HandCard,
) -> np.ndarray:
    """[2, S]: contacts lie along a cylinder, or about the apex of a ball, which fingers wrap."""
    places = 1e-3 * drawn["offset_mm"] * rng.normal(size=(2, hand.n_contacts))
    if not hand.has_pads and not hand.across_m.any():
        if not held.axial_radius_mm:
            places[1] += hand.along_m
        return places

    # A pad moves as a whole, and its taxels keep their distances on a ball too.
    places = places[:, _leads(hand)]
    at_m = np.stack([hand.across_m, hand.along_m])
    if held.axial_radius_mm:
        for pad in hand.pads:
            at_m[:, pad] -= at_m[:, pad].mean(axis=1, keepdims=True)
    return places + at_m


def _leads(hand: HandCard) -> list[int]:
    """[S] the first contact of the pad of each contact, whose draws hold for all of the pad."""
    leads = list(range(hand.n_contacts))
    for pad in hand.pads:
        for contact in pad:
            leads[contact] = pad[0]
    return leads


def _direction(rng: np.random.Generator) -> np.ndarray:
    """[3] unit vector of taking: away from the palm, up to 60 degrees up or down."""
    angle = rng.uniform(-np.pi / 3, np.pi / 3)
    return np.array([0.0, np.cos(angle), np.sin(angle)])
