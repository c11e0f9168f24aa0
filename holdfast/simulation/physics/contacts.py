"""Contacts in more detail: a brush of several elements, silicone with memory, a rough object.

And the object turns about the thumb's axis: held off its centre of mass, it pivots in the grip.
"""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, IntArray
from holdfast.simulation.effects.effect import (
    Drawn,
    Effect,
    EffectBatch,
    Parameter,
    PhysicsEffect,
)
from holdfast.simulation.physics.body import GRAVITY_M_S2, TINY, Body, State, brush_j
from holdfast.simulation.physics.objects import HeldObject
from holdfast.simulation.physics.solver import Swept, settle

MOST_ELEMENTS = 50
"""Largest number of elements of a brush that a scene may ask for."""


def pressure(count: float) -> FloatArray:
    """[E] share of the normal force on each of E elements: p ~ 1 - x^2 over the patch; sum 1.

    A soft fingertip presses hardest in the middle (Johnson, "Contact mechanics", 1985, chapter 4),
    so the outer elements reach mu N first: incipient slip. A single element bears everything and
    slips all at once.
    """
    elements = int(count)

    # From the middle of the patch, x = 0, to its edge; each element at the middle of its part.
    x = (np.arange(elements) + 0.5) / elements
    share = 1.0 - x * x
    return share / share.sum()


class Lag(PhysicsEffect):
    """Standard linear solid: N gains q, dq/dt = ratio k d(depth)/dt - q / time, stepped implicitly.

    Pressed in and held, the force falls from (1 + ratio) k depth to k depth as exp(-t / time); in
    and out again it makes a hysteresis loop (Findley, Lai & Onaran, "Creep and relaxation of
    nonlinear viscoelastic materials", 1976). Force N, stiffness N/m, time s.
    """

    kind = "lags"

    def __init__(self, batch: EffectBatch) -> None:
        stiffness = np.stack([trial.finger_n_per_m for trial in batch.trials], axis=1)
        self.stiffness = stiffness * batch.values("ratio")
        self.time_s = batch.values("time_s")
        self.held_n = np.zeros(self.stiffness.shape)

    def terms(self, dt_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(stiffness, held), [S, B] each: q after the step = held + stiffness * change of depth."""
        # Backward Euler, solved for the force q at the end of the step.
        left = 1.0 / (1.0 + dt_s / self.time_s)
        return self.stiffness * left, self.held_n * left

    def follow(
        self, change_m: FloatArray, touching: BoolArray, dt_s: FloatArray
    ) -> None:
        """Take in the change of depth; without contact the memory is lost."""
        stiffness, held = self.terms(dt_s)
        self.held_n = np.where(touching, held + stiffness * change_m, 0.0)


class Texture(PhysicsEffect):
    """Friction limit of an element times 1 + depth sin(2 pi s / wavelength + phase), s its slip.

    At a slip speed v the force swings with v / wavelength, Hz: the vibration by which skin and slip
    sensors detect slip (Johansson & Flanagan, Nat. Rev. Neurosci. 10, 2009). Each element has a
    random phase. The effect needs fine steps.
    """

    kind = "textures"

    def __init__(self, batch: EffectBatch) -> None:
        self.depth = batch.values("depth")
        # Radians of the swing for each metre of slip.
        self.per_m = 2e3 * np.pi / batch.values("wavelength_mm")
        # Phases of the most elements, so that a trial's draws do not depend on their number.
        shape = MOST_ELEMENTS, len(batch.trials[0].finger_n_per_m)
        phases = [rng.uniform(0.0, 2.0 * np.pi, shape) for rng in batch.rngs]
        self.phase = np.stack(phases, axis=2)

        # None until the first step shows how many elements a brush has.
        self.slipped_m: FloatArray | None = None

    def scale(self, slipped_m: FloatArray) -> FloatArray:
        """[E, S, B] factor of the friction limit; slipped_m [E, S, B]: slip in the last step."""
        if self.slipped_m is not None:
            slipped_m = self.slipped_m + slipped_m
        self.slipped_m = slipped_m
        place = self.per_m * slipped_m + self.phase[: len(slipped_m)]
        return 1.0 + self.depth * np.sin(place)


def gyration_m2(held: HeldObject) -> float:
    """Moment of inertia about x over the mass, m^2.

    (b^2 + c^2) / 5 of an ellipsoid, R^2 / 4 + L^2 / 3 of a cylinder of half length L (Meriam &
    Kraige, "Engineering mechanics: dynamics", table D/4).
    """
    across = 1e-3 * held.radius_mm
    axial = 1e-3 * held.axial_radius_mm
    if axial:
        return (across**2 + axial**2) / 5.0
    half = 1e-3 * held.half_length_mm
    return across**2 / 4.0 + half**2 / 3.0


class Rotation(PhysicsEffect):
    """Angle about x, rad: I d(omega)/dt = offset x F - sum of p x f over the brushes.

    p is from the object's middle. F is the weight and the inertial force of the hand's own motion
    (arm, tremor), less what people and a box carry, who are assumed to hold the object at
    its centre of mass. So the object turns only while the hand holds it, and out of the hand it
    keeps its rate. The skin in the grip damps a turn, and people and box by the share of the weight
    that they bear: c omega. I = m (gyration + offset^2), kg m^2.

    The brushes move by omega x p on top of the solver's translation. This step comes after the
    solver's, implicit in omega, with the same reweighting and the same balance of energy (operator
    splitting: Strang, SIAM J. Numer. Anal. 5, 1968; first order here). The object does not turn at
    all while friction can hold it. Left out: turning about y and z, which two fingers and more
    across the grip resist, and turning does not move its middle.
    """

    kind = "turns"

    def __init__(self, batch: EffectBatch) -> None:
        offsets = [batch.values("offset_y_mm"), batch.values("offset_z_mm")]
        self.offset_m = 1e-3 * np.array(offsets)

        # Steiner's theorem: the object turns about its middle, not about its centre of mass.
        gyration = np.array([gyration_m2(trial.object) for trial in batch.trials])
        distance_m2 = (self.offset_m * self.offset_m).sum(axis=0)
        self.inertia_m2 = gyration + distance_m2
        self.skin_n_m_s = batch.values("skin_n_m_s")
        self.people_n_m_s = batch.values("people_n_m_s")
        self.angle = np.zeros(len(batch.trials))
        self.rate = np.zeros(len(batch.trials))
        self.rho: FloatArray = np.ones(1)

    @staticmethod
    def lever_m(drawn: Drawn) -> float:
        """Distance of the centre of mass from the middle of the grip."""
        return 1e-3 * float(np.hypot(drawn["offset_y_mm"], drawn["offset_z_mm"]))

    def turn(
        self,
        body: Body,
        state: State,
        limit_m: FloatArray,
        dt_s: FloatArray,
        shaken_n: FloatArray,
    ) -> None:
        """Turn by one step; changes stretch, slip and energy of the brushes.

        shaken_n: [3, B] inertial force of the hand's motion.
        """
        inertia = body.mass_kg * self.inertia_m2

        # Out of the hand nothing turns the object: it keeps its rate.
        weight_n = body.mass_kg * body.gravity_m_s2[1:]
        carried_n = weight_n + state.agents_n[1:] + shaken_n[1:]
        in_hand = (state.normal_n > 0.0).any(axis=0)
        force_n = np.where(in_hand, carried_n, 0.0)

        # The torque about x is the x component of place x force.
        place_m = self.place_m()
        torque = place_m[0] * force_n[1] - place_m[1] * force_n[0]
        drive = inertia * self.rate + dt_s * torque

        # [2, S, B] how far a contact moves in (y, z) when the object turns by one radian.
        # The contacts stand in the frame of the hand, so the lever is from where the object is now.
        lever = body.at_m - state.position_m[1:, None]
        across = np.stack([-lever[1], lever[0]])
        drag = self._damping(body, state, across, limit_m)
        held = self._held(body, state)
        damped = inertia + dt_s * (drag + held)

        # Kept for the balance: all of it is overwritten below.
        stretch_m = state.stretch_m
        angle = self.angle
        turning_j = 0.5 * inertia * self.rate * self.rate
        had_j = state.brush_j + turning_j

        # rho starts as a single one, before the number of elements is known.
        rho = np.broadcast_to(self.rho, limit_m.shape)
        brushes = (drive, damped, body.brush_n_per_m, stretch_m, across, limit_m, dt_s)
        self.rate, self.rho, trial, length = settle(_sweep, rho, brushes)

        # The return mapping, as in the solver: rho is held, the rest has slipped.
        state.stretch_m = self.rho * trial
        slipped_m = (1.0 - self.rho) * length
        state.slip_m_s = state.slip_m_s + slipped_m / dt_s
        state.brush_j = brush_j(body, state)
        self.angle = angle + self.rate * dt_s

        # No trial may end with more energy than it had and was given.
        moved_m = self.place_m() - place_m
        given_j = (force_n * moved_m).sum(axis=0)
        # The place has moved by turning alone, so the force works on that way only.
        left_j = had_j + given_j - state.brush_j
        stuck = self._slow(inertia, left_j)

        # Where standing still is not enough, the object stays at its old angle.
        if stuck.size:
            self.angle[stuck] = angle[stuck]
            kept = self.rho[..., stuck] * stretch_m[..., stuck]
            state.stretch_m[..., stuck] = kept
            state.brush_j[stuck] = brush_j(body, state)[stuck]
        state.turned_rad = self.angle.copy()

    def place_m(self) -> FloatArray:
        """[2, B] (y, z) of the centre of mass from the object's middle, turned."""
        cos = np.cos(self.angle)
        sin = np.sin(self.angle)
        y, z = self.offset_m

        turned_y = cos * y - sin * z
        turned_z = sin * y + cos * z
        return np.stack([turned_y, turned_z])

    def _damping(
        self, body: Body, state: State, across: FloatArray, limit_m: FloatArray
    ) -> FloatArray:
        """[B] damping of the fingers along the surface, N m s/rad: of the elements that stick."""
        # Both the solver's step and the last turn must have held the element.
        holds = (self.rho == 1.0) & (state.slip_m_s == 0.0)
        touches = limit_m > 0.0
        stuck = np.where(holds & touches, body.brush_n_per_m, 0.0)

        lever_m2 = (across * across).sum(axis=0)
        stiff = stuck * lever_m2
        return body.loss_s * stiff.sum(axis=(0, 1))

    def _held(self, body: Body, state: State) -> FloatArray:
        """[B] further damping, N m s/rad: of the skin in the grip, and of people and box."""
        squares = state.agents_n * state.agents_n
        weight_n = body.mass_kg * GRAVITY_M_S2
        borne = np.sqrt(squares.sum(axis=0)) / weight_n

        in_hand = (state.normal_n > 0.0).any(axis=0)
        skin: FloatArray = np.where(in_hand, self.skin_n_m_s, 0.0)
        people: FloatArray = np.minimum(borne, 1.0) * self.people_n_m_s
        return skin + people

    def _slow(self, inertia: FloatArray, left_j: FloatArray) -> IntArray:
        """Keep the energy of motion within left_j [B], as the solver does.

        Returns the trials where standing still is not enough.
        """
        moving_j = 0.5 * inertia * self.rate * self.rate
        ratio = np.maximum(left_j, 0.0) / np.maximum(moving_j, TINY)
        share = np.sqrt(ratio)
        self.rate = self.rate * np.minimum(share, 1.0)
        return np.flatnonzero(left_j < 0.0)


def _sweep(
    rho: FloatArray,
    drive: FloatArray,
    inertia: FloatArray,
    brush: FloatArray,
    stretch: FloatArray,
    across: FloatArray,
    limit: FloatArray,
    dt_s: FloatArray,
) -> Swept:
    """One reweighting of the springs by rho: (rate [B], rho, stretch, its length).

    The sweep of solver.py with lever arms: a torque for each force, an inertia for the mass.
    """
    spring = brush * rho

    # Of a stretch only the part along the turning direction has a torque.
    along = (stretch * across[:, None]).sum(axis=0)
    pull = (spring * along).sum(axis=(0, 1))

    # A spring k at a distance r resists turning with k r^2.
    lever_m2 = (across * across).sum(axis=0)
    stiffness = (spring * lever_m2).sum(axis=(0, 1))
    rate = (drive - dt_s * pull) / (inertia + dt_s * dt_s * stiffness)

    moved = across * (rate * dt_s)
    trial = stretch + moved[:, None]
    length = np.sqrt(trial[0] * trial[0] + trial[1] * trial[1])
    held = limit / np.maximum(length, TINY)
    return rate, np.minimum(1.0, held), trial, length


EFFECTS = {
    "brush": Effect(
        pressure,
        {"count": Parameter(5.0, "", 1, MOST_ELEMENTS, "elements of each contact")},
        constant="count",
        sets="pressure",
    ),
    "texture": Effect(
        Texture,
        {
            "wavelength_mm": Parameter(
                {"uniform": [0.6, 2.0]},
                "mm",
                0.05,
                50,
                "spatial period of the roughness",
            ),
            "depth": Parameter(
                {"uniform": [0.1, 0.3]}, "", 0, 0.9, "how much friction swings"
            ),
        },
        longest_step_s=1e-3,
    ),
    "lag": Effect(
        Lag,
        {
            "ratio": Parameter(
                {"uniform": [0.1, 0.5]},
                "",
                0,
                10,
                "stiffness that relaxes over stiffness that stays",
            ),
            "time_s": Parameter(
                {"log_uniform": [0.05, 0.8]},
                "s",
                0.001,
                100,
                "time constant of relaxation",
            ),
        },
    ),
    "rotation": Effect(
        Rotation,
        {
            "offset_y_mm": Parameter(
                {"normal": [0, 5]},
                "mm",
                -100,
                100,
                "centre of mass off the grip, across",
            ),
            "offset_z_mm": Parameter(
                {"normal": [0, 15]},
                "mm",
                -200,
                200,
                "the same, along the object's axis",
            ),
            "skin_n_m_s": Parameter(
                0.0, "N m s/rad", 0, 10, "damping of a turn by the skin that grips"
            ),
            "people_n_m_s": Parameter(
                0.0,
                "N m s/rad",
                0,
                10,
                "the same by people and box, times their share of the weight",
            ),
        },
    ),
}
