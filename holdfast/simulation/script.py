"""A batch of trials as the core takes it: bodies, times of the steps, actions of hand and people.

Steps are fine where anything can happen (something moves, lets go, touches) and one sample long
elsewhere; a trial's steps depend on the trial alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import FloatArray
from holdfast.simulation.body import Body, Floor, Inputs, Pull
from holdfast.simulation.protocol import GRAVITY_M_S2, NEVER_S, PlannedTrial

OPEN_GAP_M = 0.03
SETTLE_S = 0.4
"""Time with fine steps after something ends."""
GIVER_N_PER_M, GIVER_CAP_N = 800.0, 40.0
BOX_N_PER_M, BOX_DAMPING, BOX_SIDEWAYS = 4e3, 40.0, 300.0
BOX_GAP_M, BOX_OVERSHOOT_M = 0.01, 0.003
CATCH_S = 0.5
"""Time before the hand opens at which the person of a disturbed hold comes back."""
DAMPING_RATIO = 0.7
Interval = tuple[float, float]
Person = tuple[FloatArray, ...]
"""Fields of Pull, each [n, .., B] at the ends of n steps."""


def smooth(u: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, minimum jerk between (Flash & Hogan, J. Neurosci. 5, 1985)."""
    u = np.minimum(np.maximum(u, 0.0), 1.0)
    out: FloatArray = u * u * u * (10.0 + u * (6.0 * u - 15.0))
    return out


@dataclass(frozen=True)
class Times:
    """Times of the events of a trial, s; NEVER_S for an event it does not have."""

    close: float
    give: float
    act: float
    open: float
    end: float

    @staticmethod
    def of(trial: PlannedTrial) -> Times:
        """From the trial's draws."""
        d = trial.drawn
        if trial.action == "nothing":
            return Times(NEVER_S, NEVER_S, NEVER_S, NEVER_S, d["lasts_s"])
        close, closed = d["close_at_s"], d["close_at_s"] + d["closing_s"]
        act = closed + d["hold_s"]
        give = closed + d["give_after_s"]
        if trial.supported:
            give = act + {"fall": 0.0, "pull": 0.0, "pass": d.get("take_s", 0.0)}.get(
                trial.action, NEVER_S
            )
        lasts, opens = _lasts(trial, act)
        if trial.supported and trial.action == "put-down":
            give = act + BOX_GAP_M / d["box_m_s"]
        return Times(close, give, act, opens, act + lasts + d["tail_s"])


def _lasts(trial: PlannedTrial, act: float) -> tuple[float, float]:
    """(duration of the action, time at which the hand opens)."""
    d = trial.drawn
    if trial.action == "pass":
        opens = act + d["wait_s"] + d["open_after_s"]
        return max(d["wait_s"] + d["move_s"], opens + d["opening_s"] - act), opens
    if trial.action == "put-down":
        opens = act + BOX_GAP_M / d["box_m_s"] + d["open_after_s"]
        return opens + d["opening_s"] - act, opens
    if trial.action == "hold":
        opens = act + d["times"] * d["every_s"] + 2.0 * CATCH_S
        return opens + d["opening_s"] - act, opens
    return (d["move_s"] if trial.action == "pull" else d["watch_s"]), NEVER_S


def busy(trial: PlannedTrial) -> list[Interval]:
    """Intervals in which fine steps are taken, s."""
    t, d = Times.of(trial), trial.drawn
    if trial.action == "nothing":
        return []
    intervals = [
        (t.close, t.close + d["closing_s"]),
        (t.give, t.give + _giving_s(trial)),
    ]
    if t.open < NEVER_S:
        intervals.append((t.open, t.open + d["opening_s"]))
    if trial.action == "hold":
        starts = [t.act + k * d["every_s"] for k in range(round(d["times"]))]
        intervals += [(start, start + d["pulse_s"]) for start in starts] + [
            (t.open - CATCH_S, t.open)
        ]
    elif trial.action == "put-down":
        intervals.append((t.act, t.act + (BOX_GAP_M + BOX_OVERSHOOT_M) / d["box_m_s"]))
    elif trial.action == "pass":
        intervals += [
            (t.act, t.act + d["take_s"]),
            (t.act + d["wait_s"], t.open + d["opening_s"]),
        ]
    else:
        lasts_s = d["move_s"] if trial.action == "pull" else d["watch_s"] - SETTLE_S
        intervals.append((t.act, t.act + lasts_s))
    return [(start - 0.02, stop + SETTLE_S) for start, stop in intervals]


def _giving_s(trial: PlannedTrial) -> float:
    return trial.drawn["vanish_s"] if trial.action == "fall" else trial.drawn["give_s"]


@dataclass(frozen=True)
class Grid:
    """Steps of one trial: at_s [K] their ends; sample [K] the sample each ends at, or -1.

    n_samples: of the whole trial; before the first step and after the last there is no contact.
    """

    at_s: FloatArray
    sample: npt.NDArray[np.int64]
    start_s: float
    n_samples: int


def grid_of(
    trial: PlannedTrial, rate_hz: float, step_s: float, more: Sequence[Interval] = ()
) -> Grid:
    """The steps of a trial; more: further intervals with fine steps.

    Samples are at 0, 1/rate, ..; the step to the next is cut into ceil(1 / (rate * step_s)) where
    it touches an interval in which anything can happen. Stepping begins as the hand begins to close
    and ends when it is open.
    """
    times, fine = Times.of(trial), [*busy(trial), *more]
    n, pieces = (
        int(np.floor(times.end * rate_hz)),
        max(1, int(np.ceil(1.0 / (rate_hz * step_s) - 1e-9))),
    )
    first = int(np.clip(np.floor((times.close - 0.02) * rate_hz), 0, n - 1))
    opened_s = times.open + trial.drawn.get("opening_s", 0.0) + SETTLE_S
    stop = int(min(n, np.ceil(opened_s * rate_hz)))
    index = np.arange(first, max(stop, first + 1))
    from_s = index / rate_hz
    is_fine = np.zeros(len(index), dtype=np.bool_)
    for start, end in fine:
        is_fine |= (from_s + 1.0 / rate_hz > start) & (from_s < end)
    counts = np.where(is_fine, pieces, 1)
    last = np.cumsum(counts) - 1
    place = np.repeat(np.arange(len(index)), counts)
    within = np.arange(len(place)) - (last - counts + 1)[place] + 1
    sample = np.full(len(place), -1, dtype=np.int64)
    sample[last] = index + 1
    return Grid(
        (index[place] + within / counts[place]) / rate_hz,
        sample,
        first / rate_hz,
        n + 1,
    )


def body_of(trials: Sequence[PlannedTrial], pressure: FloatArray) -> Body:
    """Constants of a batch; pressure [E]: share of the normal on each brush element."""
    d = {
        name: np.array([t.drawn[name] for t in trials])
        for name in ("tilt_deg", "roll_deg", "shear_ratio")
    }
    tilt, roll = np.radians(d["tilt_deg"]), np.radians(d["roll_deg"])
    down = np.stack(
        [np.sin(tilt), np.cos(tilt) * np.sin(roll), -np.cos(tilt) * np.cos(roll)]
    )
    finger = np.stack([t.finger_n_per_m for t in trials], axis=1)
    stuff = np.array([t.thing.stiffness_n_per_m for t in trials])
    friction = np.array([t.thing.friction * t.drawn["friction_factor"] for t in trials])
    stuff = stuff * trials[0].hand.part[:, None]
    normal = finger * stuff / (finger + stuff)
    elements = len(pressure)
    return Body(
        mass_kg=np.array([t.thing.mass_g * 1e-3 for t in trials]),
        gravity_m_s2=GRAVITY_M_S2 * down,
        curvature_per_m=np.array([t.thing.curvature_per_m for t in trials]).T,
        straight_m=np.array([t.thing.half_length_mm * 1e-3 for t in trials]),
        at_m=np.stack([t.at_m for t in trials], axis=2),
        stiffness_n_per_m=normal,
        damping_n_s_per_m=2e-3 * normal,
        brush_n_per_m=np.broadcast_to(
            d["shear_ratio"] * finger / elements, (elements, *finger.shape)
        ).copy(),
        pressure=pressure[:, None, None],
        static=friction,
        kinetic=friction * np.array([t.thing.kinetic_share for t in trials]),
        thumb=trials[0].hand.thumb,
    )


class Script:
    """Actions of hand and people in a batch, at any times [n, B].

    boxed: there are boxes, at -10 m for trials that set nothing down; always where one trial sets
    something down. An object that falls for more than a second meets one, so a batch keeps its
    boxes to its end.
    """

    def __init__(
        self, trials: Sequence[PlannedTrial], body: Body, boxed: bool = False
    ) -> None:
        self.trials, self.body = trials, body
        times = [Times.of(t) for t in trials]
        self.t = {
            name: np.array([getattr(one, name) for one in times])
            for name in ("close", "give", "act", "open")
        }
        actions = np.array([t.action for t in trials])
        self.holds, self.falls = actions == "hold", actions == "fall"
        self.takes = (actions == "pass") | (actions == "pull")
        self.sets_down, self.passes = actions == "put-down", actions == "pass"
        self.boxed = boxed or bool(self.sets_down.any())
        self.closed_m = (
            np.stack([t.grip_n * t.share for t in trials], axis=1)
            / body.stiffness_n_per_m
        )
        self.push = np.stack([t.push for t in trials], axis=1)
        self.weight_n = body.mass_kg * GRAVITY_M_S2
        self._drawn: dict[str, FloatArray] = {}

    def d(self, name: str, default: float = 0.0) -> FloatArray:
        """[B] a drawn parameter; the default for actions that do not have it."""
        if name not in self._drawn:
            self._drawn[name] = np.array(
                [t.drawn.get(name, default) for t in self.trials]
            )
        return self._drawn[name]

    def chunk(self, t_s: FloatArray) -> list[Inputs]:
        """Inputs at the ends of n steps, t_s [n, B]."""
        shut, pulse = self._shut(t_s), self._pulse(t_s)
        people = [(person, _acts(person)) for person in self._people(t_s, pulse)]
        floor = self._box(t_s) if self.boxed else None
        return [
            Inputs(
                self._closure(shut[k], pulse[k], self.grip_share(k)),
                tuple(
                    Pull(*(part[k] for part in one)) for one, acts in people if acts[k]
                ),
                None
                if floor is None
                else Floor(
                    BOX_N_PER_M, BOX_DAMPING, BOX_SIDEWAYS, floor[0][k], floor[1][k]
                ),
            )
            for k in range(len(t_s))
        ]

    def _people(self, t_s: FloatArray, pulse: FloatArray) -> Iterator[Person]:
        yield self._giver(t_s)
        if self.takes.any():
            yield self._taker(t_s)
        if self.holds.any():
            yield self._disturber(t_s, pulse)

    def _shut(self, t_s: FloatArray) -> FloatArray:
        closing = smooth((t_s - self.t["close"]) / self.d("closing_s", 1.0))
        return closing - smooth((t_s - self.t["open"]) / self.d("opening_s", 1.0))

    def _pulse(self, t_s: FloatArray) -> FloatArray:
        """[n, B] strength of the disturbance of a perturbed hold, 0 .. 1."""
        if not self.holds.any():
            return np.zeros_like(t_s)
        since, every, lasts = (
            t_s - self.t["act"],
            self.d("every_s", 1.0),
            self.d("pulse_s", 1.0),
        )
        number = np.floor(since / every)
        within = np.sin(np.pi * np.clip((since - number * every) / lasts, 0.0, 1.0))
        disturbed = self.holds & (number >= 0) & (number < np.round(self.d("times")))
        return np.where(disturbed, within * within, 0.0)

    def _closure(
        self, shut: FloatArray, pulse: FloatArray, share: FloatArray | float
    ) -> FloatArray:
        grip = (1.0 + self.d("grip_change") * pulse) * share
        closure = shut * (OPEN_GAP_M + self.closed_m * grip) - OPEN_GAP_M
        closure[self.body.thumb :] += 1e-3 * self.d("motor_mm") * pulse * shut
        return closure

    def grip_share(self, k: int) -> FloatArray | float:
        """[B] the hand's grip in step k of a chunk, over the one that it was closed with."""
        return 1.0

    def still_there(self, t_s: FloatArray) -> FloatArray | float:
        """[n, B] 1 while the person who takes is there; in a closed loop people give up."""
        return 1.0

    def _giver(self, t_s: FloatArray) -> Person:
        """The person who holds the object out until letting go; a fall's support just vanishes."""
        lasts = np.where(self.falls, self.d("vanish_s", 1.0), self.d("give_s", 1.0))
        there = 1.0 - smooth((t_s - self.t["give"]) / lasts)
        if self.holds.any():
            back = smooth((t_s - self.t["open"] + CATCH_S) / (0.5 * CATCH_S))
            there = np.where(self.holds, np.maximum(there, back), there)
        damping = 2.0 * DAMPING_RATIO * np.sqrt(GIVER_N_PER_M * self.body.mass_kg)
        still = np.zeros((len(t_s), *self.push.shape))
        return (
            there * GIVER_N_PER_M,
            there * damping,
            there * GIVER_CAP_N + 1e-9,
            there,
            still,
            still,
        )

    def _taker(self, t_s: FloatArray) -> Person:
        """The person who takes the object (gently, with its weight) or tears at it."""
        grasped = self.takes & (t_s >= self.t["act"])
        start, move_s = self.t["act"] + self.d("wait_s"), self.d("move_s", 1.0)
        u = np.clip((t_s - start) / move_s, 0.0, 1.0)
        travel = self.d("distance_m") * smooth(u)
        speed = self.d("distance_m") / move_s * 30.0 * u * u * (1.0 - u) * (1.0 - u)
        stiffness = self.d("arm_n_per_m", 1.0)
        damping = 2.0 * DAMPING_RATIO * np.sqrt(stiffness * self.body.mass_kg)
        weight = np.where(
            self.passes, smooth((t_s - self.t["act"]) / self.d("take_s", 1.0)), 0.0
        )
        there = self.still_there(t_s)
        return (
            np.where(grasped, stiffness * there, 0.0),
            np.where(grasped, damping * there, 0.0),
            np.broadcast_to(self.d("cap_n", 1.0), t_s.shape),
            np.where(grasped, weight * there, 0.0),
            travel[:, None] * self.push,
            speed[:, None] * self.push,
        )

    def _disturber(self, t_s: FloatArray, pulse: FloatArray) -> Person:
        """A force along the object, as a share of its weight, subtracted or added."""
        still = np.zeros((len(t_s), *self.push.shape))
        nothing = np.zeros_like(t_s)
        share = np.where(self.holds, -self.d("load_n") / self.weight_n, 0.0) * pulse
        return nothing, nothing, nothing + 1.0, share, still, still

    def _box(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Height [n, B] and greatest force [n, B] of the box."""
        risen = np.minimum(
            (t_s - self.t["act"]) * self.d("box_m_s", 1.0), BOX_GAP_M + BOX_OVERSHOOT_M
        )
        height = np.where(
            self.sets_down & (t_s >= self.t["act"]), risen - BOX_GAP_M, -10.0
        )
        cap = self.d("press") * self.weight_n + self.d("excess_n")
        return height, np.broadcast_to(np.maximum(cap, 1e-9), t_s.shape)


def _acts(person: Person) -> list[bool]:
    """Whether a person does anything to any object in each of n steps: a spring, or a weight."""
    stiffness, _, _, weight = person[:4]
    acts: list[bool] = ((stiffness != 0.0) | (weight != 0.0)).any(axis=1).tolist()
    return acts
