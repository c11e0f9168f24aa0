"""A hand held any way, and the grip that uses a drawn share of friction: drawn again if impossible.

Parameters of [[trials]] beside those of its action (protocol.py), each only where a row names it;
loaded only then. They have a random stream of their own. For example:

    [every_trial]
    mass_g = { log_uniform = [10, 800] }        # in place of the object's own
    friction = { uniform = [0.2, 1.2] }         # static, on silicone
    kinetic_share = { uniform = [0.6, 1.0] }    # kinetic over static
    used = { uniform = [0.1, 0.8] }             # friction used by the hold's largest load
    fingers_down = { uniform = [-1, 1] }        # gravity from every direction
    turn_deg = { uniform = [-180, 180] }
    push_along_thumb = { uniform = [-0.5, 0.5] }
    push_turn_deg = { uniform = [-120, 120] }   # taken from every side with a way out

Gravity may have any direction. Taking may not where the fingers leave no way out:

- Towards the palm (more than 120 degrees from away): this hand has no palm, a real one does.
- Near the thumb's axis: a pull at an angle b to the skin presses the object against one side, and
  friction mu holds it there for good where tan(b) > 1 / mu. That is from 40 degrees on at a
  friction of 1.2; with a share of 0.5 along the axis, b stays below 30 degrees.

The same holds for a box: it stands where gravity points, which must not be behind fingers, thumb
or palm. And near the thumb's axis nothing falls: the object rests on the lower side.

The friction used in a hold counts the hold's largest load:

    used = shear / (mu normal),  shear = load / (1 - normal / (R k)) + lean normal

load is the largest one along the skin, m (g sqrt(1 - s^2) + a) sqrt(1 + (d / r)^2): m the mass, s
the share of gravity along the thumb's axis, a the largest acceleration of the hand by tremor, arm,
lifting and walking, d the distance of the centre of mass from the middle of the grip (the effect
`rotation`), r the mean distance of the contacts from it. lean is what fingers beside the apex of a
curved surface push along the skin, over normal. mu is the static coefficient. A curved object that
yields is pushed further by normal / R (solver.py), R its radius across the grip, k the stiffness of
all fingers along the skin. A load of L along the thumb's axis changes the normals' sum, for the
fingers are stiffer than the thumb:

    normal = 2 grip + c L,  c = (fingers - thumb) / (fingers + thumb)

in stiffness; here with L = m g s, and less |c| m a. That load also opens one side, so the grip is
at least BOTH_CLOSED m (g |s| + a), and the friction used is smaller then. Values whose grip is
below LEAST_N or above MOST_N, which no grip holds, or which use more than kinetic friction, are
drawn again, and the draws are counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import HoldfastError
from holdfast.core.trial_layout import is_heavy
from holdfast.simulation.actions import action_named
from holdfast.simulation.effects.effect import draw_all
from holdfast.simulation.physics.body import GRAVITY_M_S2
from holdfast.simulation.physics.objects import HELD, HOLD
from holdfast.simulation.scenes.protocol import PlannedTrial, least_grip_n

LEAST_N = 0.5
"""The weakest grip of either side."""
MOST_N = 70.0
"""The strongest one (thesis, 5.1.1)."""
BOTH_CLOSED = 1.2
"""Grip over a load along the thumb's axis: four fingers are twice as stiff as two contacts of the
thumb, so they give up two thirds of a load towards it and keep the rest of their grip."""
MOST_DRAWS = 10_000
"""After so many draws the ranges of the file allow no hold."""


def in_hold(
    trial: PlannedTrial,
    values: Mapping[str, Any],
    rng: np.random.Generator,
    peak_m_s2: float,
    lever_m: float,
) -> PlannedTrial:
    """A trial with what its row draws for the hold, drawn until its grip is possible.

    rng: the hold's stream in the trial. peak_m_s2: largest acceleration of the hand by the scene's
    effects, in any direction; lever_m: distance of the centre of mass from the middle of the grip.
    Raises HoldfastError where no draw is possible.
    """
    table = {name: HOLD[name] for name in HOLD if name in values}

    for refused in range(MOST_DRAWS):
        # A trial with the object and the directions that one draw gives it.
        drawn = draw_all(table, values, rng)
        changed: dict[str, Any] = {name: drawn[name] for name in HELD if name in drawn}
        push = _direction(drawn, "push_along_thumb", "push_turn_deg", 0.0)
        tried = replace(
            trial,
            object=replace(trial.object, **changed),
            drawn=trial.drawn | drawn,
            # Upright, gravity points against z, which is 90 degrees before y.
            down=_direction(drawn, "fingers_down", "turn_deg", -90.0),
            push=trial.push if push is None else push,
        )
        if "used" not in table:
            return _named(tried)

        hold = _Hold(tried, peak_m_s2, lever_m)
        grip_n = hold.weak_n() if tried.supported else hold.firm_n()
        if LEAST_N <= grip_n <= MOST_N:
            used = tried.drawn | {"used": hold.used_at(grip_n)}
            held = replace(tried, grip_n=grip_n, drawn=used, refused=refused)
            return _named(held)

    raise HoldfastError(
        f"none of {MOST_DRAWS} draws is a hold of {LEAST_N:g} to {MOST_N:g} N a side",
        cause="mass, friction and friction used allow no such grip",
        next_step="widen their ranges in the scene file",
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


class _Hold:
    """The loads of a hold whose hand is shaken in any direction, N, but for the last two.

    skin     largest load along the skin
    axis     largest load along the thumb's axis
    stiffer  what the axial load adds to the sum of the normals at least, below 0: takes away
    bound    R k: the sum of the normals that pushes a curved object out of the hand
    leaning  what the contacts push along the skin, over the sum of their normals
    static   the static friction coefficient
    """

    def __init__(self, trial: PlannedTrial, peak_m_s2: float, lever_m: float) -> None:
        self.trial = trial
        factor = trial.drawn["friction_factor"]
        self.static = trial.object.friction * factor
        self.least_n = least_grip_n(trial.object, factor)
        along, self.across = _gravity_shares(trial)
        mass_kg = trial.object.mass_kg
        shake_n = mass_kg * (peak_m_s2 + _own_m_s2(trial))
        weight_n = mass_kg * GRAVITY_M_S2

        # Finger and object are springs in series, as in script.body_of; an open finger holds
        # nothing.
        thumb = trial.hand.thumb
        touches = trial.share > 0.0
        stuff = trial.object.stiffness_n_per_m * trial.hand.part
        fingers = np.where(touches, trial.finger_n_per_m, 0.0)
        springs = fingers * stuff / (fingers + stuff)
        of_thumb = float(springs[:thumb].sum())
        of_fingers = float(springs[thumb:].sum())
        lean = (of_fingers - of_thumb) / (of_fingers + of_thumb)
        along_skin = trial.drawn["shear_ratio"] * float(fingers.sum())

        # A torque is friction too: of contacts at a mean distance r, a load at d needs as much as
        # one of sqrt(1 + d^2 / r^2) times its size at the middle.
        reach_m = np.hypot(*trial.at_m)[touches].mean()
        turning = np.hypot(1.0, lever_m / max(reach_m, 1e-6))

        self.skin = (weight_n * self.across + shake_n) * turning
        self.axis = weight_n * abs(along) + shake_n
        self.stiffer = lean * weight_n * along - abs(lean) * shake_n
        self.bound = 1e-3 * trial.object.radius_mm * along_skin
        # A finger beside the apex of a curved surface pushes along the skin too; half of the
        # normals' sum is on either side.
        push = (_slopes(trial) * trial.share).sum(axis=1)
        self.leaning = 0.5 * float(np.hypot(*push))

    def weak_n(self) -> float:
        """A grip too weak for the weight along the skin, as the action's own rule has it."""
        return self.trial.drawn["weak_grip"] * self.least_n * self.across

    def firm_n(self) -> float:
        """The grip that uses the drawn share of friction, both sides closed; inf: none does.

        used = shear / (mu normal), solved for the smaller of two sums of the normals.
        """
        used = self.trial.drawn["used"]
        friction = self.static * used - self.leaning

        # Above the kinetic limit the first patch that slides takes the whole hold with it.
        if friction <= 0.0 or used > self.trial.object.kinetic_share:
            return np.inf

        needed_n = self.skin / friction
        left = 1.0 - 4.0 * needed_n / self.bound
        if left < 0.0:
            return np.inf
        normal_n = 0.5 * self.bound * (1.0 - np.sqrt(left))
        grip_n = 0.5 * (normal_n - self.stiffer)
        return float(max(grip_n, BOTH_CLOSED * self.axis))

    def used_at(self, grip_n: float) -> float:
        """Friction that the largest load uses, over what there is; inf: none holds it."""
        normal_n = 2.0 * grip_n + self.stiffer
        left = 1.0 - normal_n / self.bound
        if min(normal_n, left, self.static) <= 0.0:
            return np.inf
        return (self.skin / (normal_n * left) + self.leaning) / self.static


def _gravity_shares(trial: PlannedTrial) -> tuple[float, float]:
    """(share of gravity along the thumb's axis, share along the skin), the largest in the hold."""
    if trial.action in ("turn", "pour"):
        # The hand turns over, so all of the weight may come along either.
        return 1.0, 1.0
    tilted = np.sin(np.radians(trial.drawn["tilt_deg"]))
    along = float(tilted if trial.down is None else trial.down[0])
    return along, float(np.sqrt(1.0 - along * along))


def _own_m_s2(trial: PlannedTrial) -> float:
    """Largest acceleration of the hand by the action itself."""
    if trial.action not in ("lift", "carry"):
        return 0.0
    mass_kg = trial.object.mass_kg
    weight_n = mass_kg * GRAVITY_M_S2
    load_n = action_named(trial.action).load_n(trial, weight_n)
    return (load_n - weight_n) / mass_kg


def _slopes(trial: PlannedTrial) -> FloatArray:
    """[2, S] slope of the surface under each contact, across the grip and along the axis."""
    half_m = 1e-3 * trial.object.half_length_mm
    across_m, along_m = trial.at_m
    beyond_m = along_m - np.clip(along_m, -half_m, half_m)
    curvature = np.array(trial.object.curvature_per_m)
    return curvature[:, None] * np.stack([across_m, beyond_m])
