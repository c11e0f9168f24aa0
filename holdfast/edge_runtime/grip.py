"""Grip controllers: from what the hand senses to the grip it should have, in N a side.

Pure formulas with a fixed step: no clock, no randomness. Each runs on one hand or on B hands with
the same bits (edge_runtime/batch.py). A controller only wants; edge_runtime/supervisor.py decides
what may reach the hand. The wearer's grip is the grip that the wearer set: it is measured while no
target is given.

    none           wants nothing
    pd-shear       wearer's + kp (T - T0) + kd dT/dt       T: load along the skin, above T0
    sliding-mode   r + k sat((r - N) / phi)            r: wearer's grip; no provision against slip
    smsp           wearer's + one step for every slip event
    ismsp          wearer's + the integral of the slip signal
    holdfast       N + lead * evidence while a slip is likely, until N has risen by rise_n; taken
                   back when it was a hand-over

pd-shear is the scheme of the SensorHand Speed as the thesis describes it (2.4, [46]); sliding-mode,
smsp and ismsp are those of Engeberg and Meek, IEEE/ASME Trans. Mechatronics 18(1), 2013 ([47] of
the thesis). Their slip signal here is the model's: p(risky slip) above SLIP_P in a firm grip, so
that controllers differ in their answers only. holdfast is ours (docs/shared-control.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from holdfast.edge_runtime.batch import Batch, Flag, Number
from holdfast.edge_runtime.decision import DecisionRules

SLIP_P = 0.5
"""p(risky slip) above which the published controllers see a slip."""
HELD_N = 0.5
"""They see one while the fingers press harder than this, N a side."""


@dataclass(slots=True)
class GripSense:
    """What a controller knows at one sample.

    grip_n: normal force of either side (half of all fingers' sum). load_n: force along the skin,
    all fingers' sum. p_risky, p_safe: probabilities of risky slip and safe slip. known: the state
    is not unknown. empty: the state is "nothing". opening, overridden: what the wearer commands.
    """

    grip_n: Number
    load_n: Number
    p_risky: Number
    p_safe: Number
    known: Flag
    empty: Flag
    opening: Flag
    overridden: Flag


LARGEST = 1e9
"""No sensor reads more, N or uT."""


def possible(batch: Batch, sense: GripSense) -> GripSense:
    """The sense with its forces within 0 and LARGEST, and its probabilities within 0 and 1.

    A sample with a number that is NaN is unknown: it says nothing, and the grip is held. Without
    this, one infinite force would stay in what a controller remembers.
    """
    numbers = (sense.grip_n, sense.load_n, sense.p_risky, sense.p_safe)
    known = sense.known
    for number in numbers:
        # only NaN differs from itself
        known = known & (number == number)
    grip_n, load_n = (batch.within(0.0, force_n, LARGEST) for force_n in numbers[:2])
    p_risky, p_safe = (batch.within(0.0, p, 1.0) for p in numbers[2:])
    flags = (known, sense.empty, sense.opening, sense.overridden)
    return GripSense(grip_n, load_n, p_risky, p_safe, *flags)


class WearersGrip:
    """The grip that the wearer set, measured while no target is given; 0 while nothing is held."""

    TIME_S = 0.1
    """Time constant of the low-pass over the measured grip."""

    def __init__(self, batch: Batch, rate_hz: float) -> None:
        self._batch = batch
        # the share of a new value in a first-order low-pass
        self._share = 1.0 / (1.0 + self.TIME_S * rate_hz)
        self.grip_n = batch.zero()

    def step(self, sense: GripSense, given_n: Number) -> Number:
        """The wearer's grip after one sample; it stands still while a target is given."""
        batch = self._batch
        smooth_n = self.grip_n + self._share * (sense.grip_n - self.grip_n)
        measured_n = batch.choose(sense.empty, 0.0, smooth_n)
        # a grip that a target made says nothing about what the wearer set
        idle = (given_n <= 0.0) & sense.known
        self.grip_n = batch.choose(idle, measured_n, self.grip_n)
        return self.grip_n


class Controller:
    """What every controller has; this one wants nothing: the hand keeps the wearer's grip.

    setting: the parameter that studies vary. fresh: whether it has evidence at the last sample.
    """

    SETTING = 0.0
    """Its default."""

    def __init__(self, batch: Batch, rate_hz: float, setting: float) -> None:
        self._batch = batch
        self._rate_hz = rate_hz
        self._setting = setting
        self._period_s = 1.0 / rate_hz
        self._wearer = WearersGrip(batch, rate_hz)
        self.fresh = batch.false()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none.

        given_n: what the supervisor gave last. needed_n: by the friction margin, 0 if unknown.
        """
        return self._batch.zero()


class PdShear(Controller):
    """wearer's + kp (T - T0) + kd dT/dt while the load T along the skin exceeds T0; setting: kp.

    T0 = 1 N, a fixed threshold; kd = 5 ms * kp.
    """

    SETTING = 1.0
    THRESHOLD_N = 1.0
    RATE_S = 0.005
    """kd / kp."""

    def __init__(self, batch: Batch, rate_hz: float, setting: float) -> None:
        super().__init__(batch, rate_hz, setting)
        self._load_n = batch.zero()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        batch = self._batch
        wearers_n = self._wearer.step(sense, given_n)

        # an unknown sample keeps the last load, so that its end makes no jump in the rate
        load_n = batch.choose(sense.known, sense.load_n, self._load_n)
        rate_n_s = (load_n - self._load_n) * self._rate_hz
        self._load_n = load_n

        above_n = load_n - self.THRESHOLD_N + self.RATE_S * rate_n_s
        self.fresh = (load_n > self.THRESHOLD_N) & batch.no(sense.empty)
        wanted_n = wearers_n + self._setting * batch.most(above_n, 0.0)

        return batch.choose(self.fresh, wanted_n, 0.0)


class SlidingMode(Controller):
    """r + k sat((r - N) / phi): keeps the grip N at r, the wearer's grip; setting: k, N.

    r is the wearer's grip half a second after contact. There is no provision against slip.
    """

    SETTING = 2.0
    BOUNDARY_N = 1.0
    SETTLED_S = 0.5

    def __init__(self, batch: Batch, rate_hz: float, setting: float) -> None:
        super().__init__(batch, rate_hz, setting)
        self._held_s = batch.zero()
        self._reference_n = batch.zero()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        batch = self._batch
        # its reference counts as given: from then on it regulates the grip itself
        wearers_n = self._wearer.step(sense, self._reference_n)
        self._held_s = batch.choose(sense.empty, 0.0, self._held_s + self._period_s)
        self.fresh = self._held_s >= self.SETTLED_S
        kept_n = batch.choose(self._reference_n > 0.0, self._reference_n, wearers_n)
        self._reference_n = batch.choose(self.fresh, kept_n, 0.0)

        error = (self._reference_n - sense.grip_n) / self.BOUNDARY_N
        saturated = batch.within(-1.0, error, 1.0)
        pushed_n = self._reference_n + self._setting * saturated

        return batch.choose(self.fresh, batch.most(pushed_n, 0.0), 0.0)


def _slips(sense: GripSense) -> Flag:
    """The slip signal of the published controllers."""
    return (sense.p_risky > SLIP_P) & (sense.grip_n > HELD_N) & sense.known


class SlipSteps(Controller):
    """wearer's + one step for each slip event; setting: the step, N."""

    SETTING = 8.0

    def __init__(self, batch: Batch, rate_hz: float, setting: float) -> None:
        super().__init__(batch, rate_hz, setting)
        self._slipped = batch.false()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        batch = self._batch
        wearers_n = self._wearer.step(sense, given_n)
        slips = _slips(sense)
        # an event is the first sample of a slip
        self.fresh = slips & batch.no(self._slipped)
        self._slipped = batch.choose(sense.known, slips, self._slipped)
        raised_n = batch.most(given_n, wearers_n) + self._setting
        return batch.choose(self.fresh, raised_n, given_n)


class SlipIntegral(Controller):
    """wearer's + the integral of the slip signal; setting: N per s of slip."""

    SETTING = 200.0

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        batch = self._batch
        wearers_n = self._wearer.step(sense, given_n)
        self.fresh = _slips(sense)
        rise_n = self._setting / self._rate_hz
        raised_n = batch.most(given_n, wearers_n) + rise_n
        return batch.choose(self.fresh, raised_n, given_n)


@dataclass(frozen=True)
class AnswerRules:
    """Parameters of the holdfast controller.

    from_p, full_p: p(risky) at which an answer begins, and at which it is a full one. yield_p:
    p(safe slip) from which the hand gives back, where the load falls by more than a tremor can
    (LoadSwing) for yield_samples in a row. graded: the lead grows with the evidence; otherwise it
    is full from half the evidence on, or nothing. revocable: a hand-over ends an answer; otherwise
    only the empty hand does. margin: what the friction margin needs is kept. rise_n: an answer
    raises the grip by so much over the wearer's and not further, N a side; inf for no such end.
    """

    from_p: float = DecisionRules.answer_permille / 1000
    full_p: float = DecisionRules.full_answer_permille / 1000
    yield_p: float = 0.5
    yield_samples: int = 2
    graded: bool = True
    revocable: bool = True
    margin: bool = True
    rise_n: float = 6.0

    @classmethod
    def of(cls, decision: DecisionRules, **others: Any) -> AnswerRules:
        """Those that come with a model; others: what shall differ from them, for studies."""
        usual = cls(
            decision.answer_permille / 1000, decision.full_answer_permille / 1000
        )
        return replace(usual, **others)


class LoadSwing:
    """Whether the load has fallen by more than the hand's tremor can take from it.

    A tremor takes and gives back: within one period it moves the load as far up as down. Another
    person who takes the object only takes. So the fall of the load within the longest period of a
    tremor is compared with the largest rise of late. Beyond is what exceeds TIMES of it by SHARE of
    the load: a fifth within a quarter of a second, which pouring does not reach. A load that rises
    is no sign: a pull, a tug and added weight begin with it. A tremor that is larger than the load
    hides its fall; then the load is gone for longer than a period, and so is half of its mean.
    """

    SMOOTH_S = 0.02
    """Time constant of the low-pass over the load, which is noisy."""
    PERIOD_S = 0.25
    """Tremors have 4 to 12 Hz (Elble & Koller, "Tremor", 1990)."""
    MEMORY_S = 1.0
    """Two close frequencies beat: a tremor is not forgotten while it wanes."""
    TIMES = 1.2
    """A tremor that grows exceeds its last period by this much, or less."""
    LEAST_N = 0.15
    """Below it a change of the sum of six fingers is noise."""
    SHARE = 0.2
    """Of the load: what another person takes in a quarter of a second, and pouring does not."""
    GONE = 0.5
    """Share of the mean load."""

    def __init__(self, batch: Batch, rate_hz: float) -> None:
        self._batch = batch
        self._smooth = 1.0 / (1.0 + self.SMOOTH_S * rate_hz)
        self._leak = 1.0 / (1.0 + self.PERIOD_S * rate_hz)
        self._forgets = 1.0 / (1.0 + self.MEMORY_S * rate_hz)
        self._load_n = batch.zero()
        self._high_n = batch.zero()
        self._low_n = batch.zero()
        self._rises_n = batch.zero()
        self._mean_n = batch.zero()
        self._most_n = batch.zero()

    def step(self, load_n: Number, known: Flag) -> Flag:
        """Whether it has, after one sample; a sample that is not known changes nothing."""
        batch = self._batch
        smooth_n = self._load_n + self._smooth * (load_n - self._load_n)
        # the highest and the lowest load of late: both come back to the load
        sinking_n = self._high_n + self._leak * (smooth_n - self._high_n)
        rising_n = self._low_n + self._leak * (smooth_n - self._low_n)
        high_n = batch.most(smooth_n, sinking_n)
        low_n = batch.least(smooth_n, rising_n)

        fall_n = high_n - smooth_n
        rise_n = smooth_n - low_n
        # Before this sample, so that a change is not compared with itself.
        mean_n, most_n = self._means_n(smooth_n)
        share_n = self.SHARE * batch.most(high_n, most_n)
        least_n = batch.most(share_n, self.LEAST_N)
        beyond_fall = fall_n > self.TIMES * self._rises_n + least_n
        gone = most_n - mean_n > batch.most(self.GONE * most_n, self.LEAST_N)

        # What is remembered shrinks slowly, and grows at once.
        rises_n = batch.most(rise_n, self._rises_n - self._forgets * self._rises_n)
        self._load_n = batch.choose(known, smooth_n, self._load_n)
        self._high_n = batch.choose(known, high_n, self._high_n)
        self._low_n = batch.choose(known, low_n, self._low_n)
        self._rises_n = batch.choose(known, rises_n, self._rises_n)
        self._mean_n = batch.choose(known, mean_n, self._mean_n)
        self._most_n = batch.choose(known, most_n, self._most_n)
        return beyond_fall | gone

    def _means_n(self, smooth_n: Number) -> tuple[Number, Number]:
        """The mean load over a period, and its largest value of late."""
        mean_n = self._mean_n + self._leak * (smooth_n - self._mean_n)
        sinking_n = self._most_n + self._forgets * (mean_n - self._most_n)
        return mean_n, self._batch.most(mean_n, sinking_n)


class Holdfast(Controller):
    """Leads the grip by the evidence of a slip, and gives back in a hand-over.

    The wanted grip is N + lead * evidence while a slip is likely, with

    evidence = (p_risky - from_p) / (full_p - from_p), within 0 and 1. The drive's speed grows with
    the lead of the wanted grip over the measured one N, so the answer is as fast as the evidence is
    strong. Evidence fades within FADES_S instead of ending at once: the closing hand itself raises
    the normal force, so a slip soon looks like a firm grasp. When it has ended the drive is braked,
    and the grip stays where it is, or where the friction margin wants it, until the evidence says
    hand-over. The lead sets the drive's speed. The grip itself rises by rise_n over the wearer's,
    or to what friction is known to need, and no further. setting: the largest lead, N.
    """

    SETTING = 22.0
    FADES_S = 0.06
    """Within it full evidence becomes none: about the drive's lag, in which no grip rises yet."""
    BRAKE_S = 0.02
    """So long after the evidence, in a known state, the target goes back: the drive coasts."""

    def __init__(
        self,
        batch: Batch,
        rate_hz: float,
        setting: float,
        rules: AnswerRules | None = None,
    ) -> None:
        super().__init__(batch, rate_hz, setting)
        self.rules = rules or AnswerRules()
        self._swing = LoadSwing(batch, rate_hz)
        self._safe_run = batch.zero()
        self._quiet_s = batch.zero()
        self._last_evidence = batch.zero()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        batch = self._batch
        wearers_n = self._wearer.step(sense, given_n)
        holds = sense.known & batch.no(sense.empty)
        now = batch.choose(holds, self._evidence(sense), 0.0)
        fading = self._last_evidence - self._period_s / self.FADES_S
        evidence = batch.choose(holds, batch.most(now, fading), 0.0)
        rises = evidence > 0.0
        ahead_n = batch.most(sense.grip_n, wearers_n) + self._setting * evidence
        # A lead without an end would press the object out of the hand.
        most_n = batch.most(wearers_n + self.rules.rise_n, needed_n)
        ahead_n = batch.choose(sense.grip_n < most_n, ahead_n, most_n)
        kept_n = self._kept_n(sense, wearers_n, given_n, needed_n)
        wanted_n = batch.choose(rises, ahead_n, kept_n)
        # a slip that is likely now outweighs a hand-over, and one that fades does not
        ends = self._handed_over(sense) & batch.no(now > 0.0)
        remembered = batch.choose(sense.known, evidence, self._last_evidence)
        self._last_evidence = batch.choose(ends, 0.0, remembered)

        # bounded, so that it does not grow for days; only times below BRAKE_S matter
        later_s = batch.least(self._quiet_s + self._period_s, 1.0)
        quiet_s = batch.choose(rises, 0.0, later_s)
        self._quiet_s = batch.choose(sense.known, quiet_s, self._quiet_s)
        self.fresh = rises

        return batch.choose(ends, 0.0, wanted_n)

    def _evidence(self, sense: GripSense) -> Number:
        """0 to 1."""
        rules = self.rules
        batch = self._batch
        share = (sense.p_risky - rules.from_p) / (rules.full_p - rules.from_p)
        if not rules.graded:
            return batch.choose(share >= 0.5, 1.0, 0.0)
        return batch.within(0.0, share, 1.0)

    def _kept_n(
        self, sense: GripSense, wearers_n: Number, given_n: Number, needed_n: Number
    ) -> Number:
        """The grip to keep without evidence: brake first, then stay where the grip is."""
        batch = self._batch
        braking = self._quiet_s < self.BRAKE_S
        # the one sample at which braking ends
        stops = batch.no(braking) & (self._quiet_s < self.BRAKE_S + self._period_s)
        kept_n = batch.choose(stops, batch.most(sense.grip_n, wearers_n), given_n)
        if self.rules.margin:
            kept_n = batch.most(kept_n, needed_n)

        # no more than the wearer's grip is no target of ours
        kept_n = batch.choose(kept_n > wearers_n, kept_n, 0.0)

        # a target below the measured grip brakes the drive, which still closes
        back_n = batch.choose(wearers_n > 0.0, wearers_n, sense.grip_n)
        kept_n = batch.choose(braking, batch.most(back_n, needed_n), kept_n)

        return batch.choose(given_n > 0.0, kept_n, 0.0)

    def _handed_over(self, sense: GripSense) -> Flag:
        """Whether the evidence says hand-over: safe slip, while the load changes."""
        batch = self._batch
        rules = self.rules
        # in a hand-over another person takes or gives weight; a static hold has at most a tremor
        beyond = self._swing.step(sense.load_n, sense.known)
        safe = beyond & (sense.p_safe > rules.yield_p)
        run = batch.choose(safe, self._safe_run + 1.0, 0.0)
        self._safe_run = batch.choose(sense.known, run, self._safe_run)
        if not rules.revocable:
            return batch.false()

        return self._safe_run >= rules.yield_samples


CONTROLLERS: dict[str, type[Controller]] = {
    "none": Controller,
    "pd-shear": PdShear,
    "sliding-mode": SlidingMode,
    "smsp": SlipSteps,
    "ismsp": SlipIntegral,
    "holdfast": Holdfast,
}
