"""What people, hand and table do in the everyday actions of a batch (everyday.py).

A hand that accelerates by a feels gravity g - a, so lifting and walking change the direction and
size of gravity, and turning its direction (body.Changes).
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray, IntArray
from holdfast.simulation.actions import EVERYDAY
from holdfast.simulation.effects.smooth import smooth, smooth_change
from holdfast.simulation.physics.body import GRAVITY_M_S2, Changes, Floor, Pull, bearer
from holdfast.simulation.scenes.protocol import PlannedTrial, least_grip_n, of_each
from holdfast.simulation.scenes.script_times import (
    ARM_DAMPING,
    ARM_N_PER_M,
    BOX_GAP_M,
    CATCH_S,
)

HEEL = 0.3
"""Second harmonic of the steps over the first: the heel strike."""
TABLE_OVERSHOOT_M = 0.005
"""How far the table comes beyond the first touch, if the object does not give way."""
STARTS_S = 0.5
"""In which walking begins, and in which it ends."""


class Everyday:
    """The everyday actions of a batch, at any times [n, B]; other trials are left as they are.

    An action without a parameter has 0 in its place, or 1 where it is divided by, so most of what
    follows is nothing in other actions.

    Made of the script of the batch (script.Script), which has:

    drawn  (name, default) -> [B] a drawn parameter; the default where an action has none
    push   [3, B] direction of tugs

    down   [3, B] unit vector of gravity
    axis   [3, B] unit vector across it: of turning, or of walking
    """

    def __init__(self, script: Any) -> None:
        self.body = body = script.body
        self.drawn = script.drawn
        self.act_s = script.act_s
        self.open_s = script.open_s
        self.push = script.push

        # Which trials have which action.
        actions = of_each(script.trials, "action")
        self.any_of_them = np.isin(actions, EVERYDAY)
        self.tugs = actions == "tug"
        self.turns = np.isin(actions, ("turn", "pour"))
        self.to_table = actions == "touch-table"

        # However the hand is held, "up" and "down" follow gravity as it was when it closed.
        self.size_m_s2 = np.sqrt((body.gravity_m_s2 * body.gravity_m_s2).sum(axis=0))
        self.down = body.gravity_m_s2 / self.size_m_s2

        # A trial has one of the two: it walks, or it turns.
        heading = self.drawn("heading_deg") + self.drawn("axis_deg")
        self.axis = _across(self.down, np.radians(heading))

        # What is left of a relaxing grip, and how hard a dropped weight hits.
        self.relaxed = np.array([relaxed(trial) for trial in script.trials])
        self.hit_n = np.array([hit_n(trial) for trial in script.trials])

    def some(self, which: IntArray, script: Any) -> Everyday:
        """Those of some of its trials, which may repeat; script: theirs."""
        part = copy(self)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                setattr(part, name, np.take(value, which, axis=-1))
        part.body = script.body
        part.drawn = script.drawn
        return part

    def _done(
        self, t_s: FloatArray, name: str, after_s: FloatArray | float = 0.0
    ) -> FloatArray:
        """[n, B] how far a part of an action that takes the parameter's time has come, 0 .. 1."""
        since_s = t_s - self.act_s - after_s
        return np.clip(since_s / self.drawn(name, 1.0), 0.0, 1.0)

    def people(self, t_s: FloatArray) -> list[Pull]:
        """Who takes the object before the hand opens, and who tugs."""
        return [self._catcher(t_s), self._tugger(t_s)]

    def _catcher(self, t_s: FloatArray) -> Pull:
        """The person who bears the weight from before the hand opens, wherever the object is."""
        came = (t_s - self.open_s + CATCH_S) / (0.5 * CATCH_S)
        there = np.where(self.any_of_them, smooth(came), 0.0)

        # The damping of an arm, as in script.py.
        critical = np.sqrt(ARM_N_PER_M * self.body.mass_kg)

        # Without a spring, a lost object is not pulled back into the hand.
        return bearer(there, there * 2.0 * ARM_DAMPING * critical)

    def _tugger(self, t_s: FloatArray) -> Pull:
        """A spring whose end moves so far that a held object feels at most peak_n."""
        u = self._done(t_s, "lasts_s")
        swings = np.round(self.drawn("swings", 1.0))

        # To one side: out in the first half, then the person lets go where the object is.
        one_sided = smooth(2.0 * u)

        # Back and forth: half a sine for every pull; the person lets go after the last one.
        to_and_fro = np.sin(np.pi * swings * u)
        way = np.where(swings > 1.0, to_and_fro, one_sided)
        let_go = np.where(swings > 1.0, u >= 1.0, smooth(2.0 * u - 1.0))

        # Before the action no person pulls.
        begun = t_s >= self.act_s
        there = np.where(self.tugs & begun, 1.0 - let_go, 0.0)

        # The spring is stretched by the whole reach only where the object stands still.
        arm = self.drawn("arm_n_per_m", 1.0)
        peak_n = self.drawn("peak_n")
        reach_m = peak_n / arm
        critical = np.sqrt(arm * self.body.mass_kg)
        target_m = (reach_m * way)[:, None] * self.push

        # The arm damps the object, not the way of the pull: a fast tug is no harder than a slow.
        return Pull(
            stiffness_n_per_m=there * arm,
            damping_n_s_per_m=there * 2.0 * ARM_DAMPING * critical,
            cap_n=np.broadcast_to(peak_n + 1e-9, t_s.shape),
            weight_share=np.zeros_like(t_s),
            target_m=target_m,
            target_m_s=np.zeros_like(target_m),
        )

    def grip_share(self, t_s: FloatArray) -> FloatArray:
        """[n, B] the wearer's grip over the one with which the hand was closed."""
        # Relaxing: down to what is left, and no way back.
        lost = (1.0 - self.relaxed) * smooth(self._done(t_s, "relax_s"))

        # Down in the first half of a regrip, up in the second, without a jump in speed.
        u = self._done(t_s, "lasts_s")
        down = np.sin(np.pi * np.clip(2.0 * u, 0.0, 1.0)) ** 2
        up = np.sin(np.pi * np.clip(2.0 * u - 1.0, 0.0, 1.0)) ** 2
        lower = (self.drawn("low", 1.0) - 1.0) * down
        higher = (self.drawn("high", 1.0) - 1.0) * up
        return 1.0 - lost + lower + higher

    def changes(self, t_s: FloatArray) -> Changes:
        """Mass, gravity in the hand's frame and hits."""
        # In an accelerated frame everything is as heavy as under gravity less the acceleration.
        gravity = self._turned(t_s) - self._acceleration_m_s2(t_s)
        # A weight that drops in hits along gravity.
        hits_n = self.hit_n * np.sin(np.pi * self._done(t_s, "hit_s"))
        return Changes(self._mass_kg(t_s), gravity, hits_n[:, None] * self.down)

    def _mass_kg(self, t_s: FloatArray) -> FloatArray:
        """[n, B] what is left of a poured object, and what was added to one."""
        whole = self.body.mass_kg

        # Pouring begins when the hand has turned.
        poured = smooth(self._done(t_s, "pour_s", self.drawn("turn_s")))
        left = 1.0 - self.drawn("poured") * poured

        # What is dropped in rests in the object when the hit is over.
        by_hand = self._done(t_s, "add_s")
        dropped = self._done(t_s, "hit_s")
        is_dropped = self.drawn("drop_mm") > 0.0
        added = smooth(np.where(is_dropped, dropped, by_hand))
        return whole * left + 1e-3 * self.drawn("added_g") * added

    def _turned(self, t_s: FloatArray) -> FloatArray:
        """[n, 3, B] gravity in a hand that turns about an axis across it, and back."""
        # Forth at once, and back after the stay.
        forth = smooth(self._done(t_s, "turn_s"))
        turn_s = self.drawn("turn_s")
        stay_s = self.drawn("stay_s") + self.drawn("pour_s")
        back = smooth(self._done(t_s, "turn_s", turn_s + stay_s))
        angle = np.radians(self.drawn("angle_deg")) * (forth - back)

        # Rodrigues' rotation of a vector about an axis across it.
        beside = np.cross(self.axis, self.down, axis=0)
        along = np.cos(angle)[:, None] * self.down
        turned = along + np.sin(angle)[:, None] * beside

        # Exactly as it is in other trials, which must not depend on their batch.
        return np.where(self.turns, self.size_m_s2 * turned, self.body.gravity_m_s2)

    def _acceleration_m_s2(self, t_s: FloatArray) -> FloatArray:
        """[n, 3, B] of a hand that lifts, or walks."""
        # Lifting: the second derivative of the minimum-jerk path (Flash & Hogan, 1985), from the
        # time on at which the table bears nothing any more.
        u = self._done(t_s, "raise_s", self.drawn("give_s"))
        raise_s = self.drawn("raise_s", 1.0)
        up = self.drawn("height_m") * smooth_change(u) / (raise_s * raise_s)

        # Walking begins and ends gently.
        walk_s = self.drawn("walk_s")
        since_s = t_s - self.act_s
        begins = smooth(since_s / STARTS_S)
        ends = smooth((since_s - walk_s + STARTS_S) / STARTS_S)
        walking = begins - ends

        # The hand goes up and down once a step; the heel strike makes the way up steeper.
        angle = 2.0 * np.pi * self.drawn("step_hz") * since_s
        bounce = np.sin(angle) + HEEL * np.sin(2.0 * angle)
        up = up + walking * self.drawn("up_m_s2") * bounce

        # Forth and back a quarter of a step later, across gravity.
        forward = walking * self.drawn("forward_m_s2") * np.cos(angle)
        return forward[:, None] * self.axis - up[:, None] * self.down

    def table(self, t_s: FloatArray, box: Floor) -> Floor:
        """The boxes of a batch, with a table where an object is put against one."""
        # The hand comes down on the table, stays, and goes up again; in its frame the table moves.
        speed_m_s = self.drawn("table_m_s", 1.0)
        way_m = BOX_GAP_M + TABLE_OVERSHOOT_M
        since_s = t_s - self.act_s
        leaves_s = way_m / speed_m_s + self.drawn("stay_s")

        # Of the way to the table and of that back, how far it has come.
        near_m = np.clip(since_s * speed_m_s, 0.0, way_m)
        left_m = np.maximum((since_s - leaves_s) * speed_m_s, 0.0)
        height_m = near_m - left_m - BOX_GAP_M

        # Before and after that it is where boxes are that set nothing down.
        there = self.to_table & (height_m > -BOX_GAP_M)
        return replace(
            box,
            height_m=np.where(there, height_m, box.height_m),
            cap_n=np.where(self.to_table, self.drawn("press_n", 1.0), box.cap_n),
        )


def _across(down: FloatArray, angle: FloatArray) -> FloatArray:
    """[3, B] unit vectors across `down` [3, B], at an angle [B] in the plane across it."""
    # Any vector that is not nearly along it will do to begin with.
    other = np.eye(3)[:, np.where(np.abs(down[0]) < 0.9, 0, 1)]

    # Two unit vectors across gravity and across each other.
    first = np.cross(down, other, axis=0)
    first = first / np.sqrt((first * first).sum(axis=0))
    second = np.cross(down, first, axis=0)
    return np.cos(angle) * first + np.sin(angle) * second


def hit_n(trial: PlannedTrial) -> float:
    """Peak force of a weight that drops in, N: half a sine with the momentum of its fall."""
    drawn = trial.drawn
    if trial.action != "stack":
        return 0.0

    # Free fall, and all of its momentum in the hit: the weight stays where it lands.
    speed_m_s = np.sqrt(2.0 * GRAVITY_M_S2 * 1e-3 * drawn["drop_mm"])
    momentum_n_s = 1e-3 * drawn["added_g"] * speed_m_s
    return float(momentum_n_s * np.pi / (2.0 * drawn["hit_s"]))


def relaxed(trial: PlannedTrial) -> float:
    """What is left of a grip that relaxes, over the grip; 1 of other actions."""
    if trial.action != "relax":
        return 1.0
    least_n = least_grip_n(trial.object, trial.drawn["friction_factor"])
    return min(1.0, trial.drawn["left"] * least_n / trial.grip_n)
