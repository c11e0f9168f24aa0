"""People in a closed loop: they react to what the hand does, and that decides the outcome.

A receiver pulls no harder than a cap and gives up after a while. A puller does, too. The wearer of
the hand opens it by muscle signals that come before the hand moves, and are missed now and then;
and overrides the hand where it resists a hand-over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.edge_runtime.grip import AnswerRules
from holdfast.simulation.actions import NEVER_S
from holdfast.simulation.effects.effect import stream
from holdfast.simulation.effects.smooth import smooth
from holdfast.simulation.physics.body import Body
from holdfast.simulation.scenes.protocol import PlannedTrial, Trials, of_each
from holdfast.simulation.scenes.script import Script
from holdfast.simulation.scenes.script_times import Times
from holdfast.simulation.scenes.stepper import TrialMotion
from holdfast.simulation.scenes.truth import Steps


@dataclass(frozen=True)
class Habits:
    """How people behave; distributions are uniform where two figures are given.

    pull_gives_up_s, pass_gives_up_s  from the first pull until the other person lets go
    lets_go_s               how long letting go takes
    signal_s                by how much the wearer's muscle signal precedes the opening of the hand
    missed_share            of the signals: those that the hand's own control sees and we do not
    resisted_n, resisted_s  grip above the wearer's, for so long, in a hand-over: then the wearer
                            overrides
    mistake_s               the wearer opens the hand by mistake, for so long, MISTAKEN_S before the
                            action, and closes it again; 0: never
    """

    pull_gives_up_s: float = 1.0
    pass_gives_up_s: float = 3.0
    lets_go_s: float = 0.2
    signal_s: tuple[float, float] = (0.08, 0.15)
    missed_share: float = 0.1
    resisted_n: float = 1.0
    resisted_s: float = 0.3
    mistake_s: float = 0.0


MISTAKEN_S = 0.8
"""Before the action, in the quiet of the hold."""


class LoopScript(Script):
    """The script of a batch whose hands tighten and whose people give up."""

    def __init__(self, trials: Trials, body: Body, habits: Habits) -> None:
        super().__init__(trials, body)
        # In other actions no person pulls, so no person gives up.
        after_s = {"pull": habits.pull_gives_up_s, "pass": habits.pass_gives_up_s}
        patience_s = np.array([after_s.get(trial.action, NEVER_S) for trial in trials])
        first_pull_s = self.act_s + self.drawn("wait_s")
        self.gives_up_s = first_pull_s + patience_s
        self.lets_go_s = habits.lets_go_s
        self.mistake_s = habits.mistake_s

    def shut(self, t_s: FloatArray) -> FloatArray:
        """[n, B] how far the hand is closed, 0 .. 1; less where it is opened by mistake."""
        shut = super().shut(t_s)
        if self.mistake_s:
            # as fast as any opening, and back at the same speed
            since_s = self._mistaken_s(t_s)
            back_s = np.minimum(since_s, 2.0 * self.mistake_s - since_s)
            shut = shut * (1.0 - smooth(back_s / self.drawn("opening_s", 1.0)))
        return shut

    def opens(self, t_s: FloatArray) -> BoolArray:
        """[B] whether the wearer opens the hand at t_s [B], or has opened it for good."""
        opens: BoolArray = t_s >= self.open_s
        if self.mistake_s:
            since_s = self._mistaken_s(t_s)
            opens |= (since_s >= 0.0) & (since_s < self.mistake_s)
        return opens

    def _mistaken_s(self, t_s: FloatArray) -> FloatArray:
        """Time since the mistake began."""
        return t_s - (self.act_s - MISTAKEN_S)

    def places_n(self, t_s: FloatArray, closures_m: Sequence[FloatArray]) -> FloatArray:
        """[n, B] grip that the wearer asks for at t_s [n, B], N a side, as Actuator.own_n.

        Of the finger that is least closed: no finger of a drive that follows it is closed further
        than the wearer would. closures_m: the wearer's.
        """
        closed_m = np.where(self.stays_open, 1.0, self.closed_m)
        deep = (np.stack(closures_m) - self.surface_m) / closed_m
        least = np.where(self.stays_open, np.inf, deep).min(axis=1)
        place_n: FloatArray = least * self.grip_n
        # A closed hand is at its grip exactly, whatever the rounding.
        still = (self.shut(t_s) == 1.0) & (self.pulse(t_s) == 0.0)
        still &= self.wearers_share(t_s) == 1.0
        return np.where(still, self.grip_n, place_n)

    def driven(
        self, own_m: FloatArray, own_n: FloatArray, place_n: FloatArray
    ) -> FloatArray:
        """[S, B] how far the fingers are closed: for the larger of the wearer's and the drive's.

        own_n, place_n [B]: the places of wearer and drive, N a side.
        """
        drive_m = self.closed_m * (place_n / self.grip_n) + self.surface_m
        drive_m = np.where(self.stays_open, own_m, drive_m)
        # in place: the layout in memory decides in which order numpy sums
        return np.maximum(own_m, drive_m, out=own_m, where=place_n > own_n)

    def still_there(self, t_s: FloatArray) -> FloatArray:
        """[n, B] 1 while the other person pulls, 0 after giving up."""
        gone = (t_s - self.gives_up_s) / self.lets_go_s
        return 1.0 - smooth(gone)


class Wearer:
    """B wearers: when the muscle signal comes, and whether the wearer overrides."""

    def __init__(self, trials: Trials, habits: Habits, seed: int) -> None:
        self.habits = habits
        times = [Times.of(trial) for trial in trials]
        rngs = [stream(seed, trial.number, "muscle signal") for trial in trials]
        before_s = np.array([rng.uniform(*habits.signal_s) for rng in rngs])
        missed = np.array([rng.uniform() < habits.missed_share for rng in rngs])
        opens_s = of_each(times, "open")

        # The signal comes before the hand moves; a missed one never comes.
        self.signal_s = np.where(missed, NEVER_S, opens_s - before_s)

        # Only in a hand-over does the wearer want the hand to let go.
        self.hands_over = np.isin(of_each(trials, "action"), ("pass", "put-down"))
        self.act_s = of_each(times, "act")

        self.friction = of_each(trials, "kinetic_friction")
        self.resisted_s = np.zeros(len(trials))
        self.overrode_s = np.full(len(trials), np.inf)

    def resist(
        self,
        t_s: FloatArray,
        own_n: FloatArray,
        extra_n: FloatArray,
        pulled_n: FloatArray,
        dt_s: float,
    ) -> None:
        """One sample: the wearer overrides a hand that resists a hand-over for too long.

        own_n [B]: the grip that the wearer asks for, N a side, and extra_n [B] the grip above it.
        pulled_n [B]: force of the other person or the box on the object, beyond the one before the
        action; it is resisted where the wearer's grip would have let go.
        """
        # Both sides hold by kinetic friction; an opening hand holds less and less.
        would_go = pulled_n > 2.0 * self.friction * own_n
        handing_over = self.hands_over & (t_s >= self.act_s)
        # A hand at the wearer's grip resists no receiver.
        tighter = extra_n > self.habits.resisted_n
        resisted = handing_over & would_go & tighter

        # One sample without resistance starts the wearer's patience anew.
        self.resisted_s = np.where(resisted, self.resisted_s + dt_s, 0.0)
        out_of_patience = self.resisted_s >= self.habits.resisted_s
        now = out_of_patience & np.isinf(self.overrode_s)
        self.overrode_s = np.where(now, t_s, self.overrode_s)


Recorded = npt.NDArray[np.float32]
"""One number a sample, in single precision to save memory."""
HELD_AT_END_S = float("inf")
"""Time of an event that never happened: the object is still held."""


@dataclass(frozen=True, kw_only=True)
class LoopOutcome:
    """What became of a trial. Times in s of the trial; inf for what never happened.

    trial       as it was planned
    grip_n      [T] at every sample the grip of either side that the drive gave
    own_n       [T] the grip that the wearer asked for
    target_n    [T] the grip that the controller commanded, 0 for none
    p_risky     [T] the evidence that the controller was given, 0 while the state is unknown
    lost_s      the last contact ends
    onset_s     load onset
    slip_mm     travel of the contacts since load onset
    peak_n      largest force of the other person or the box beyond the one before the action, while
                there is contact
    peak_before_n  the same up to the wearer's opening
    overrode_s  the wearer overrides
    begin_s     first time of what is recorded
    rate_hz     of what is recorded
    mu_hat      the last friction estimate, nan where no slip has shown it
    gives_up_s  the other person gives up
    evidence_p  p(risky slip) that counts as evidence: our answer begins with it
    """

    trial: PlannedTrial
    grip_n: Recorded
    own_n: Recorded
    target_n: Recorded
    p_risky: Recorded
    lost_s: float
    onset_s: float
    slip_mm: float
    peak_n: float
    overrode_s: float
    begin_s: float
    rate_hz: float
    mu_hat: float
    gives_up_s: float = NEVER_S
    peak_before_n: float = 0.0
    evidence_p: float = AnswerRules.from_p

    @property
    def act_s(self) -> float:
        return Times.of(self.trial).act

    @property
    def opens_s(self) -> float:
        """When the wearer opens the hand."""
        return Times.of(self.trial).open

    @property
    def dropped(self) -> bool:
        """Contact is lost before the wearer opens the hand."""
        return self.lost_s < self.opens_s

    @property
    def crushed(self) -> bool:
        """The grip of either side exceeded what the object bears."""
        return 0.0 < self.trial.object.crush_n < self.peak_grip_n

    @property
    def peak_grip_n(self) -> float:
        """The largest grip of either side."""
        return float(self.grip_n.max())


def outcome_of(trial: PlannedTrial, motion: TrialMotion, **known: Any) -> LoopOutcome:
    """Read the outcome of a trial off its motion; known: what the loop knows of it."""
    steps = Steps(trial, motion)
    onset = steps.slip_onset()

    # Without a load onset there is no slip since then. Contact may end before the load comes, or
    # never begin: then the slip is zero.
    last = max(steps.lost - 1, 0)
    start = last if onset is None else min(onset, last)
    slip_m = motion.slip_m[last] - motion.slip_m[start]

    acts = steps.at(steps.times.act)
    change_n = steps.change_n(acts)[acts : steps.lost]
    before_n = change_n[: max(steps.at(steps.times.open) - acts, 0)]
    return LoopOutcome(
        **known,
        trial=trial,
        lost_s=steps.time(steps.lost) or HELD_AT_END_S,
        onset_s=steps.time(onset) or HELD_AT_END_S,
        slip_mm=1e3 * float(slip_m),
        peak_n=float(change_n.max(initial=0.0)),
        peak_before_n=float(before_n.max(initial=0.0)),
    )
