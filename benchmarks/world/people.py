"""What people, a box and the wearer do in a trial, as forces on the object and as a grip.

A person is a damped spring from the object to a moving hand that never pulls harder than a cap. The
giver and the receiver hold the object by its middle and keep it from turning; a puller has it by a
point off the middle. The forces are explicit: they act on where the object was a step before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from benchmarks.world.draws import (
    G_M_S2,
    HAND,
    HAND_OVERS,
    PULLS,
    TUGS,
    WorldTrial,
    gives_up_s,
    lift_m_s2,
    moments_kg_m2,
)
from holdfast.core.contract import FloatArray
from holdfast.simulation.effects.effect import stream

GIVER_N_PER_M = 800.0
GIVER_CAP_N = 40.0
DAMPING_RATIO = 0.7
TURNING_HZ = 12.0
"""How firmly a giver and a receiver keep the object from turning."""
LETS_GO_S = {"tug": 0.05, "other": 0.2}
BOX_N_PER_M = 2e3
BOX_SIDEWAYS_N_S_PER_M = 20.0
BOX_GAP_M = 0.005
BOX_OVERSHOOT_M = 0.003
OPEN_GAP_M = 8e-3
"""Distance of an open hand's fingers from the object; its thumb is twice as far away."""
FLUCTUATES_HZ = (0.7, 1.9, 4.3)


def smooth(u: float) -> float:
    """0 below 0, 1 above 1, minimum jerk between."""
    if u <= 0.0:
        return 0.0
    if u >= 1.0:
        return 1.0
    return u * u * u * (10.0 + u * (6.0 * u - 15.0))


def smooth_rate(u: float) -> float:
    """Its derivative."""
    if u <= 0.0 or u >= 1.0:
        return 0.0
    return 30.0 * u * u * (1.0 - u) * (1.0 - u)


@dataclass
class Motion:
    """Where the object is now: middle [3], its rotation matrix [3, 3], velocity and turning [3]."""

    place_m: FloatArray
    turn: FloatArray
    speed_m_s: FloatArray
    turning_rad_s: FloatArray


@dataclass
class Push:
    """Force [3], N, and moment [3] about the object's centre of mass, N m, of all who act."""

    force_n: FloatArray
    moment_n_m: FloatArray

    def add(self, force_n: FloatArray, arm_m: FloatArray) -> None:
        """A force at arm_m [3] from the centre of mass."""
        self.force_n += force_n
        self.moment_n_m += cross(arm_m, force_n)


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """numpy's is an order slower on three numbers."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


class Script:
    """Everything that acts on the object but the hand, and what the wearer commands."""

    def __init__(self, trial: WorldTrial) -> None:
        self.trial = trial
        self._n = trial.numbers
        self._mass_kg = self._n["mass_kg"]
        self._down = trial.gravity_m_s2 / G_M_S2
        self._inertia = np.array(moments_kg_m2(trial.shape, self._n))
        rng = stream(trial.seed, trial.number, "fluctuation")
        self._phases = rng.uniform(0.0, 2.0 * math.pi, len(FLUCTUATES_HZ) + 1).tolist()
        self._open_n = OPEN_GAP_M * float(trial.stiffness[HAND.thumb :].sum())
        self._grabbed: FloatArray | None = None
        self._rests_m = 0.0

    # -- the wearer and the arm

    def place_n(self, t_s: float) -> float:
        """Where the wearer wants the fingers, as the grip that they would have there, N a side.

        Below 0 the hand is open: each finger is as far away as that force would bend it.
        """
        trial = self.trial
        closing_s = self._n["closing_s"]
        nears = smooth((t_s - trial.close_s) / closing_s)
        loads = smooth((t_s - trial.close_s - closing_s) / closing_s)
        opening_s = self._n["opening_s"]
        opens = smooth((t_s - trial.open_s) / opening_s)
        parts = smooth((t_s - trial.open_s - 0.5 * opening_s) / opening_s)
        share = loads * (1.0 - opens)
        if trial.kind == "fall-relax":
            relaxed = self._n["relaxed_to"] * trial.need_n / trial.grip_n
            gone = smooth((t_s - trial.act_s) / self._n["relaxing_s"])
            share *= 1.0 - (1.0 - min(relaxed, 1.0)) * gone
        grip_n = trial.grip_n * (1.0 + self._n["fluctuation"] * self._wave(t_s))
        return share * grip_n - (1.0 - nears + parts) * self._open_n

    def own_n(self, t_s: float) -> float:
        """The grip that the wearer commands, N a side; an open hand has none."""
        return max(self.place_n(t_s), 0.0)

    def _wave(self, t_s: float) -> float:
        """A slow fluctuation of rms 1."""
        scale = math.sqrt(2.0 / len(FLUCTUATES_HZ))
        total = 0.0
        for hz, phase in zip(FLUCTUATES_HZ, self._phases, strict=False):
            total += math.sin(2.0 * math.pi * hz * t_s + phase)
        return scale * total

    def opening(self, t_s: float) -> bool:
        """Whether the wearer's muscle signal has come."""
        return t_s >= self.trial.signal_s

    def gravity_m_s2(self, t_s: float) -> FloatArray:
        """[3] gravity in the frame of a hand that trembles and lifts."""
        n = self._n
        phase = 2.0 * math.pi * n["tremor_hz"] * t_s + self._phases[-1]
        tremor = n["tremor_m_s2"] * math.sin(phase)
        gravity = self.trial.gravity_m_s2 + tremor * self.trial.tremble
        if self.trial.kind == "pick-up":
            u = (t_s - self.trial.act_s) / n["lift_s"]
            if 0.0 < u < 1.0:
                # second derivative of the minimum-jerk path, over its peak
                bend = (60.0 * u - 180.0 * u * u + 120.0 * u**3) * math.sqrt(3.0) / 10.0
                gravity = gravity + bend * lift_m_s2(n) * self._down
        return gravity

    # -- everybody else

    def push(self, t_s: float, motion: Motion) -> Push:
        """What people and box do at t_s."""
        push = Push(np.zeros(3), np.zeros(3))
        self._give(t_s, motion, push)
        trial = self.trial
        if t_s >= trial.act_s:
            if trial.kind in (*PULLS, *TUGS):
                self._pull(t_s, motion, push)
            elif trial.kind in HAND_OVERS:
                self._receive(t_s, motion, push)
            elif trial.kind == "put-down":
                self._box(t_s, motion, push)
            elif trial.kind == "fall-weight":
                added = smooth((t_s - trial.act_s) / self._n["adding_s"])
                push.force_n += self._n["added_n"] * added * self._down
        return push

    def _give(self, t_s: float, motion: Motion, push: Push) -> None:
        """The giver, or a table, bears the weight and keeps the object where it is."""
        name = "vanish_s" if self.trial.kind == "fall-support" else "give_s"
        there = 1.0 - smooth((t_s - self.trial.give_s) / self._n[name])
        if there <= 0.0:
            return
        pull_n = self._spring_n(
            GIVER_N_PER_M, GIVER_CAP_N, -motion.place_m, -motion.speed_m_s
        )
        weight_n = self._mass_kg * self.trial.gravity_m_s2
        push.force_n += there * (pull_n - weight_n)
        push.moment_n_m += there * self._steady_n_m(motion)

    def _spring_n(
        self, n_per_m: float, cap_n: float, to_go_m: FloatArray, to_gain_m_s: FloatArray
    ) -> FloatArray:
        """[3] a damped spring whose whole pull is capped."""
        damping = 2.0 * DAMPING_RATIO * math.sqrt(n_per_m * self._mass_kg)
        pull_n = n_per_m * to_go_m + damping * to_gain_m_s
        size_n = math.sqrt(float(pull_n @ pull_n))
        return pull_n if size_n <= cap_n else pull_n * (cap_n / size_n)

    def _steady_n_m(self, motion: Motion) -> FloatArray:
        """[3] moment that turns the object back to where the hand took it."""
        w = 2.0 * math.pi * TURNING_HZ
        r = motion.turn
        # half of the skew part of a rotation: its axis times the sine of its angle
        turned = 0.5 * np.array(
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]
        )
        wanted = -w * w * turned - 2.0 * DAMPING_RATIO * w * motion.turning_rad_s
        # An axis at a time: a rod is much easier to turn about its length.
        moment: FloatArray = r @ (self._inertia * (wanted @ r))
        return moment

    def _there(self, t_s: float) -> float:
        """1 while the other person pulls, 0 after letting go."""
        trial = self.trial
        gone_s = trial.act_s + gives_up_s(trial.kind, self._n)
        lasts_s = LETS_GO_S["tug" if trial.kind in TUGS else "other"]
        return 1.0 - smooth((t_s - gone_s) / lasts_s)

    def _target(
        self, t_s: float, move_s: float, way_m: float
    ) -> tuple[FloatArray, FloatArray]:
        """([3] place in m, [3] speed in m/s) of the other person's hand, from where it took it."""
        u = (t_s - self.trial.act_s) / move_s
        push = self.trial.push
        return way_m * smooth(u) * push, way_m / move_s * smooth_rate(u) * push

    def _pull(self, t_s: float, motion: Motion, push: Push) -> None:
        """A puller has the object by a point of its own."""
        n = self._n
        kind = self.trial.kind
        names = {"pull-fast": ("fast_s", "pull_m"), "pull-slow": ("slow_s", "pull_m")}
        move, way = names.get(kind, ("tug_s", "tug_m"))
        to_m, to_m_s = self._target(t_s, n[move], n[way])
        arm_m = motion.turn @ (self.trial.grab_m - self.trial.centre_m)
        at_m = motion.place_m + motion.turn @ self.trial.grab_m
        at_m_s = motion.speed_m_s + cross(motion.turning_rad_s, at_m - motion.place_m)
        if self._grabbed is None:
            self._grabbed = at_m.copy()
        to_go_m = self._grabbed + to_m - at_m
        pull_n = self._spring_n(
            n["arm_n_per_m"], n["force_n"], to_go_m, to_m_s - at_m_s
        )
        push.add(self._there(t_s) * pull_n, arm_m)

    def _receive(self, t_s: float, motion: Motion, push: Push) -> None:
        """A receiver takes the weight over, and moves away."""
        n = self._n
        there = self._there(t_s)
        if self._grabbed is None:
            self._grabbed = motion.place_m.copy()
        to_m, to_m_s = self._target(t_s, n["move_s"], n["distance_m"])
        to_go_m = self._grabbed + to_m - motion.place_m
        pull_n = self._spring_n(
            n["receiver_arm_n_per_m"],
            n["receiver_n"],
            to_go_m,
            to_m_s - motion.speed_m_s,
        )
        taken = smooth((t_s - self.trial.act_s) / n["take_s"])
        weight_n = taken * self._mass_kg * self.trial.gravity_m_s2
        push.force_n += there * (pull_n - weight_n)
        push.moment_n_m += there * taken * self._steady_n_m(motion)

    def _box(self, t_s: float, motion: Motion, push: Push) -> None:
        """The hand comes down on a box, which takes the weight and a little more."""
        n = self._n
        up = -self._down
        height_m = float(motion.place_m @ up)
        if self._grabbed is None:
            self._grabbed = motion.place_m.copy()
            self._rests_m = height_m
        risen_m = min(
            (t_s - self.trial.act_s) * n["box_m_s"], BOX_GAP_M + BOX_OVERSHOOT_M
        )
        deep_m = self._rests_m + risen_m - BOX_GAP_M - height_m
        if deep_m <= 0.0:
            return
        rises_m_s = float(motion.speed_m_s @ up)
        damping = 2.0 * DAMPING_RATIO * math.sqrt(BOX_N_PER_M * self._mass_kg)
        box_n = BOX_N_PER_M * deep_m - damping * rises_m_s
        cap_n = n["press"] * self._mass_kg * G_M_S2
        box_n = min(max(box_n, 0.0), cap_n)
        sideways = motion.speed_m_s - rises_m_s * up
        push.force_n += box_n * up - BOX_SIDEWAYS_N_S_PER_M * self._mass_kg * sideways
        push.moment_n_m += self._steady_n_m(motion)
