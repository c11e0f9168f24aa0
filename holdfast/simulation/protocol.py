"""What hand and people do in a trial: the parameters of every action, and how a trial is drawn.

The hand grips the object that a person holds out, the person lets go, the hand holds for a while,
and then:

    pass        another person takes it slowly, and the hand opens (wait_s: after a pause)
    pull        another person tears at it
    fall        the support vanishes under a grip too weak for the weight
    put-down    a box comes from below and takes the weight; later the hand opens
    hold        disturbances only: of grip (dFn), load (dFt) or motor (dq)
    nothing     the hand stays open and empty

Further actions are in modules of their own, loaded where a scene names one (ACTION_MODULES).

Every action may also have a weak grip with support (weak_share), so that a weak grip does not
announce a fall.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.hand_card import HandCard
from holdfast.core.trial_layout import VOLUNTARY_ACTIONS
from holdfast.simulation.effect import Parameter, draw_all, stream
from holdfast.simulation.objects import HeldObject, load_factors, touch_parameters

GRAVITY_M_S2 = 9.81
"""Acceleration of gravity."""
HOLD_KEYS = (
    "mass_g",
    "friction",
    "kinetic_share",
    "used",
    "fingers_down",
    "turn_deg",
    "push_along_thumb",
    "push_turn_deg",
)
"""Further keys of [[trials]] of any action (holds.py): drawn only where a row names them."""
NEVER_S = 1e9
"""Time of an event that a trial does not have, s: later than any trial lasts."""

COMMON = {
    "close_at_s": Parameter(
        {"uniform": [2.6, 3.4]}, "s", 0.05, 100, "when the hand begins to close"
    ),
    "closing_s": Parameter(
        {"uniform": [0.3, 0.5]}, "s", 0.05, 5, "how long closing takes"
    ),
    "grip_n": Parameter(
        {"uniform": [2.5, 6.0]}, "N", 0.1, 70, "normal force of either side"
    ),
    "spare": Parameter(
        {"uniform": [1.4, 2.2]},
        "",
        1,
        20,
        "smallest ratio of the grip to the least grip that holds the weight",
    ),
    "weak_share": Parameter(
        0.25,
        "",
        0,
        1,
        "share of trials with a weak grip, which the person keeps supporting",
    ),
    "weak_grip": Parameter(
        {"uniform": [0.2, 0.75]},
        "",
        0,
        1,
        "ratio of a weak grip to the least grip that holds the weight",
    ),
    "gentlest_n": Parameter(
        0.5,
        "N",
        0,
        70,
        "the weakest grip of the hand; only an object that must fall is held with less",
    ),
    "give_after_s": Parameter(
        {"uniform": [0.15, 0.4]},
        "s",
        0,
        10,
        "from closed hand until the person begins to let go",
    ),
    "give_s": Parameter(
        {"uniform": [0.2, 0.5]}, "s", 0.01, 10, "how long letting go takes"
    ),
    "hold_s": Parameter(
        {"uniform": [2.5, 4.0]}, "s", 0.8, 600, "from closed hand to the action"
    ),
    "tail_s": Parameter(
        {"uniform": [2.0, 3.0]}, "s", 0.2, 600, "the empty hand after the action"
    ),
    "tilt_deg": Parameter(
        {"normal": [0, 6]}, "deg", -60, 60, "of the hand, thumb side down"
    ),
    "roll_deg": Parameter(
        {"normal": [0, 6]}, "deg", -60, 60, "of the hand about the thumb's axis"
    ),
    "finger_n_per_m": Parameter(
        {"uniform": [400, 900]}, "N/m", 50, 1e7, "normal stiffness of a finger"
    ),
    "shear_ratio": Parameter(
        {"uniform": [1.0, 1.6]},
        "",
        0.01,
        100,
        "stiffness along the surface over normal",
    ),
    "share_spread": Parameter(
        0.2, "", 0, 0.9, "spread of the fingers' shares of the grip"
    ),
    "offset_mm": Parameter(
        1.0, "mm", 0, 20, "distance of a contact from the apex of a curved object (sd)"
    ),
    "friction_factor": Parameter(
        {"normal": [1.0, 0.08]}, "", 0, 3, "factor of the object's friction"
    ),
}
"""Parameters of every action, in the order in which they are drawn."""
OPENING = {
    "opening_s": Parameter(
        {"uniform": [0.3, 0.5]}, "s", 0.05, 10, "how long opening takes"
    ),
}
"""Of actions at whose end the hand opens."""
ACTIONS: dict[str, dict[str, Parameter]] = {
    "pass": {
        **OPENING,
        "distance_m": Parameter(
            {"uniform": [0.08, 0.25]}, "m", 0, 3, "how far the taker carries it"
        ),
        "move_s": Parameter(
            {"uniform": [1.0, 2.2]}, "s", 0.05, 60, "duration of the move"
        ),
        "open_after_s": Parameter(
            {"uniform": [0.25, 0.8]}, "s", 0, 60, "from taking to opening"
        ),
        "take_s": Parameter(
            {"uniform": [0.2, 0.6]},
            "s",
            0.01,
            60,
            "time in which the taker takes over the weight",
        ),
        "wait_s": Parameter(
            0.0, "s", 0, 60, "pause of the taker between taking the weight and moving"
        ),
        "arm_n_per_m": Parameter(
            {"log_uniform": [150, 600]}, "N/m", 1, 1e5, "stiffness of the taker's arm"
        ),
        "cap_n": Parameter(
            {"uniform": [4, 12]}, "N", 0.1, 500, "largest pull of the taker"
        ),
    },
    "pull": {
        "distance_m": Parameter(
            {"uniform": [0.15, 0.3]}, "m", 0, 3, "distance the object is torn away"
        ),
        "move_s": Parameter(
            {"uniform": [0.25, 0.5]}, "s", 0.02, 60, "duration of the move"
        ),
        "arm_n_per_m": Parameter(
            {"log_uniform": [600, 2000]}, "N/m", 1, 1e5, "stiffness of the puller's arm"
        ),
        "cap_n": Parameter(
            {"uniform": [25, 50]}, "N", 0.1, 500, "largest pull of the puller"
        ),
    },
    "fall": {
        "vanish_s": Parameter(
            {"uniform": [0.02, 0.06]},
            "s",
            0.001,
            10,
            "time in which the support vanishes",
        ),
        "watch_s": Parameter(
            1.0, "s", 0.1, 60, "time observed after the support vanishes"
        ),
    },
    "put-down": {
        **OPENING,
        "box_m_s": Parameter(
            {"uniform": [0.02, 0.06]},
            "m/s",
            0.001,
            2,
            "how fast the hand comes down on the box",
        ),
        "press": Parameter(
            {"uniform": [1.0, 1.3]}, "", 1, 50, "force on the box over the weight"
        ),
        "excess_n": Parameter(
            {"uniform": [0.0, 0.5]},
            "N",
            0,
            100,
            "constant part of the force on the box",
        ),
        "open_after_s": Parameter(
            {"uniform": [1.5, 3.0]}, "s", 0, 60, "from touching the box to opening"
        ),
    },
    "hold": {
        **OPENING,
        "grip_change": Parameter(
            0.0, "", -1, 5, "dFn: change of grip at a disturbance, over the grip"
        ),
        "load_n": Parameter(
            0.0, "N", -50, 50, "dFt: force along the object at a disturbance"
        ),
        "motor_mm": Parameter(
            0.0,
            "mm",
            -20,
            20,
            "dq: travel of the fingers (not the thumb) at a disturbance",
        ),
        "times": Parameter(3.0, "", 0, 100, "number of disturbances"),
        "every_s": Parameter(
            {"uniform": [0.8, 1.4]}, "s", 0.2, 60, "from one to the next"
        ),
        "pulse_s": Parameter(
            {"uniform": [0.1, 0.4]}, "s", 0.01, 10, "how long one lasts"
        ),
    },
    "nothing": {
        "lasts_s": Parameter(20.0, "s", 0.5, 3600, "how long the hand stays empty"),
    },
}
"""Further parameters of each action, drawn after the common ones."""
EVERYDAY = (
    *("tug", "stack", "relax", "lift", "carry", "turn", "pour", "regrip"),
    "touch-table",
)
ACTION_MODULES = {
    **dict.fromkeys(EVERYDAY, "everyday"),
    **dict.fromkeys(("stroke", "tap"), "pads"),
}
"""Actions that few scenes name, and the module of this package that has each."""
ALL_ACTIONS = (*ACTIONS, *ACTION_MODULES)
EMPTY_HANDED = ("nothing", "stroke", "tap")
"""Actions of a hand that holds no object."""


def action_module(action: str) -> Any:
    """The module of an action of ACTION_MODULES; loads it."""
    return importlib.import_module(f"holdfast.simulation.{ACTION_MODULES[action]}")


def parameters_of(action: str) -> dict[str, Parameter]:
    """All parameters of an action in the order in which they are drawn."""
    if action in ACTIONS:
        return COMMON | ACTIONS[action]
    own: dict[str, Parameter] = action_module(action).ACTIONS[action]
    return COMMON | own


def may_slip(action: str) -> bool:
    """Whether an object that leaves the hand in this action is a drop that a hand should prevent.

    Not so in a hand-over, and not in a disturbed hold, whose drops are counted apart.
    """
    if action in EMPTY_HANDED or action == "hold":
        return False
    return action not in VOLUNTARY_ACTIONS


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


def draw_trial(
    number: int,
    held: HeldObject,
    action: str,
    style: str,
    values: Mapping[str, Any],
    seed: int,
    hand: HandCard,
) -> PlannedTrial:
    """Draw a trial from the stream of its number; values: the scene's over those of its style."""
    # The order of the draws is part of the format: another one changes every simulated set.
    rng = stream(seed, number, "protocol")
    drawn = draw_all(parameters_of(action), values, rng)

    # Thumb and fingers press equally hard against each other: each side's shares have the sum 1.
    share = 1.0 + drawn["share_spread"] * rng.uniform(-1.0, 1.0, hand.n_contacts)
    touch: dict[str, float] = {}
    touch_table = touch_parameters(values, hand)
    if touch_table:
        # A stream of its own: how the hand touches shifts no other draw.
        touch_rng = stream(seed, number, "touch")
        touch = draw_all(touch_table, values, touch_rng)
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
        style,
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
    weight_n = held.mass_g * 1e-3 * GRAVITY_M_S2
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
