"""Losses: another person tears at the object, or its support vanishes under a weak grip."""

from __future__ import annotations

from collections.abc import Mapping

from holdfast.core.contract import RISKY_SLIP
from holdfast.simulation.actions import Action, Course
from holdfast.simulation.effect import Parameter
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.script_times import SETTLE_S, Times
from holdfast.simulation.stepper import TrialMotion
from holdfast.simulation.truth import Mark, Steps


def pull_course(drawn: Mapping[str, float], act: float) -> Course:
    """The hand stays closed. A weak grip gets the whole load as the action begins."""
    moves = [(act, act + drawn["move_s"])]
    return Course(moves, taken_s=0.0, carried_s=drawn["move_s"])


def fall_course(drawn: Mapping[str, float], act: float) -> Course:
    """The hand stays closed."""
    # The time to settle is added to every interval (script_times.busy).
    watched_s = drawn["watch_s"] - SETTLE_S
    return Course([(act, act + watched_s)], taken_s=0.0, carried_s=drawn["watch_s"])


def mark_loss(
    marks: list[Mark],
    trial: PlannedTrial,
    motion: TrialMotion,
    times: Times,
    steps: Steps,
) -> None:
    """A pull or a fall that the grip withstands stays a grasp."""
    if steps.onset is not None and steps.gross is not None:
        marks.append((motion.at_s[steps.onset], RISKY_SLIP))


def pull_n(trial: PlannedTrial, weight_n: float) -> float:
    """Weight and pull together."""
    return weight_n + trial.drawn["cap_n"]


PULL = {
    "distance_m": Parameter(
        {"uniform": [0.15, 0.3]}, "m", 0, 3, "distance the object is torn away"
    ),
    "move_s": Parameter(
        {"uniform": [0.25, 0.5]}, "s", 0.02, 60, "duration of the move"
    ),
    "arm_n_per_m": Parameter(
        {"log_uniform": [600, 2000]}, "N/m", 1, 1e5, "stiffness of the puller's arm"
    ),
    "cap_n": Parameter(
        {"uniform": [25, 50]}, "N", 0.1, 500, "largest pull of the puller"
    ),
}
"""Parameters of the action `pull`."""
FALL = {
    "vanish_s": Parameter(
        {"uniform": [0.02, 0.06]},
        "s",
        0.001,
        10,
        "time in which the support vanishes",
    ),
    "watch_s": Parameter(1.0, "s", 0.1, 60, "time observed after the support vanishes"),
}
"""Parameters of the action `fall`."""
ACTIONS = {
    "pull": Action(PULL, pull_course, mark_loss, pull_n),
    "fall": Action(FALL, fall_course, mark_loss),
}
