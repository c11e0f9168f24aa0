"""The actions of the thesis: hand-overs, losses, a disturbed hold, and the empty hand.

In a hand-over a person takes the object, or a box takes its weight, and the hand opens. In a loss
another person tears at the object, or its support vanishes under a weak grip.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.core.contract import GRASP, RISKY_SLIP, SAFE_SLIP
from holdfast.simulation.actions import OPENING, Action, Course
from holdfast.simulation.effects.effect import Parameter
from holdfast.simulation.scenes.script_times import (
    BOX_GAP_M,
    BOX_OVERSHOOT_M,
    CATCH_S,
    SETTLE_S,
)
from holdfast.simulation.scenes.truth import Mark, Steps, first_of

TRANSFERRED = 0.95
"""Share of the final force at which the weight counts as taken over."""


def pass_course(drawn: Mapping[str, float], act: float) -> Course:
    """The taker takes the weight, and moves after a pause."""
    # The wearer opens the hand after the taker has begun to move, not when the taker arrives.
    starts = act + drawn["wait_s"]
    opens = starts + drawn["open_after_s"]
    takes = (act, act + drawn["take_s"])
    moves = (starts, opens + drawn["opening_s"])

    # The hand may be open before the taker has carried the object all the way, or after it.
    carried_s = drawn["wait_s"] + drawn["move_s"]
    return Course([takes, moves], opens, drawn["take_s"], carried_s)


def put_down_course(drawn: Mapping[str, float], act: float) -> Course:
    """The box comes, and the hand opens later."""
    touches_s = BOX_GAP_M / drawn["box_m_s"]
    rises_s = (BOX_GAP_M + BOX_OVERSHOOT_M) / drawn["box_m_s"]
    opens = act + touches_s + drawn["open_after_s"]
    return Course([(act, act + rises_s)], opens, touches_s)


def pull_course(drawn: Mapping[str, float], act: float) -> Course:
    """The hand stays closed. A weak grip gets the whole load as the action begins."""
    moves = [(act, act + drawn["move_s"])]
    return Course(moves, taken_s=0.0, carried_s=drawn["move_s"])


def fall_course(drawn: Mapping[str, float], act: float) -> Course:
    """The hand stays closed. The interval is the time of watching, without the time to settle."""
    # The time to settle is added to every interval (script_times.busy).
    watched_s = drawn["watch_s"] - SETTLE_S
    return Course([(act, act + watched_s)], taken_s=0.0, carried_s=drawn["watch_s"])


def hold_course(drawn: Mapping[str, float], act: float) -> Course:
    """Pulses; the person has come back, and has held the object for as long, before the opening."""
    disturbed_s = drawn["times"] * drawn["every_s"]
    opens = act + disturbed_s + 2.0 * CATCH_S

    moves = [(opens - CATCH_S, opens)]
    for k in range(round(drawn["times"])):
        start = act + k * drawn["every_s"]
        moves.append((start, start + drawn["pulse_s"]))
    return Course(moves, opens)


def mark_hand_over(steps: Steps) -> None:
    """Safe while the weight goes over, and again when the hand opens."""
    at_s = steps.at_s
    onset = steps.onset
    if onset is None or onset >= steps.lost:
        return

    more: list[Mark] = [(float(at_s[onset]), SAFE_SLIP)]
    opens_s = steps.times.open
    before_opening = at_s < opens_s
    # A taker who does not wait, and a box that never does, leave no pause to see.
    pauses = steps.trial.drawn.get("wait_s", 1.0) != 0.0
    if pauses and before_opening[onset:].any():
        # The force that people and box carry in the pause before the hand opens.
        size_n = steps.change_n(onset)
        plateau_n = size_n[before_opening][-1]
        taken = first_of(size_n >= TRANSFERRED * plateau_n, onset)
        taken_s = float(at_s[onset if taken is None else taken])
        if taken_s < opens_s:
            more += [(taken_s, GRASP), (opens_s, SAFE_SLIP)]

    # The taker may have the object before the hand opens.
    steps.marks += [mark for mark in more if mark[0] < steps.gone_s]


def mark_loss(steps: Steps) -> None:
    """A pull or a fall that the grip withstands stays a grasp."""
    if steps.onset is not None and steps.gross is not None:
        steps.mark(steps.onset, RISKY_SLIP)


def mark_disturbances(steps: Steps) -> None:
    """A grasp, unless the object slips 2 mm or is lost before the hand opens."""
    lost = steps.lost
    acts = steps.at(steps.times.act)
    opens = steps.at(steps.times.open)
    stop = min(opens, lost)
    far = steps.slipped_far(min(acts, len(steps.at_s) - 1))

    if first_of(far, acts, stop) is not None:
        sliding = acts + np.flatnonzero(steps.motion.slips[acts:stop])
        if not sliding.size:
            # It has turned with the skin, which slides nowhere.
            sliding = acts + np.flatnonzero(far[acts:stop])
        steps.mark(sliding[0], RISKY_SLIP)
        if lost > opens:
            # A slip that ends before the hand opens ends as a grasp.
            steps.mark(sliding[-1], GRASP)
    if lost > opens:
        steps.marks.append((steps.times.open, SAFE_SLIP))


ACTIONS = {
    "pass": Action(
        {
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
                0.0,
                "s",
                0,
                60,
                "pause of the taker between taking the weight and moving",
            ),
            "arm_n_per_m": Parameter(
                {"log_uniform": [150, 600]},
                "N/m",
                1,
                1e5,
                "stiffness of the taker's arm",
            ),
            "cap_n": Parameter(
                {"uniform": [4, 12]}, "N", 0.1, 500, "largest pull of the taker"
            ),
        },
        pass_course,
        mark_hand_over,
    ),
    "put-down": Action(
        {
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
        put_down_course,
        mark_hand_over,
    ),
    "pull": Action(
        {
            "distance_m": Parameter(
                {"uniform": [0.15, 0.3]}, "m", 0, 3, "distance the object is torn away"
            ),
            "move_s": Parameter(
                {"uniform": [0.25, 0.5]}, "s", 0.02, 60, "duration of the move"
            ),
            "arm_n_per_m": Parameter(
                {"log_uniform": [600, 2000]},
                "N/m",
                1,
                1e5,
                "stiffness of the puller's arm",
            ),
            "cap_n": Parameter(
                {"uniform": [25, 50]}, "N", 0.1, 500, "largest pull of the puller"
            ),
        },
        pull_course,
        mark_loss,
        # Weight and pull together.
        lambda trial, weight_n: weight_n + trial.drawn["cap_n"],
    ),
    "fall": Action(
        {
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
        fall_course,
        mark_loss,
    ),
    "hold": Action(
        {
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
        hold_course,
        mark_disturbances,
    ),
    "nothing": Action(
        {
            "lasts_s": Parameter(20.0, "s", 0.5, 3600, "how long the hand stays empty"),
        }
    ),
}
