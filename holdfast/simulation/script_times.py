"""When things happen in a trial, and the steps of time in which a batch of trials is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.effect import Interval
from holdfast.simulation.protocol import (
    ACTION_MODULES,
    NEVER_S,
    PlannedTrial,
    action_module,
)

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
CATCH_S = 0.5
"""Time before the hand opens at which the person of a disturbed hold comes back."""


def smooth(u: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, minimum jerk between (Flash & Hogan, J. Neurosci. 5, 1985)."""
    u = np.minimum(np.maximum(u, 0.0), 1.0)
    # 10 u^3 - 15 u^4 + 6 u^5
    polynomial = 10.0 + u * (6.0 * u - 15.0)
    return u * u * u * polynomial


@dataclass(frozen=True)
class Times:
    """Times of the events of a trial, s; NEVER_S for an event it does not have.

    close  the hand begins to close
    give   the person who holds the object out begins to let go
    act    the action begins
    open   the hand begins to open
    end    the trial ends
    """

    close: float
    give: float
    act: float
    open: float
    end: float

    @staticmethod
    def of(trial: PlannedTrial) -> Times:
        """From the trial's draws."""
        drawn = trial.drawn

        # The empty hand has no events, only an end.
        if not trial.holds_object:
            return Times(NEVER_S, NEVER_S, NEVER_S, NEVER_S, drawn["lasts_s"])

        close = drawn["close_at_s"]
        closed = close + drawn["closing_s"]
        act = closed + drawn["hold_s"]

        # An action lasts until the hand is open, or until the other person has moved.
        gives = _gives(trial, closed, act)
        opens = _opens(trial, act)
        lasts = _lasts(trial, act, opens)
        ends = act + lasts + drawn["tail_s"]
        return Times(close, gives, act, opens, ends)


def _gives(trial: PlannedTrial, closed: float, act: float) -> float:
    """When the person lets go; a weak grip is supported until the action takes the weight."""
    drawn = trial.drawn
    if trial.action == "lift":
        # The support is a table, which the hand leaves as it lifts.
        return act
    if not trial.supported:
        # The grip holds the weight by itself, so the person leaves it soon after the hand has
        # closed.
        return closed + drawn["give_after_s"]
    if trial.action in ("fall", "pull"):
        # The support ends as the action begins, so the weak grip gets the whole load.
        return act
    if trial.action == "pass":
        return act + drawn["take_s"]
    if trial.action == "put-down":
        comes_s = BOX_GAP_M / drawn["box_m_s"]
        return act + comes_s

    # Any other action under a weak grip is supported to its end.
    return act + NEVER_S


def _opens(trial: PlannedTrial, act: float) -> float:
    """When the hand opens."""
    drawn = trial.drawn
    if trial.action == "pass":
        # The wearer opens the hand after the taker has begun to move, not when the taker arrives.
        moves = act + drawn["wait_s"]
        return moves + drawn["open_after_s"]

    if trial.action == "put-down":
        touches = act + BOX_GAP_M / drawn["box_m_s"]
        return touches + drawn["open_after_s"]

    if trial.action == "hold":
        # The person has come back, and has held the object for as long, before the hand opens.
        disturbed_s = drawn["times"] * drawn["every_s"]
        return act + disturbed_s + 2.0 * CATCH_S

    if trial.action in ACTION_MODULES:
        opens: float = action_module(trial.action).opens_s(trial, act)
        return opens

    # A hand that is pulled at, or lets an object fall, stays closed.
    return NEVER_S


def _lasts(trial: PlannedTrial, act: float, opens: float) -> float:
    """How long the action lasts, with the opening of the hand."""
    drawn = trial.drawn
    if trial.action == "pull":
        return drawn["move_s"]
    if trial.action == "fall":
        return drawn["watch_s"]

    opened = opens + drawn["opening_s"] - act
    if trial.action == "pass":
        # The hand may be open before the taker has carried the object all the way, or after it.
        carried = drawn["wait_s"] + drawn["move_s"]
        return max(carried, opened)
    return opened


def busy(trial: PlannedTrial) -> list[Interval]:
    """Intervals in which fine steps are taken, s."""
    if not trial.holds_object:
        return []

    times = Times.of(trial)
    drawn = trial.drawn
    giving_s = drawn["vanish_s"] if trial.action == "fall" else drawn["give_s"]
    closing = (times.close, times.close + drawn["closing_s"])
    giving = (times.give, times.give + giving_s)
    intervals = [closing, giving, *_acting(trial, times)]
    if times.open < NEVER_S:
        intervals.append((times.open, times.open + drawn["opening_s"]))

    # What an event has set in motion goes on for a while after it.
    return [(start - BEFORE_S, stop + SETTLE_S) for start, stop in intervals]


def _acting(trial: PlannedTrial, times: Times) -> list[Interval]:
    """Intervals in which the action of a trial moves anything."""
    act = times.act
    drawn = trial.drawn
    if trial.action == "hold":
        # The person who comes back before the hand opens moves, too.
        pulses = [(times.open - CATCH_S, times.open)]
        for k in range(round(drawn["times"])):
            start = act + k * drawn["every_s"]
            pulses.append((start, start + drawn["pulse_s"]))
        return pulses
    if trial.action == "put-down":
        rises_s = (BOX_GAP_M + BOX_OVERSHOOT_M) / drawn["box_m_s"]
        return [(act, act + rises_s)]
    if trial.action == "pass":
        takes = (act, act + drawn["take_s"])
        moves = (act + drawn["wait_s"], times.open + drawn["opening_s"])
        return [takes, moves]
    if trial.action == "pull":
        return [(act, act + drawn["move_s"])]
    if trial.action in ACTION_MODULES:
        intervals: list[Interval] = action_module(trial.action).acting(trial, times)
        return intervals

    # The time to settle is added to every interval (busy).
    watched_s = drawn["watch_s"] - SETTLE_S
    return [(act, act + watched_s)]


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
