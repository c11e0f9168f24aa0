"""A hand held any way, and the grip that uses a drawn share of friction: drawn again if impossible.

Parameters of [[trials]] beside those of its action (protocol.py), each only where a row names it;
loaded only then. They have a random stream of their own.

The friction used in a hold counts the hold's largest load:

    used = shear / (mu normal),  shear = load / (1 - normal / (R k))

load is the largest one along the skin, m (g sqrt(1 - s^2) + a): m the mass, s the share of gravity
along the thumb's axis, a the largest acceleration of the hand by tremor and arm. mu is the static
coefficient. A curved object that yields by d is pushed further by normal d / R (core.py), R its
radius across the grip and k the stiffness of all fingers along the skin. A load of L along the
thumb's axis changes the normals' sum, for the fingers are stiffer than the thumb:

    normal = 2 grip + c L,  c = (fingers - thumb) / (fingers + thumb)

in stiffness; here with L = m g s, and less |c| m a. That load also opens one side, so the grip is
at least BOTH_CLOSED m (g |s| + a), and the friction used is smaller then. Values whose grip is
below LEAST_N or above MOST_N, which no grip holds, or which use more than kinetic friction, are
drawn again, and the draws are counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import HoldfastError
from holdfast.core.trial_layout import is_heavy
from holdfast.simulation.effect import Parameter, draw_all
from holdfast.simulation.objects import OBJECT_KEYS
from holdfast.simulation.protocol import GRAVITY_M_S2, PlannedTrial, least_grip_n

LEAST_N = 0.5
"""The weakest grip of either side."""
MOST_N = 70.0
"""The strongest one (thesis, 5.1.1)."""
BOTH_CLOSED = 1.2
"""Grip over a load along the thumb's axis: four fingers are twice as stiff as two contacts of the
thumb, so they give up two thirds of a load towards it and keep the rest of their grip."""
MOST_DRAWS = 10_000
"""After so many draws the ranges of the file allow no hold."""

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


def in_hold(
    trial: PlannedTrial,
    values: Mapping[str, Any],
    rng: np.random.Generator,
    shake_m_s2: float,
) -> PlannedTrial:
    """A trial with what its row draws for the hold, drawn until its grip is possible.

    rng: the hold's stream in the trial; shake_m_s2: the largest acceleration of the hand. Raises
    HoldfastError where no draw is possible.
    """
    table = {name: HOLD[name] for name in HOLD if name in values}

    for refused in range(MOST_DRAWS):
        tried = _one_draw(trial, draw_all(table, values, rng))
        if "used" not in table:
            return _named(tried)

        grip_n = _weak_n(tried) if tried.supported else _firm_n(tried, shake_m_s2)
        if LEAST_N <= grip_n <= MOST_N:
            used = used_friction(tried, grip_n, shake_m_s2)
            drawn = tried.drawn | {"used": used}
            held = replace(tried, grip_n=grip_n, drawn=drawn, refused=refused)
            return _named(held)

    raise HoldfastError(
        f"none of {MOST_DRAWS} draws is a hold of {LEAST_N:g} to {MOST_N:g} N a side",
        cause="mass, friction and friction used allow no such grip",
        next_step="widen their ranges in the scene file",
    )


def _one_draw(trial: PlannedTrial, drawn: dict[str, float]) -> PlannedTrial:
    """A trial with the object and the directions that one draw gives it."""
    changed: dict[str, Any] = {name: drawn[name] for name in HELD if name in drawn}
    push = _direction(drawn, "push_along_thumb", "push_turn_deg", 0.0)
    return replace(
        trial,
        object=replace(trial.object, **changed),
        drawn=trial.drawn | drawn,
        # Upright, gravity points against z, which is 90 degrees before y.
        down=_direction(drawn, "fingers_down", "turn_deg", -90.0),
        push=trial.push if push is None else push,
    )


def _named(trial: PlannedTrial) -> PlannedTrial:
    """A trial whose object has its weight class in its name, where its mass was drawn."""
    if "mass_g" not in trial.drawn:
        return trial
    # The layout on disk has one weight class a folder.
    weight_class = "heavy" if is_heavy(trial.object.mass_g) else "light"
    name = f"{trial.object.name}-{weight_class}"
    return replace(trial, object=replace(trial.object, name=name))


def _direction(
    drawn: Mapping[str, float], along: str, turn: str, from_deg: float
) -> FloatArray | None:
    """[3] unit vector: its share along x, and its angle from y to z; None where neither is named.

    Uniform shares and angles are uniform over the sphere (Archimedes).
    """
    if along not in drawn and turn not in drawn:
        return None
    share = drawn.get(along, 0.0)
    angle = np.radians(drawn.get(turn, 0.0) + from_deg)
    across = np.sqrt(1.0 - share * share)
    return np.array([share, across * np.cos(angle), across * np.sin(angle)])


@dataclass(frozen=True)
class _Loads:
    """Of a hold, N.

    skin     largest load along the skin
    axis     largest load along the thumb's axis
    stiffer  what the axial load adds to the sum of the normals at least, below 0: takes away
    bound    R k: the sum of the normals that pushes a curved object out of the hand
    """

    skin: float
    axis: float
    stiffer: float
    bound: float


def _loads(trial: PlannedTrial, shake_m_s2: float) -> _Loads:
    """The loads of a hold whose hand is shaken in any direction."""
    along = trial.down
    tilted = np.sin(np.radians(trial.drawn["tilt_deg"]))
    share = float(tilted if along is None else along[0])
    across = float(np.sqrt(1.0 - share * share))
    mass_kg = 1e-3 * trial.object.mass_g
    shake_n = mass_kg * shake_m_s2
    weight_n = mass_kg * GRAVITY_M_S2

    # Finger and object are springs in series, as in script.body_of.
    thumb = trial.hand.thumb
    stuff = trial.object.stiffness_n_per_m * trial.hand.part
    springs = trial.finger_n_per_m * stuff / (trial.finger_n_per_m + stuff)
    of_thumb = float(springs[:thumb].sum())
    of_fingers = float(springs[thumb:].sum())
    lean = (of_fingers - of_thumb) / (of_fingers + of_thumb)

    along_skin = trial.drawn["shear_ratio"] * float(trial.finger_n_per_m.sum())
    return _Loads(
        skin=weight_n * across + shake_n,
        axis=weight_n * abs(share) + shake_n,
        stiffer=lean * weight_n * share - abs(lean) * shake_n,
        bound=1e-3 * trial.object.radius_mm * along_skin,
    )


def _static(trial: PlannedTrial) -> float:
    """The static friction coefficient."""
    return trial.object.friction * trial.drawn["friction_factor"]


def _weak_n(trial: PlannedTrial) -> float:
    """A grip too weak for the weight along the skin, as the action's own rule has it."""
    resting = _loads(trial, 0.0)
    weight_n = 1e-3 * trial.object.mass_g * GRAVITY_M_S2
    least_n = least_grip_n(trial.object, trial.drawn["friction_factor"])
    return trial.drawn["weak_grip"] * least_n * resting.skin / weight_n


def _firm_n(trial: PlannedTrial, shake_m_s2: float) -> float:
    """The grip that uses the drawn share of friction and keeps both sides closed; inf: none does.

    mu used normal (1 - normal / bound) = load, solved for the smaller sum of the normals.
    """
    loads = _loads(trial, shake_m_s2)
    used = trial.drawn["used"]
    friction = _static(trial) * used

    # Above the kinetic limit the first patch that slides takes the whole hold with it.
    if friction <= 0.0 or used > trial.object.kinetic_share:
        return np.inf

    needed_n = loads.skin / friction
    left = 1.0 - 4.0 * needed_n / loads.bound
    if left < 0.0:
        return np.inf
    normal_n = 0.5 * loads.bound * (1.0 - np.sqrt(left))
    grip_n = 0.5 * (normal_n - loads.stiffer)
    return float(max(grip_n, BOTH_CLOSED * loads.axis))


def used_friction(trial: PlannedTrial, grip_n: float, shake_m_s2: float) -> float:
    """Friction that the largest load of a hold uses, over what there is; inf: none holds it."""
    loads = _loads(trial, shake_m_s2)
    normal_n = 2.0 * grip_n + loads.stiffer
    left = 1.0 - normal_n / loads.bound
    limit_n = _static(trial) * normal_n * left
    return loads.skin / limit_n if limit_n > 0.0 else np.inf
