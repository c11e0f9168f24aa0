"""What the solver steps: the held object and its contacts, what acts on it, where everything is.

And the energy of a step: no trial ends with more than it had and was given.

Hand frame: x from the thumb to the fingers (contact normal), y across, z along the object's axis,
upwards; the origin is where the hand takes the object. Arrays are [.., B]: the trials of the batch
come last. S is the number of contacts, 6 unless a scene asks for more (objects.py); the thumb's
come first.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from typing import Self

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effects.effect import PhysicsEffects

GRAVITY_M_S2 = 9.81
"""Acceleration of gravity."""
TINY = 1e-300
"""Keeps a division by zero away."""
add = np.add.reduce
"""As numpy's sum, whose wrapper costs as much as the sum of a small batch."""


@cache
def sides(contacts: int, thumb: int) -> FloatArray:
    """[S, 1] direction in which a contact pushes: the thumb's along x, the fingers' against it."""
    return np.where(np.arange(contacts) < thumb, 1.0, -1.0)[:, None]


UPWARDS = np.array([[0.0], [0.0], [1.0]])
"""[3, 1] along the object's axis."""


@dataclass(frozen=True)
class Body:
    """The object and the contacts that hold it: constants of a batch.

    mass_kg            [B]
    gravity_m_s2       [3, B]: in the hand's frame, so tilt and roll of the hand turn it
    curvature_per_m    [2, B]: across the grip and along the object's axis
    straight_m         [B]: half length of a cylinder, 0 of a ball
    at_m               [2, S, B]: (y, z) of each contact from the object's apex or middle
    stiffness_n_per_m  [S, B]: normal, of finger and object in series
    damping_n_s_per_m  [S, B]: normal
    brush_n_per_m      [E, S, B]: spring of each element of a brush
    pressure           [E, 1, 1]: share of the normal that an element bears
    static, kinetic    [B]: friction coefficients
    stribeck_m_s       slip speed at which friction is half way from static to kinetic
    loss_s             a finger's damping along the surface over its stiffness; none while sliding
    thumb              contacts of the thumb
    """

    mass_kg: FloatArray
    gravity_m_s2: FloatArray
    curvature_per_m: FloatArray
    straight_m: FloatArray
    at_m: FloatArray
    stiffness_n_per_m: FloatArray
    damping_n_s_per_m: FloatArray
    brush_n_per_m: FloatArray
    pressure: FloatArray
    static: FloatArray
    kinetic: FloatArray
    stribeck_m_s: float = 2e-3
    loss_s: float = 2e-3
    thumb: int = 2

    @property
    def side(self) -> FloatArray:
        """[S, 1] which way each contact pushes."""
        return sides(len(self.stiffness_n_per_m), self.thumb)


class _Steps:
    """One step, or n steps with [n, ..] everywhere."""

    def at(self, k: int) -> Self:
        """One step out of several: the arrays lose their first axis."""
        return type(self)(*[array[k] for array in vars(self).values()])


@dataclass(frozen=True)
class Pull(_Steps):
    """A person: a damped spring to a moving target, who also bears a share of the weight.

    Either one step, or n steps of it, with [n, ..] everywhere:

    stiffness_n_per_m  [B]: of the arm
    damping_n_s_per_m  [B]
    cap_n              [B]: the spring never pulls harder
    weight_share       [B]: below 0 for a person who adds to the weight
    target_m           [3, B]: where the hand of the person wants the object
    target_m_s         [3, B]: velocity of that target
    """

    stiffness_n_per_m: FloatArray
    damping_n_s_per_m: FloatArray
    cap_n: FloatArray
    weight_share: FloatArray
    target_m: FloatArray
    target_m_s: FloatArray


def bearer(weight_share: FloatArray, damping_n_s_per_m: FloatArray) -> Pull:
    """A person who bears a share of the weight [n, B] wherever the object is, without a spring."""
    still = np.zeros((len(weight_share), 3, weight_share.shape[1]))
    nothing = np.zeros_like(weight_share)
    # There is no spring, so the cap of 1 N limits nothing.
    return Pull(nothing, damping_n_s_per_m, nothing + 1.0, weight_share, still, still)


@dataclass(frozen=True)
class Floor:
    """A box from below: a spring that pushes one way only, upwards, and resists sliding.

    Either one step, or n steps of it, with [n, B]:

    height_m  [B]: of its top in the hand's frame
    cap_n     [B]: it pushes no harder
    up        [3, B]: where it pushes, a unit vector, and along which its height is
    """

    stiffness_n_per_m: float
    damping_n_s_per_m: float
    sideways_n_s_per_m: float
    height_m: FloatArray
    cap_n: FloatArray
    up: FloatArray = field(default_factory=lambda: UPWARDS)

    def at(self, k: int) -> Floor:
        return replace(self, height_m=self.height_m[k], cap_n=self.cap_n[k])


@dataclass(frozen=True)
class Changes(_Steps):
    """What differs from the constants of a batch during a step; or n steps of it, with [n, ..].

    mass_kg       [B]: what is poured out is gone, what is added rests in the object
    gravity_m_s2  [3, B]: less the hand's acceleration, because the frame moves with the hand
    push_n        [3, B]: a force on the object
    """

    mass_kg: FloatArray
    gravity_m_s2: FloatArray
    push_n: FloatArray


@dataclass(frozen=True)
class Inputs:
    """What hand, people and box do during one step; closure_m [S, B]: at its end.

    changes: None where the object and the direction of gravity stay as they are.
    """

    closure_m: FloatArray
    people: tuple[Pull, ...] = ()
    floor: Floor | None = None
    changes: Changes | None = None


@dataclass
class State:
    """Where everything is: the object's motion, and the state of its contacts.

    position_m    [3, B] of the object
    velocity_m_s  [3, B] of the object
    stretch_m     [2, E, S, B] of the brush elements
    rho           [E, S, B]: share of the trial stretch that friction held in the last step
    slip_m_s      [E, S, B]: slip speed of the elements; exactly 0 where friction holds
    depth_m       [S, B]: how deep each contact is pressed in; below 0 without contact
    normal_n      [S, B]
    agents_n      [3, B]: force of people and box on the object in the last step
    brush_j       [B]: energy in the brushes
    offset_m      [2, S, B], recess_m [S, B]: of the contacts, kept from the last step
    turned_rad    [B]: angle of the object about x; 0 without the effect `rotation`
    """

    position_m: FloatArray
    velocity_m_s: FloatArray
    stretch_m: FloatArray
    rho: FloatArray
    slip_m_s: FloatArray
    depth_m: FloatArray
    normal_n: FloatArray
    agents_n: FloatArray
    brush_j: FloatArray
    offset_m: FloatArray
    recess_m: FloatArray
    turned_rad: FloatArray


def at_rest(body: Body, closure_m: FloatArray) -> State:
    """Nothing moves, nothing is stretched; closure_m [S, B]."""
    elements, contacts, batch = body.brush_n_per_m.shape
    offset = offset_m(body, np.zeros((2, batch)))
    recess = recess_m(body, offset)

    return State(
        position_m=np.zeros((3, batch)),
        velocity_m_s=np.zeros((3, batch)),
        stretch_m=np.zeros((2, elements, contacts, batch)),
        rho=np.ones((elements, contacts, batch)),
        slip_m_s=np.zeros((elements, contacts, batch)),
        depth_m=closure_m - recess,
        normal_n=np.zeros((contacts, batch)),
        agents_n=np.zeros((3, batch)),
        brush_j=np.zeros(batch),
        offset_m=offset,
        recess_m=recess,
        turned_rad=np.zeros(batch),
    )


def offset_m(body: Body, sideways_m: FloatArray) -> FloatArray:
    """[2, S, B] each contact from where the object is flat; object at sideways_m [2, B]."""
    from_apex = sideways_m[:, None] - body.at_m

    # A cylinder is straight along its axis up to its rounded ends.
    along = from_apex[1]
    half_m = body.straight_m
    straight = np.minimum(np.maximum(along, -half_m), half_m)
    from_apex[1] = along - straight
    return from_apex


def recess_m(body: Body, offset: FloatArray) -> FloatArray:
    """[S, B] how far the surface lies behind its apex at an offset [2, S, B]."""
    # A parabola with the curvature of the surface at its apex.
    curve = 0.5 * body.curvature_per_m[:, None] * offset
    curve *= offset
    return curve[0] + curve[1]


def changed(
    body: Body, changes: Changes | None
) -> tuple[Body, FloatArray | None, FloatArray | None]:
    """(body of this step, force on the object, weight that people have added), [3, B] each."""
    if changes is None:
        return body, None, None
    mass_kg = changes.mass_kg
    gravity_m_s2 = changes.gravity_m_s2
    # People take away or add a part of the weight, so it counts as a force of theirs.
    added_n = (mass_kg - body.mass_kg) * gravity_m_s2
    body = replace(body, mass_kg=mass_kg, gravity_m_s2=gravity_m_s2)
    return body, changes.push_n, added_n


def kinetic_j(body: Body, state: State) -> FloatArray:
    """Energy of the object's motion, [B] in J."""
    squares = state.velocity_m_s * state.velocity_m_s
    square = squares[0] + squares[1] + squares[2]
    return 0.5 * body.mass_kg * square


def brush_j(body: Body, state: State) -> FloatArray:
    """[B] energy in the brushes."""
    y, z = state.stretch_m
    # In place: this array is as large as all brushes of the batch.
    squares = y * y
    squares += z * z
    return 0.5 * np.einsum("eib,eib->b", body.brush_n_per_m, squares)


def normal_j(
    body: Body, closure_m: FloatArray, x_m: FloatArray, recess: FloatArray
) -> FloatArray:
    """[B] energy in the normal springs, the object at x_m [B] and its surface recessed [S, B]."""
    depth = np.maximum(closure_m - recess - body.side * x_m, 0.0)
    doubled_j = body.stiffness_n_per_m * (depth * depth)
    return 0.5 * add(doubled_j, axis=0)


def taken_by_lags_j(
    body: Body,
    old: State,
    state: State,
    closure_m: FloatArray,
    dt_s: FloatArray,
    effects: PhysicsEffects,
) -> FloatArray:
    """[B] energy that the object's own motion, not the fingers', puts into the lags."""
    # The fingers have closed already: what is left is the object's own way.
    place_before_m = body.side * old.position_m[0]
    was_m = np.maximum(closure_m - old.recess_m - place_before_m, 0.0)

    # The recess of the state is still that of the old place; the balance renews it later.
    recess = recess_m(body, offset_m(body, state.position_m[1:]))
    place_m = body.side * state.position_m[0]
    depth_m = np.maximum(closure_m - recess - place_m, 0.0)

    # The force of a lag depends on the whole change, its work on the object's part of it.
    change_m = depth_m - np.maximum(old.depth_m, 0.0)
    own_m = depth_m - was_m
    touching = state.normal_n > 0.0

    taken_j = np.zeros_like(dt_s)
    for lag in effects.lags:
        stiffness, held_n = lag.terms(dt_s)
        push_n = np.where(touching, held_n + stiffness * change_m, 0.0)
        taken_j = taken_j + (push_n * own_m).sum(axis=0)
    return taken_j


def keep_the_balance(
    body: Body, old: State, state: State, closure_m: FloatArray, given_j: FloatArray
) -> None:
    """Slow a trial that ended with more energy than it had and was given.

    Normals and brushes are solved one after the other, and the squeeze at the old place, so a long
    step can miss the balance; a fine step does not. Where stopping the object is not enough, it
    stays where it was.
    """
    state.offset_m = offset_m(body, state.position_m[1:])
    state.recess_m = recess_m(body, state.offset_m)

    # Both normal energies are at the new closure: the work of the fingers is not in the balance.
    normal_before_j = normal_j(body, closure_m, old.position_m[0], old.recess_m)
    had_j = kinetic_j(body, old) + old.brush_j + normal_before_j

    moving_j = kinetic_j(body, state)
    state.brush_j = brush_j(body, state)
    normal_after_j = normal_j(body, closure_m, state.position_m[0], state.recess_m)

    # Energy that stays even if the object stops.
    still_j = state.brush_j + normal_after_j
    has_j = moving_j + still_j
    allowed_j = had_j + given_j
    too_much = (has_j > allowed_j).nonzero()[0]
    if not too_much.size:
        return

    # The energy of motion grows with the square of the speed.
    left_j = (allowed_j - still_j)[too_much]
    ratio = np.maximum(left_j, 0.0) / np.maximum(moving_j[too_much], TINY)
    share = np.sqrt(ratio)
    state.velocity_m_s[:, too_much] *= np.minimum(share, 1.0)

    stuck = too_much[left_j < 0.0]
    if not stuck.size:
        return

    # At the old place the brushes keep what friction holds of their old stretch.
    # Their velocity is zero already, because no energy was left for it.
    held = np.minimum(state.rho, 1.0)[..., stuck]
    state.position_m[:, stuck] = old.position_m[:, stuck]
    state.stretch_m[..., stuck] = held * old.stretch_m[..., stuck]
    state.brush_j[stuck] = brush_j(body, state)[stuck]
    state.offset_m[..., stuck] = old.offset_m[..., stuck]
    state.recess_m[..., stuck] = old.recess_m[..., stuck]
