"""Everyday actions with an object: what a hand lives through between taking and handing over.

    tug          a person pulls at the object and lets go again, to one side or back and forth
    stack        weight is added, laid on by hand or dropped in from a height
    relax        the wearer's grip drifts down, without any load from outside
    lift         the object stands on a table; the hand grips it and lifts it
    carry        walking: the hand swings with every step
    turn         the hand turns over and back, so gravity turns in its frame
    pour         the hand turns, the mass falls slowly, the hand turns back
    regrip       the grip goes down and up again
    touch-table  the object is put against a table and taken off again

No action is tied to an object. At the end a person takes the weight, and the hand opens. Whether
the object slips is decided by the physics; the truth is read off it (truth.py). Ranges without a
source are assumed.

What the people, the hand and the table do in them: everyday_script.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from holdfast.simulation.effect import Interval, Parameter
from holdfast.simulation.protocol import (
    GRAVITY_M_S2,
    OPENING,
    PlannedTrial,
    least_grip_n,
)
from holdfast.simulation.script_times import CATCH_S, Times

ENDING = {
    **OPENING,
    "after_s": Parameter(
        {"uniform": [0.5, 1.5]}, "s", 0, 60, "of holding on after the action"
    ),
}
"""Of every action here: how it ends."""
TURNING = {
    "turn_s": Parameter({"uniform": [0.7, 2.5]}, "s", 0.1, 60, "of turning, one way"),
    "axis_deg": Parameter(
        {"uniform": [0, 360]}, "deg", 0, 360, "direction of the horizontal axis"
    ),
}
"""Of actions that turn the hand."""
ACTIONS: dict[str, dict[str, Parameter]] = {
    "tug": {
        **ENDING,
        "peak_n": Parameter(
            {"log_uniform": [1, 50]}, "N", 0.1, 500, "largest pull on a held object"
        ),
        "lasts_s": Parameter(
            {"log_uniform": [0.03, 2]}, "s", 0.01, 10, "of the whole tug"
        ),
        "swings": Parameter(
            {"choice": [1, 1, 2, 4]},
            "",
            1,
            50,
            "pulls, each against the one before; 1: to one side",
        ),
        "arm_n_per_m": Parameter(
            {"log_uniform": [300, 2000]}, "N/m", 1, 1e5, "stiffness of the person's arm"
        ),
    },
    "stack": {
        **ENDING,
        "added_g": Parameter(
            {"log_uniform": [10, 300]}, "g", 0.1, 5000, "mass that is added"
        ),
        "add_s": Parameter(
            {"log_uniform": [0.1, 1]}, "s", 0.005, 60, "in which it is laid on by hand"
        ),
        "drop_mm": Parameter(
            {"choice": [0, 0, 10, 50, 150]},
            "mm",
            0,
            2000,
            "height from which it is dropped in; 0: laid on by hand",
        ),
        "hit_s": Parameter(
            {"uniform": [0.01, 0.04]}, "s", 0.002, 1, "duration of the hit of a drop"
        ),
    },
    "relax": {
        **ENDING,
        "left": Parameter(
            {"uniform": [0.3, 1.5]},
            "",
            0,
            20,
            "grip at the end over the least grip that holds the weight",
        ),
        "relax_s": Parameter({"uniform": [1, 6]}, "s", 0.05, 600, "of drifting down"),
    },
    # The support gives the weight in give_s. The load phase of people takes 0.1 to 0.5 s: Johansson
    # & Westling, Exp. Brain Res. 56, 1984.
    "lift": {
        **ENDING,
        "height_m": Parameter({"uniform": [0.03, 0.3]}, "m", 0, 2, "of the lift"),
        "raise_s": Parameter(
            {"uniform": [0.6, 1.5]}, "s", 0.1, 60, "from lift-off to the top"
        ),
    },
    # Objects carried while walking are accelerated up and down at the step rate by 1 to 4 m/s^2:
    # Gysin, Kaminski & Gordon, Exp. Brain Res. 149, 2003.
    "carry": {
        **ENDING,
        "walk_s": Parameter({"uniform": [2, 6]}, "s", 0.5, 600, "of walking"),
        "step_hz": Parameter({"uniform": [1.6, 2.3]}, "Hz", 0.3, 5, "steps a second"),
        "up_m_s2": Parameter(
            {"uniform": [0.5, 3.5]}, "m/s^2", 0, 30, "of the hand, up and down"
        ),
        "forward_m_s2": Parameter(
            {"uniform": [0, 1.5]}, "m/s^2", 0, 30, "of the hand, forth and back"
        ),
        "heading_deg": Parameter(
            {"uniform": [0, 360]}, "deg", 0, 360, "direction of walking"
        ),
    },
    "turn": {
        **ENDING,
        **TURNING,
        "angle_deg": Parameter({"uniform": [30, 180]}, "deg", 0, 180, "of the turn"),
        "stay_s": Parameter({"uniform": [0, 1.5]}, "s", 0, 60, "turned over"),
    },
    "pour": {
        **ENDING,
        **TURNING,
        "angle_deg": Parameter({"uniform": [40, 110]}, "deg", 0, 180, "of the turn"),
        "poured": Parameter(
            {"uniform": [0.1, 0.9]}, "", 0, 0.98, "share of the mass that leaves"
        ),
        "pour_s": Parameter({"uniform": [1, 5]}, "s", 0.1, 600, "of pouring"),
    },
    "regrip": {
        **ENDING,
        "low": Parameter(
            {"uniform": [0.6, 0.95]}, "", 0, 1, "lowest grip over the one before"
        ),
        "high": Parameter(
            {"uniform": [1.0, 1.6]}, "", 1, 10, "highest grip over the one before"
        ),
        "lasts_s": Parameter({"uniform": [0.4, 2]}, "s", 0.1, 60, "of down and up"),
    },
    "touch-table": {
        **ENDING,
        "table_m_s": Parameter(
            {"uniform": [0.02, 0.2]}, "m/s", 0.001, 2, "how fast it nears the table"
        ),
        "press_n": Parameter(
            {"log_uniform": [0.5, 8]}, "N", 0.01, 500, "largest force on the table"
        ),
        "stay_s": Parameter({"uniform": [0.1, 1]}, "s", 0, 60, "on the table"),
    },
}
"""Further parameters of each action, drawn after the common ones."""
LOADED = ("tug", "stack", "lift", "touch-table")
"""Actions whose slip begins with a load from outside; that of others begins with the slip."""
HEEL = 0.3
"""Second harmonic of the steps over the first: the heel strike."""
TABLE_GAP_M = 0.01
"""Distance of the table from the object when the action begins."""
TABLE_OVERSHOOT_M = 0.005
"""How far the table comes beyond the first touch, if the object does not give way."""
Draws = Mapping[str, float]


def _turn_s(drawn: Draws) -> float:
    """Forth, a stay, and back."""
    return 2.0 * drawn["turn_s"] + drawn.get("stay_s", drawn.get("pour_s", 0.0))


def _stack_s(drawn: Draws) -> float:
    """Until the weight rests."""
    return drawn["hit_s"] if drawn["drop_mm"] > 0.0 else drawn["add_s"]


def _table_s(drawn: Draws) -> float:
    """To the table, a stay, and back."""
    way_m = TABLE_GAP_M + TABLE_OVERSHOOT_M
    return 2.0 * way_m / drawn["table_m_s"] + drawn["stay_s"]


LASTS_S: dict[str, Callable[[Draws], float]] = {
    "tug": lambda drawn: drawn["lasts_s"],
    "stack": _stack_s,
    "relax": lambda drawn: drawn["relax_s"],
    "lift": lambda drawn: drawn["give_s"] + drawn["raise_s"],
    "carry": lambda drawn: drawn["walk_s"],
    "turn": _turn_s,
    "pour": _turn_s,
    "regrip": lambda drawn: drawn["lasts_s"],
    "touch-table": _table_s,
}
"""Duration of each action, s."""


def lasts_s(trial: PlannedTrial) -> float:
    """From the begin of the action to its end, s."""
    return LASTS_S[trial.action](trial.drawn)


def opens_s(trial: PlannedTrial, act_s: float) -> float:
    """When the hand opens: after the person has taken the weight."""
    held_s = lasts_s(trial) + trial.drawn["after_s"]
    return act_s + held_s + CATCH_S


def acting(trial: PlannedTrial, times: Times) -> list[Interval]:
    """Intervals in which the action, and the person at its end, move anything."""
    acts = (times.act, times.act + lasts_s(trial))
    return [acts, (times.open - CATCH_S, times.open)]


def largest_load_n(trial: PlannedTrial) -> float:
    """The largest force along the skin that the action asks for, N, whatever its direction."""
    drawn = trial.drawn
    mass_kg = trial.object.mass_g * 1e-3
    weight_n = mass_kg * GRAVITY_M_S2

    # A tug that pulls the way the weight does asks for the sum of both.
    if trial.action == "tug":
        return weight_n + drawn["peak_n"]

    # The hit is over when the added weight rests, so the sum is a little more than ever comes.
    if trial.action == "stack":
        more_kg = 1e-3 * drawn["added_g"]
        return weight_n + more_kg * GRAVITY_M_S2 + hit_n(trial)

    if trial.action == "lift":
        # The peak of a minimum-jerk path is 5.77 times its length over its time squared.
        peak_m_s2 = 5.77 * drawn["height_m"] / drawn["raise_s"] ** 2
        return weight_n + mass_kg * peak_m_s2

    # Both harmonics of a step at once, and forth and back across them.
    if trial.action == "carry":
        up_m_s2 = (1.0 + HEEL) * drawn["up_m_s2"]
        return weight_n + mass_kg * float(np.hypot(up_m_s2, drawn["forward_m_s2"]))

    # A table presses against the weight, but may press harder than that.
    if trial.action == "touch-table":
        return weight_n + drawn["press_n"]

    # In a turn, and while pouring or gripping anew, there is the weight and nothing else.
    return weight_n


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
