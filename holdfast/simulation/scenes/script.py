"""A batch of trials as the solver takes it: bodies, times of the steps, actions of hand and people.

Steps are fine where anything can happen (something moves, lets go, touches) and one sample long
elsewhere; a trial's steps depend on the trial alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, Self

import numpy as np

from holdfast.core.contract import FloatArray, IntArray
from holdfast.simulation.actions import EVERYDAY
from holdfast.simulation.effects.smooth import smooth
from holdfast.simulation.physics.body import (
    GRAVITY_M_S2,
    UPWARDS,
    Body,
    Floor,
    Inputs,
    Pull,
    bearer,
    offset_m,
    recess_m,
)
from holdfast.simulation.scenes.protocol import Trials, of_each
from holdfast.simulation.scenes.script_times import (
    ARM_DAMPING,
    ARM_N_PER_M,
    BOX_GAP_M,
    BOX_OVERSHOOT_M,
    CATCH_S,
    OPEN_GAP_M,
    Times,
)

GIVER_CAP_N = 40.0
"""Largest force of that arm."""
BOX_N_PER_M = 4e3
"""Stiffness of the box on which an object is set down."""
BOX_DAMPING = 40.0
"""Its damping upwards, N s/m."""
BOX_SIDEWAYS = 300.0
"""Its damping sideways, N s/m: it stands in for friction on the box."""
NO_BOX_M = -10.0
"""Height of the box of a trial that sets nothing down."""
LOSS_S = 2e-3
"""Damping of a finger along its normal over its stiffness."""


def _drawn(trials: Trials, name: str) -> FloatArray:
    """[B] a parameter that every trial has."""
    return np.array([trial.drawn[name] for trial in trials])


def body_of(trials: Trials, pressure: FloatArray) -> Body:
    """Constants of a batch; pressure [E]: share of the normal on each brush element."""
    hand = trials[0].hand
    objects = [trial.object for trial in trials]
    finger = np.stack([trial.finger_n_per_m for trial in trials], axis=1)

    # Tilt and roll turn the direction of gravity in the hand's frame.
    tilt = np.radians(_drawn(trials, "tilt_deg"))
    roll = np.radians(_drawn(trials, "roll_deg"))

    # x is the contact normal, so a tilt puts a part of the weight on one side of the grip.
    across = np.cos(tilt) * np.sin(roll)
    along = -np.cos(tilt) * np.cos(roll)
    down = np.stack([np.sin(tilt), across, along])
    for k, trial in enumerate(trials):
        if trial.down is not None:
            down[:, k] = trial.down

    # Finger and object are springs in series; a contact has its part of the object's.
    held_n_per_m = of_each(objects, "stiffness_n_per_m")
    stuff = held_n_per_m * hand.part[:, None]
    normal = finger * stuff / (finger + stuff)

    # Friction on silicone is an assumption (objects.py), so every trial varies it by a factor.
    friction = of_each(objects, "friction") * _drawn(trials, "friction_factor")

    # Each element of the brush has an equal part of a finger's stiffness along the skin.
    elements = len(pressure)
    spring = _drawn(trials, "shear_ratio") * finger / elements
    springs = np.broadcast_to(spring, (elements, *finger.shape))

    return Body(
        mass_kg=of_each(objects, "mass_kg"),
        gravity_m_s2=GRAVITY_M_S2 * down,
        curvature_per_m=of_each(objects, "curvature_per_m").T,
        straight_m=1e-3 * of_each(objects, "half_length_mm"),
        at_m=np.stack([trial.at_m for trial in trials], axis=2),
        stiffness_n_per_m=normal,
        damping_n_s_per_m=LOSS_S * normal,
        brush_n_per_m=springs.copy(),
        pressure=pressure[:, None, None],
        static=friction,
        kinetic=friction * of_each(objects, "kinetic_share"),
        thumb=hand.thumb,
    )


class Script:
    """Actions of hand and people in a batch, at any times [n, B].

    close_s, give_s, act_s, open_s     [B] times of the events
    holds, falls, sets_down, passes    [B] which trials have which action
    takes       [B] which have a person who moves the object, gently or not
    grip_n      [B] the wearer's grip of either side
    closed_m    [S, B] how far past contact a finger closes for its share of the grip
    stays_open  [S, B] fingers that do not touch
    surface_m   [S, B] how far a curved surface lies behind its apex; 0: fingers do not feel it
    push        [3, B] direction of taking
    weight_n    [B]
    boxed       there are boxes, at NO_BOX_M for trials that set nothing down
    more        the everyday actions (actions/everyday_forces.py); None in a batch without them

    There are boxes wherever one trial sets something down. An object that falls for more than a
    second meets one, so a batch keeps its boxes to its end.
    """

    def __init__(self, trials: Trials, body: Body, boxed: bool = False) -> None:
        self.trials = trials
        self.body = body
        # [B] when each person or hand acts
        times = [Times.of(trial) for trial in trials]
        self.close_s = of_each(times, "close")
        self.give_s = of_each(times, "give")
        self.act_s = of_each(times, "act")
        self.open_s = of_each(times, "open")
        # [B] which trials have which action
        actions = of_each(trials, "action")
        self.holds = actions == "hold"
        self.falls = actions == "fall"
        self.sets_down = actions == "put-down"
        self.passes = actions == "pass"
        self.takes = self.passes | (actions == "pull")
        self.boxed = boxed or bool(np.isin(actions, ("put-down", "touch-table")).any())

        # A finger that bears nothing stays open.
        shares = np.stack([trial.share for trial in trials], axis=1)
        self.stays_open = shares == 0.0
        self.grip_n = of_each(trials, "grip_n")
        # How far past contact a finger must close for its share of the grip of its side.
        self.closed_m = self.grip_n * shares / body.stiffness_n_per_m
        # Where the grip is set by friction, fingers close onto the surface under them.
        fitted = np.array(["used" in trial.drawn for trial in trials])
        middle = offset_m(body, np.zeros((2, len(trials))))
        self.surface_m = np.where(fitted, recess_m(body, middle), 0.0)
        self.push = np.stack([trial.push for trial in trials], axis=1)
        self.weight_n = body.mass_kg * GRAVITY_M_S2
        self._drawn: dict[tuple[str, float], FloatArray] = {}

        self.more: Any = None
        if not set(EVERYDAY).isdisjoint(actions):
            from holdfast.simulation.actions.everyday_forces import Everyday

            self.more = Everyday(self)

    def some(self, which: IntArray, body: Body) -> Self:
        """The script of some of its trials, which may repeat; body: theirs."""
        part = copy(self)
        part.trials = [self.trials[k] for k in which]
        part.body = body
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(part, name, np.take(value, which, axis=-1))

        part._drawn = {}
        for key, values in self._drawn.items():
            part._drawn[key] = values[which]
        if self.more is not None:
            part.more = self.more.some(which, part)
        return part

    def drawn(self, name: str, default: float = 0.0) -> FloatArray:
        """[B] a drawn parameter; the default for actions that do not have it."""
        key = name, default
        if key not in self._drawn:
            # Kept, because every chunk of steps asks for the same parameters again.
            values = [trial.drawn.get(name, default) for trial in self.trials]
            self._drawn[key] = np.array(values)
        return self._drawn[key]

    def chunk(
        self, t_s: FloatArray, closures_m: Sequence[FloatArray] | None = None
    ) -> list[Inputs]:
        """Inputs at the ends of n steps, t_s [n, B].

        closures_m: [S, B] at each, how far the fingers are closed; None: as the wearer closes them.
        """
        people = [self._giver(t_s), self._taker(t_s), self._disturber(t_s)]
        box = self._box(t_s) if self.boxed else None
        changes = None
        if self.more is not None:
            people += self.more.people(t_s)
            box = None if box is None else self.more.table(t_s, box)
            changes = self.more.changes(t_s)

        # A person who does nothing costs nothing.
        acting = [_acts(person) for person in people]
        inputs = []

        # All steps were computed at once; the solver takes them one by one.
        for k, closure_m in enumerate(closures_m or self.wearers_closures(t_s)):
            pulls = []
            for person, acts in zip(people, acting, strict=True):
                if acts[k]:
                    pulls.append(person.at(k))

            floor = None if box is None else box.at(k)
            now = None if changes is None else changes.at(k)
            inputs.append(Inputs(closure_m, tuple(pulls), floor, now))

        return inputs

    def wearers_closures(self, t_s: FloatArray) -> list[FloatArray]:
        """[S, B] at each of n times: how far the wearer closes the fingers, m.

        Beyond the object's surface; an open hand: -OPEN_GAP_M.
        """
        shut = self.shut(t_s)
        pulse = self.pulse(t_s)
        # dFn: the whole grip changes
        changed = 1.0 + self.drawn("grip_change") * pulse
        grip = changed * self.wearers_share(t_s)
        # dq: only the fingers are driven, the thumb stands still
        # times shut, so that a disturbance of the motor fades as the hand opens
        motor_m = 1e-3 * self.drawn("motor_mm") * pulse * shut

        closures = []
        for k in range(len(t_s)):
            # The way from the open hand to the depth at which the springs give the grip.
            travel_m = OPEN_GAP_M + self.closed_m * grip[k] + self.surface_m
            closure = shut[k] * travel_m - OPEN_GAP_M
            closure[self.body.thumb :] += motor_m[k]
            np.copyto(closure, -OPEN_GAP_M, where=self.stays_open)
            closures.append(closure)
        return closures

    def shut(self, t_s: FloatArray) -> FloatArray:
        """[n, B] how far the hand is closed, 0 .. 1."""
        closing = (t_s - self.close_s) / self.drawn("closing_s", 1.0)
        opening = (t_s - self.open_s) / self.drawn("opening_s", 1.0)
        return smooth(closing) - smooth(opening)

    def pulse(self, t_s: FloatArray) -> FloatArray:
        """[n, B] strength of the disturbance of a perturbed hold, 0 .. 1."""
        since = t_s - self.act_s
        every = self.drawn("every_s", 1.0)

        # Which disturbance, and how far it has gone.
        number = np.floor(since / every)
        since_this = since - number * every
        progress = since_this / self.drawn("pulse_s", 1.0)
        within = np.sin(np.pi * np.clip(progress, 0.0, 1.0))

        # Before the first and after the last disturbance there is none.
        count = np.round(self.drawn("times"))
        begun = self.holds & (number >= 0)
        disturbed = begun & (number < count)

        # sin^2 begins and ends without a jump in speed
        return np.where(disturbed, within * within, 0.0)

    def wearers_share(self, t_s: FloatArray) -> FloatArray:
        """[n, B] the wearer's grip over the one with which the hand was closed."""
        if self.more is None:
            return np.ones_like(t_s)
        share: FloatArray = self.more.grip_share(t_s)
        return share

    def still_there(self, t_s: FloatArray) -> FloatArray | float:
        """[n, B] 1 while the person who takes is there; in a closed loop people give up."""
        return 1.0

    def _giver(self, t_s: FloatArray) -> Pull:
        """The person who holds the object out until letting go; a fall's support just vanishes."""
        vanish_s = self.drawn("vanish_s", 1.0)
        give_s = self.drawn("give_s", 1.0)
        lasts = np.where(self.falls, vanish_s, give_s)
        gone = (t_s - self.give_s) / lasts
        there = 1.0 - smooth(gone)

        # The person of a disturbed hold comes back before the hand opens.
        returned = (t_s - self.open_s + CATCH_S) / (0.5 * CATCH_S)
        back = smooth(returned)
        there = np.where(self.holds, np.maximum(there, back), there)

        # Below critical damping, 2 sqrt(k m), as a human arm.
        # A study may put something stiffer in the person's place, as a thing that is fixed.
        stiffness = self.drawn("support_n_per_m", ARM_N_PER_M)
        cap_n = self.drawn("support_cap_n", GIVER_CAP_N)
        critical = np.sqrt(stiffness * self.body.mass_kg)
        damping = 2.0 * ARM_DAMPING * critical

        # The person holds the object where the hand takes it: the target does not move.
        still = np.zeros((len(t_s), *self.push.shape))
        return Pull(
            stiffness_n_per_m=there * stiffness,
            damping_n_s_per_m=there * damping,
            # Above zero, because forces are compared with it by division.
            cap_n=there * cap_n + 1e-9,
            weight_share=there,
            target_m=still,
            target_m_s=still,
        )

    def _taker(self, t_s: FloatArray) -> Pull:
        """The person who takes the object (gently, with its weight) or tears at it."""
        # A taker who has not come yet does nothing.
        grasped = self.takes & (t_s >= self.act_s)
        start = self.act_s + self.drawn("wait_s")
        move_s = self.drawn("move_s", 1.0)

        # Until the pause is over, the hand of the person stands still with the object.
        u = np.clip((t_s - start) / move_s, 0.0, 1.0)

        # The minimum-jerk path and its derivative, 30 u^2 (1 - u)^2.
        distance_m = self.drawn("distance_m")
        travel = distance_m * smooth(u)
        mean_m_s = distance_m / move_s
        speed = mean_m_s * 30.0 * u * u * (1.0 - u) * (1.0 - u)

        stiffness = self.drawn("arm_n_per_m", 1.0)
        critical = np.sqrt(stiffness * self.body.mass_kg)
        damping = 2.0 * ARM_DAMPING * critical

        # A puller bears nothing of the object's weight.
        taking = (t_s - self.act_s) / self.drawn("take_s", 1.0)
        taken = smooth(taking)
        weight = np.where(self.passes, taken, 0.0)
        there = np.where(grasped, self.still_there(t_s), 0.0)

        # The cap does not fade with the person: without a spring it limits nothing.
        return Pull(
            stiffness_n_per_m=stiffness * there,
            damping_n_s_per_m=damping * there,
            cap_n=np.broadcast_to(self.drawn("cap_n", 1.0), t_s.shape),
            weight_share=weight * there,
            target_m=travel[:, None] * self.push,
            target_m_s=speed[:, None] * self.push,
        )

    def _disturber(self, t_s: FloatArray) -> Pull:
        """A force along the object, as a share of its weight, subtracted or added."""
        # A pull downwards is a negative share of the weight borne.
        load_share = -self.drawn("load_n") / self.weight_n
        return bearer(load_share * self.pulse(t_s), np.zeros_like(t_s))

    def _box(self, t_s: FloatArray) -> Floor:
        """The box that comes from below and takes the weight."""
        # The hand comes down on the box; in the frame of the hand the box rises.
        since_s = t_s - self.act_s
        way_m = since_s * self.drawn("box_m_s", 1.0)
        risen = np.minimum(way_m, BOX_GAP_M + BOX_OVERSHOOT_M)
        height_m = risen - BOX_GAP_M
        comes = self.sets_down & (t_s >= self.act_s)

        # It takes the whole weight and a little more, but does not push the object up.
        cap = self.drawn("press") * self.weight_n + self.drawn("excess_n")

        # A hand that is held any way sets the object down the way gravity points.
        up = UPWARDS
        if any(trial.down is not None for trial in self.trials):
            up = -self.body.gravity_m_s2 / GRAVITY_M_S2

        return Floor(
            stiffness_n_per_m=BOX_N_PER_M,
            damping_n_s_per_m=BOX_DAMPING,
            sideways_n_s_per_m=BOX_SIDEWAYS,
            height_m=np.where(comes, height_m, NO_BOX_M),
            cap_n=np.broadcast_to(np.maximum(cap, 1e-9), t_s.shape),
            up=up,
        )


def _acts(person: Pull) -> list[bool]:
    """Whether a person does anything to any object in each of n steps: a spring, or a weight."""
    acts = (person.stiffness_n_per_m != 0.0) | (person.weight_share != 0.0)
    flags: list[bool] = acts.any(axis=1).tolist()
    return flags
