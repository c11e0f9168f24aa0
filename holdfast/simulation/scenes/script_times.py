"""When things happen in a trial, and the steps of time in which a batch of trials is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.actions import NEVER_S, action_named
from holdfast.simulation.effects.effect import Interval
from holdfast.simulation.scenes.protocol import PlannedTrial

OPEN_GAP_M = 0.03
"""Distance of an open hand's fingers from the object."""
SETTLE_S = 0.4
"""Time with fine steps after something ends."""
BEFORE_S = 0.02
"""Time with fine steps before something begins."""
BOX_GAP_M = 0.01
"""Distance of the box from the object when the action begins."""
BOX_OVERSHOOT_M = 0.003
"""How far the box comes up beyond the first touch."""
ARM_N_PER_M = 800.0
"""Stiffness of the arm that holds the object out, or takes it at the end."""
ARM_DAMPING = 0.7
"""Of an arm that holds an object, over critical damping."""
CATCH_S = 0.5
"""Time before the hand opens at which the person of a disturbed hold comes back."""


@dataclass(frozen=True)
class Times:
    """Times of the events of a trial, s; NEVER_S for an event it does not have.

    close  the hand begins to close
    give   the person who holds the object out begins to let go
    act    the action begins
    open   the hand begins to open
    end    the trial ends
    moves  intervals in which the action moves anything
    """

    close: float
    give: float
    act: float
    open: float
    end: float
    moves: tuple[Interval, ...] = ()

    @staticmethod
    def of(trial: PlannedTrial) -> Times:
        """The times that follow from what was drawn for a trial."""
        drawn = trial.drawn

        # The empty hand has no events, only an end.
        if not trial.holds_object:
            return Times(NEVER_S, NEVER_S, NEVER_S, NEVER_S, drawn["lasts_s"])

        close = drawn["close_at_s"]
        closed = close + drawn["closing_s"]
        act = closed + drawn["hold_s"]
        course = action_named(trial.action).course(drawn, act)

        # The grip holds the weight by itself, so the person leaves it soon after the hand has
        # closed; a weak grip is supported until the action takes the weight.
        give = closed + drawn["give_after_s"]
        if trial.action == "lift":
            # The support is a table, which the hand leaves as it lifts.
            give = act
        elif trial.supported:
            give = act + course.taken_s

        # An action lasts until the hand is open, or until the other person has moved.
        lasts = course.carried_s
        if course.opens_s < NEVER_S:
            opened = course.opens_s + drawn["opening_s"] - act
            lasts = max(lasts, opened)
        end = act + lasts + drawn["tail_s"]
        return Times(close, give, act, course.opens_s, end, tuple(course.moves))


def busy(trial: PlannedTrial) -> list[Interval]:
    """Intervals in which fine steps are taken, s."""
    if not trial.holds_object:
        return []

    times = Times.of(trial)
    drawn = trial.drawn
    giving_s = drawn["vanish_s"] if trial.action == "fall" else drawn["give_s"]
    closing = (times.close, times.close + drawn["closing_s"])
    giving = (times.give, times.give + giving_s)
    intervals = [closing, giving, *times.moves]
    if times.open < NEVER_S:
        intervals.append((times.open, times.open + drawn["opening_s"]))

    # What an event has set in motion goes on for a while after it.
    return [(start - BEFORE_S, stop + SETTLE_S) for start, stop in intervals]


def needs_fine_steps(
    trial: PlannedTrial,
    index: npt.NDArray[np.int64],
    rate_hz: float,
    more: Sequence[Interval] = (),
) -> BoolArray:
    """[n] whether the sample periods that begin at samples index [n] get fine steps.

    They do where they touch an interval in which anything can happen; more: further intervals.
    """
    from_s = index / rate_hz
    until_s = from_s + 1.0 / rate_hz
    is_fine = np.zeros(len(index), dtype=np.bool_)
    for start, end in [*busy(trial), *more]:
        is_fine |= (until_s > start) & (from_s < end)
    return is_fine


@dataclass(frozen=True)
class Grid:
    """Steps of one trial; before the first and after the last one there is no contact.

    at_s       [K] their ends
    sample     [K] the sample that each ends at, or -1
    start_s    start of the first step
    n_samples  of the whole trial
    """

    at_s: FloatArray
    sample: npt.NDArray[np.int64]
    start_s: float
    n_samples: int


def pieces_of(rate_hz: float, step_s: float) -> int:
    """Fine steps in a sample period."""
    steps = 1.0 / (rate_hz * step_s)
    # A period of exactly n steps must not become n + 1 by rounding.
    return max(1, int(np.ceil(steps - 1e-9)))


def grid_of(
    trial: PlannedTrial, rate_hz: float, step_s: float, more: Sequence[Interval] = ()
) -> Grid:
    """The steps of a trial; more: further intervals with fine steps.

    Samples are at 0, 1/rate, ..; the step to the next is cut into ceil(1 / (rate * step_s)) where
    it touches an interval in which anything can happen. Stepping begins as the hand begins to close
    and ends when it is open.
    """
    times = Times.of(trial)
    n = int(np.floor(times.end * rate_hz))

    # Nothing moves before the hand begins to close.
    closing_s = times.close - BEFORE_S
    first = int(np.clip(np.floor(closing_s * rate_hz), 0, n - 1))

    # And nothing after it has opened.
    opened_s = times.open + trial.drawn.get("opening_s", 0.0) + SETTLE_S
    stop = int(min(n, np.ceil(opened_s * rate_hz)))

    # Sample periods in which anything can happen get fine steps.
    index = np.arange(first, max(stop, first + 1))
    is_fine = needs_fine_steps(trial, index, rate_hz, more)
    counts = np.where(is_fine, pieces_of(rate_hz, step_s), 1)

    # `place` is the sample period of each step, `within` the number of the step in it
    last = np.cumsum(counts) - 1
    begin = last - counts + 1
    place = np.repeat(np.arange(len(index)), counts)
    within = np.arange(len(place)) - begin[place] + 1

    # Only the last step of a period ends at a sample.
    sample = np.full(len(place), -1, dtype=np.int64)
    sample[last] = index + 1
    at_s = (index[place] + within / counts[place]) / rate_hz

    return Grid(at_s, sample, first / rate_hz, n + 1)
