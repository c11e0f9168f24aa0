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

What the people, the hand and the table do in them: everyday_forces.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from holdfast.core.contract import GRASP, RISKY_SLIP, SAFE_SLIP
from holdfast.simulation.actions import OPENING, Action, Course, action_named
from holdfast.simulation.actions.everyday_forces import HEEL, TABLE_OVERSHOOT_M, hit_n
from holdfast.simulation.effects.effect import Parameter
from holdfast.simulation.physics.body import GRAVITY_M_S2
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.script_times import BOX_GAP_M, CATCH_S
from holdfast.simulation.scenes.truth import LOAD_N, Steps

Draws = Mapping[str, float]
Lasts = Callable[[Draws], float]
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
# The support gives the weight in give_s. The load phase of people takes 0.1 to 0.5 s: Johansson
# & Westling, Exp. Brain Res. 56, 1984.
# Objects carried while walking are accelerated up and down at the step rate by 1 to 4 m/s^2:
# Gysin, Kaminski & Gordon, Exp. Brain Res. 149, 2003.


def mark_slips(steps: Steps) -> None:
    """Held, then every slip, and held again where the object stays."""
    at_s = steps.at_s
    opens_s = steps.times.open
    lost = steps.lost
    loaded = action_named(steps.trial.action).loaded
    slips = steps.slips()
    ended = steps.contact
    for begin, _, end in slips:
        start = _loaded_from(steps, begin) if loaded else begin
        if start > ended:
            steps.mark(start, RISKY_SLIP)
        else:
            # The load of the slip before is still there: both are one.
            steps.marks.pop()
        ended = end
        # A slip that lasts until the hand opens ends with the opening.
        if end < lost and at_s[end] < opens_s:
            steps.mark(end, GRASP)

    # An object that is still there is handed to a person as the hand opens.
    if steps.time(lost) is None or at_s[lost] >= opens_s:
        steps.marks.append((opens_s, SAFE_SLIP))

    # The events are those of the first slip.
    if loaded:
        steps.onset = steps.slip_onset()
    if slips:
        steps.incipient, steps.gross, _ = slips[0]


def _loaded_from(steps: Steps, begin: int) -> int:
    """The step from which on the load of a slip that begins at a step has been there."""
    first = steps.at(steps.times.act)
    size_n = steps.change_n(first)[first : begin + 1]
    unloaded = np.flatnonzero(size_n <= LOAD_N)
    # A slip of a load that is below LOAD_N begins with itself.
    return min(first + int(unloaded[-1]) + 1, begin) if unloaded.size else first


def _turn_s(drawn: Draws) -> float:
    """Forth, a stay, and back."""
    return 2.0 * drawn["turn_s"] + drawn.get("stay_s", drawn.get("pour_s", 0.0))


def _stack_s(drawn: Draws) -> float:
    """How long it takes until the added weight rests, in s."""
    return drawn["hit_s"] if drawn["drop_mm"] > 0.0 else drawn["add_s"]


def _table_s(drawn: Draws) -> float:
    """To the table, a stay, and back."""
    way_m = BOX_GAP_M + TABLE_OVERSHOOT_M
    return 2.0 * way_m / drawn["table_m_s"] + drawn["stay_s"]


def _stack_n(trial: PlannedTrial, weight_n: float) -> float:
    """The hit is over when the added weight rests, so the sum is a little more than ever comes."""
    more_kg = 1e-3 * trial.drawn["added_g"]
    return weight_n + more_kg * GRAVITY_M_S2 + hit_n(trial)


def _lift_n(trial: PlannedTrial, weight_n: float) -> float:
    """The peak of a minimum-jerk path is 5.77 times its length over its time squared."""
    peak_m_s2 = 5.77 * trial.drawn["height_m"] / trial.drawn["raise_s"] ** 2
    return weight_n + trial.object.mass_kg * peak_m_s2


def _carry_n(trial: PlannedTrial, weight_n: float) -> float:
    """Both harmonics of a step at once, and forth and back across them."""
    up_m_s2 = (1.0 + HEEL) * trial.drawn["up_m_s2"]
    peak_m_s2 = float(np.hypot(up_m_s2, trial.drawn["forward_m_s2"]))
    return weight_n + trial.object.mass_kg * peak_m_s2


def _everyday(
    parameters: dict[str, Parameter],
    lasts: Lasts,
    load_n: Callable[[PlannedTrial, float], float] = Action.load_n,
    *,
    loaded: bool = False,
) -> Action:
    """An action that lasts so long, in s, and ends with the person who takes the weight."""

    def course(drawn: Draws, act: float) -> Course:
        lasts_s = lasts(drawn)
        held_s = lasts_s + drawn["after_s"]
        opens = act + held_s + CATCH_S
        return Course([(act, act + lasts_s), (opens - CATCH_S, opens)], opens)

    return Action(parameters, course, mark_slips, load_n, loaded)


ACTIONS = {
    "tug": _everyday(
        {
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
                {"log_uniform": [300, 2000]},
                "N/m",
                1,
                1e5,
                "stiffness of the person's arm",
            ),
        },
        lambda drawn: drawn["lasts_s"],
        # A tug that pulls the way the weight does asks for the sum of both.
        lambda trial, weight_n: weight_n + trial.drawn["peak_n"],
        loaded=True,
    ),
    "stack": _everyday(
        {
            **ENDING,
            "added_g": Parameter(
                {"log_uniform": [10, 300]}, "g", 0.1, 5000, "mass that is added"
            ),
            "add_s": Parameter(
                {"log_uniform": [0.1, 1]},
                "s",
                0.005,
                60,
                "in which it is laid on by hand",
            ),
            "drop_mm": Parameter(
                {"choice": [0, 0, 10, 50, 150]},
                "mm",
                0,
                2000,
                "height from which it is dropped in; 0: laid on by hand",
            ),
            "hit_s": Parameter(
                {"uniform": [0.01, 0.04]},
                "s",
                0.002,
                1,
                "duration of the hit of a drop",
            ),
        },
        _stack_s,
        _stack_n,
        loaded=True,
    ),
    "relax": _everyday(
        {
            **ENDING,
            "left": Parameter(
                {"uniform": [0.3, 1.5]},
                "",
                0,
                20,
                "grip at the end over the least grip that holds the weight",
            ),
            "relax_s": Parameter(
                {"uniform": [1, 6]}, "s", 0.05, 600, "of drifting down"
            ),
        },
        lambda drawn: drawn["relax_s"],
    ),
    "lift": _everyday(
        {
            **ENDING,
            "height_m": Parameter({"uniform": [0.03, 0.3]}, "m", 0, 2, "of the lift"),
            "raise_s": Parameter(
                {"uniform": [0.6, 1.5]}, "s", 0.1, 60, "from lift-off to the top"
            ),
        },
        lambda drawn: drawn["give_s"] + drawn["raise_s"],
        _lift_n,
        loaded=True,
    ),
    "carry": _everyday(
        {
            **ENDING,
            "walk_s": Parameter({"uniform": [2, 6]}, "s", 0.5, 600, "of walking"),
            "step_hz": Parameter(
                {"uniform": [1.6, 2.3]}, "Hz", 0.3, 5, "steps a second"
            ),
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
        lambda drawn: drawn["walk_s"],
        _carry_n,
    ),
    "turn": _everyday(
        {
            **ENDING,
            **TURNING,
            "angle_deg": Parameter(
                {"uniform": [30, 180]}, "deg", 0, 180, "of the turn"
            ),
            "stay_s": Parameter({"uniform": [0, 1.5]}, "s", 0, 60, "turned over"),
        },
        _turn_s,
    ),
    "pour": _everyday(
        {
            **ENDING,
            **TURNING,
            "angle_deg": Parameter(
                {"uniform": [40, 110]}, "deg", 0, 180, "of the turn"
            ),
            "poured": Parameter(
                {"uniform": [0.1, 0.9]}, "", 0, 0.98, "share of the mass that leaves"
            ),
            "pour_s": Parameter({"uniform": [1, 5]}, "s", 0.1, 600, "of pouring"),
        },
        _turn_s,
    ),
    "regrip": _everyday(
        {
            **ENDING,
            "low": Parameter(
                {"uniform": [0.6, 0.95]}, "", 0, 1, "lowest grip over the one before"
            ),
            "high": Parameter(
                {"uniform": [1.0, 1.6]}, "", 1, 10, "highest grip over the one before"
            ),
            "lasts_s": Parameter({"uniform": [0.4, 2]}, "s", 0.1, 60, "of down and up"),
        },
        lambda drawn: drawn["lasts_s"],
    ),
    "touch-table": _everyday(
        {
            **ENDING,
            "table_m_s": Parameter(
                {"uniform": [0.02, 0.2]}, "m/s", 0.001, 2, "how fast it nears the table"
            ),
            "press_n": Parameter(
                {"log_uniform": [0.5, 8]}, "N", 0.01, 500, "largest force on the table"
            ),
            "stay_s": Parameter({"uniform": [0.1, 1]}, "s", 0, 60, "on the table"),
        },
        _table_s,
        # A table presses against the weight, but may press harder than that.
        lambda trial, weight_n: weight_n + trial.drawn["press_n"],
        loaded=True,
    ),
}
