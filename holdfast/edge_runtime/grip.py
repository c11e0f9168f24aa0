"""Grip controllers: from what the hand senses to the grip it should have, in N a side.

Pure formulas with a fixed step: no clock, no randomness. Each runs on one hand or on B hands with
the same bits (edge_runtime/batch.py). A controller only wants; edge_runtime/supervisor.py decides
what may reach the hand. The wearer's grip is the grip that the wearer set (WearersGrip); while the
wearer closes the hand on an object nothing is wanted.

    none       wants nothing
    holdfast   the larger of two answers, to a slip and to a load that rises

The published controllers that ours is compared with are in studies/shared_control/published.py.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import msgspec

from holdfast.core.schema import ranged
from holdfast.edge_runtime.batch import Batch, Flag, Number
from holdfast.edge_runtime.decision import DecisionRules


# a Struct: two of it are made at every sample, with the caches of a small board cold
class GripSense(msgspec.Struct):
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


class Want(msgspec.Struct):
    """What a controller wants at one sample.

    target_n: the grip of either side, 0 for none. fresh: it has evidence for it at this sample, so
    a target may rise. holds_n: where nothing is known any more the target is given back slowly, and
    not below this.
    """

    target_n: Number
    fresh: Flag
    holds_n: Number


ASSUMED_GAIN = 0.6
"""The shear gain of sensors whose own was not measured: that of a magnet under a soft dome, by
which floors were chosen."""
LARGEST = 1e9
"""No sensor reads more, N or uT."""


def clamped(batch: Batch, sense: GripSense) -> GripSense:
    """The sense with its forces within 0 and LARGEST, and its probabilities within 0 and 1.

    A sample with a number that is NaN is unknown: it says nothing, and the grip is held. Without
    this, one infinite force would stay in what a controller remembers.
    """
    grip_n, load_n = sense.grip_n, sense.load_n
    p_risky, p_safe = sense.p_risky, sense.p_safe
    # only NaN differs from itself
    forces = (grip_n == grip_n) & (load_n == load_n)
    known = sense.known & forces & (p_risky == p_risky) & (p_safe == p_safe)
    within = batch.within
    return GripSense(
        within(0.0, grip_n, LARGEST),
        within(0.0, load_n, LARGEST),
        within(0.0, p_risky, 1.0),
        within(0.0, p_safe, 1.0),
        known,
        sense.empty,
        sense.opening,
        sense.overridden,
    )


class WearersGrip:
    """The grip that the wearer set, N a side; 0 while nothing is held.

    A grip under a target says nothing about it: what is given counts, and what was given for as
    long as a drive takes to come back from it. A larger grip than that does not either, up to
    OURS_TIMES of it: a sensor may read twice what is there, and a drive coasts on. While the hand
    closes nothing is wanted, so the grip is known where the first target is given.

    closes: the hand still closes on its object. It does from the contact on until the grip has not
    risen for STILL_S, and again where it rises within CLOSES_S of the contact. held_s: time since
    the contact, up to MOST_S; seen_s: as much of it as the state was known. A grip that grows by
    AGAIN_SHARE of itself and AGAIN_N at once makes another hold, as if the contact began, unless a
    slip is likely (SLIP_P): fingers that rest on an object before they lift it, or after they have
    set it down, are not known to be empty.
    """

    TIME_S = 0.1
    """Time constant of the low-pass over the measured grip."""
    BACK_S = 0.2
    """Time constant at which what was given fades."""
    OURS_N = 0.5
    """What is given counts as none below it, N a side."""
    OURS_TIMES = 2.5
    RISES_N, RISES_SHARE = 0.1, 0.03
    """A grip rises where it is further above its low-pass than this, N, and this share of it."""
    STILL_S = 0.05
    CLOSES_S = 1.0
    AGAIN_N, AGAIN_SHARE = 0.5, 0.5
    SLIP_P = 0.5
    MOST_S = 10.0
    """Times are bounded, so that they do not grow for days."""

    def __init__(self, batch: Batch, rate_hz: float, in_newtons: bool = True) -> None:
        self._batch = batch
        # in another unit no grip is known to rise, or to be more than a target makes
        self._in_newtons = in_newtons
        self._rises_n = self.RISES_N if in_newtons else math.inf
        self._again_n = self.AGAIN_N if in_newtons else math.inf
        self._period_s = 1.0 / rate_hz
        # the share of a new value in a first-order low-pass
        self._share = 1.0 / (1.0 + self.TIME_S * rate_hz)
        self._back = 1.0 / (1.0 + self.BACK_S * rate_hz)
        self._ours_n = batch.zero()
        self._still_s = batch.zero()
        self.grip_n = batch.zero()
        self.held_s = batch.zero()
        self.seen_s = batch.zero()
        self.closes = batch.false()

    def step(self, sense: GripSense, given_n: Number) -> Number:
        """The wearer's grip after one sample. given_n: the target that the hand has."""
        batch = self._batch
        faded_n = self._ours_n + self._back * (given_n - self._ours_n)
        self._ours_n = batch.most(given_n, faded_n)
        is_ours = self._ours_n > self.OURS_N
        if self._in_newtons:
            made_n = self.OURS_TIMES * self._ours_n + self.OURS_N
            is_ours = is_ours & (sense.grip_n < made_n)
        measures = sense.known & batch.no(is_ours)

        rise_n = sense.grip_n - self.grip_n
        rises = rise_n > self._rises_n + self.RISES_SHARE * self.grip_n
        again = rise_n > self._again_n + self.AGAIN_SHARE * self.grip_n
        again = again & (sense.p_risky < self.SLIP_P)
        smooth_n = self.grip_n + self._share * rise_n
        self.grip_n = batch.choose(measures, smooth_n, self.grip_n)

        later_s = batch.least(self._still_s + self._period_s, self.MOST_S)
        still_s = batch.choose(measures & rises, 0.0, later_s)
        self._still_s = batch.choose(sense.known, still_s, self._still_s)
        # a hold goes on while its state is unknown
        another = measures & again
        later_s = batch.least(self.held_s + self._period_s, self.MOST_S)
        self.held_s = batch.choose(another, 0.0, later_s)
        later_s = batch.least(self.seen_s + self._period_s, self.MOST_S)
        later_s = batch.choose(sense.known, later_s, self.seen_s)
        self.seen_s = batch.choose(another, 0.0, later_s)
        self._let_go(sense.known & sense.empty)
        early = self.held_s < self.CLOSES_S
        self.closes = (self._still_s < self.STILL_S) & early
        return self.grip_n

    def _let_go(self, empty: Flag) -> None:
        """An empty hand has no grip, and closes on the next object."""
        batch = self._batch
        self.grip_n = batch.choose(empty, 0.0, self.grip_n)
        self._ours_n = batch.choose(empty, 0.0, self._ours_n)
        self._still_s = batch.choose(empty, 0.0, self._still_s)
        self.held_s = batch.choose(empty, 0.0, self.held_s)
        self.seen_s = batch.choose(empty, 0.0, self.seen_s)


class Controller:
    """What every controller has; this one wants nothing: the hand keeps the wearer's grip.

    setting: the parameter that studies vary, None for its default. rules: those that come with a
    model, None for the usual ones. shear_gain: ratio of shear and normal force as the sensors read
    it, over the true one; None where it was not measured.
    """

    SETTING = 0.0
    """Its default."""

    def __init__(
        self,
        batch: Batch,
        rate_hz: float,
        setting: float | None = None,
        rules: AnswerRules | None = None,
        shear_gain: float | None = None,
    ) -> None:
        self._batch = batch
        self._rate_hz = rate_hz
        self.shear_gain = shear_gain
        self._setting = self.SETTING if setting is None else setting
        self._period_s = 1.0 / rate_hz
        self.rules = rules or AnswerRules()
        self._wearer = WearersGrip(batch, rate_hz, self.rules.in_newtons)

    @property
    def wearers_n(self) -> Number:
        """The grip that the wearer set, as measured, N a side."""
        return self._wearer.grip_n

    def want(
        self, sense: GripSense, given_n: Number, needed_n: Number, holds_n: Number
    ) -> Want:
        """What is wanted at one sample.

        given_n: what the supervisor gave last. By the friction margin, N a side: needed_n, 0 if
        unknown; holds_n, the grip that is known to hold the load.
        """
        return Want(self._batch.zero(), self._batch.false(), holds_n)


@dataclass(frozen=True)
class AnswerRules:
    """Parameters of the holdfast controller.

    Each number says its range and what it is: the table [rules] of holdfast.toml and the options in
    C are made from them. What ends in _n is N a side, and has no end in another unit. detects,
    follows: whether slips, and loads, are answered; studies leave one out. in_newtons: forces are.
    """

    from_p: float = ranged(
        DecisionRules.answer_permille / 1000,
        "p(risky slip) that begins an answer",
        ge=0.001,
        le=0.998,
    )
    full_p: float = ranged(
        DecisionRules.full_answer_permille / 1000,
        "p(risky slip) of a full answer; above from_p",
        ge=0.002,
        le=0.999,
    )
    rise_n: float = ranged(6.0, "most that a slip adds to the wearer's grip")
    follow_n: float = ranged(6.0, "most that a load adds to the wearer's grip")
    most_over_n: float = ranged(
        math.inf, "most that any target is above the wearer's grip"
    )
    # as read by sensors that read ASSUMED_GAIN of the shear
    floor: float = ranged(
        DecisionRules.follow_floor_permille / 1000,
        "share of friction in use up to which no load is followed",
        ge=0.001,
        le=1.0,
    )
    above: float = ranged(
        DecisionRules.follow_above_permille / 1000,
        "a load that is followed leaves so many times the usual share in use",
        ge=1.001,
        le=10.0,
    )
    # another person may take the object
    safe_p: float = ranged(0.5, "p(safe slip) from which safe_follow_n counts", le=1.0)
    safe_follow_n: float = ranged(
        DecisionRules.safe_follow_mn / 1000, "follow_n during a safe slip; 0: none"
    )
    detects: bool = True
    follows: bool = True
    in_newtons: bool = True

    @classmethod
    def of(cls, decision: DecisionRules, **others: Any) -> AnswerRules:
        """Those that come with a model; others: what shall differ from them."""
        usual = cls(
            from_p=decision.answer_permille / 1000,
            full_p=decision.full_answer_permille / 1000,
            floor=decision.follow_floor_permille / 1000,
            above=decision.follow_above_permille / 1000,
            safe_follow_n=decision.safe_follow_mn / 1000,
        )
        return replace(usual, **others)

    def without_newtons(self) -> AnswerRules:
        """For forces in another unit, of which no rise is known to be large; none stays none."""
        rises = [name for name in asdict(self) if name.endswith("_n")]
        endless: dict[str, Any] = {
            name: math.inf for name in rises if getattr(self, name)
        }
        return replace(self, in_newtons=False, **endless)


class FrictionInUse:
    """The share of friction in use, and what is usual on it in this hold.

    In use is u = T / (2 max(N, LEAST_N)), the force along the skin over the normal force. Usual is
    its mean, and TIMES its mean deviation. Both are learned in two steps. While the wearer makes
    the hold, from the contact on for LEARNS_S and until the hand has closed, quickly (QUICK_S),
    whatever is given: a pick-up is no slip. Afterwards slowly (MEAN_S), while no target is given
    and the load does not rise.
    """

    LEARNS_S = 0.6
    QUICK_S = 0.15
    MEAN_S = 1.0
    TIMES = 2.0
    """A tremor stays below so many times its mean deviation: of a sine the peak is 1.6."""
    LOAD_S, LONG_S = 0.1, 0.4
    """Time constants of two low-passes over the load; it rises where one is RISES of the other."""
    RISES = 1.2
    LEAST_N = 0.5
    """Below it the ratio of two noisy numbers means little, N a side."""

    def __init__(self, batch: Batch, rate_hz: float) -> None:
        self._batch = batch
        self._slow = 1.0 / (1.0 + self.MEAN_S * rate_hz)
        self._quick = 1.0 / (1.0 + self.QUICK_S * rate_hz)
        self._short = 1.0 / (1.0 + self.LOAD_S * rate_hz)
        self._long = 1.0 / (1.0 + self.LONG_S * rate_hz)
        self._load_n = batch.zero()
        self._long_n = batch.zero()
        self._mean = batch.zero()
        self._deviation = batch.zero()
        self.used = batch.zero()
        self.usual = batch.zero()
        self.makes = batch.false()

    def step(self, sense: GripSense, given_n: Number, wearer: WearersGrip) -> None:
        """Take one sample: used is of this sample, usual of those before."""
        batch = self._batch
        self.used = sense.load_n / (2.0 * batch.most(sense.grip_n, self.LEAST_N))
        self.usual = self._mean + self.TIMES * self._deviation
        self.makes = wearer.closes | (wearer.seen_s < self.LEARNS_S)

        holds = sense.known & batch.no(sense.empty)
        self._pass_load(sense, holds)
        grows = self._load_n > self.RISES * self._long_n
        learns = holds & (self.makes | ((given_n <= 0.0) & batch.no(grows)))
        self._learn(learns)
        self._forget(sense.known & sense.empty)

    def _pass_load(self, sense: GripSense, holds: Flag) -> None:
        """Both low-passes over the load."""
        batch = self._batch
        load_n = self._load_n + self._short * (sense.load_n - self._load_n)
        long_n = self._long_n + self._long * (sense.load_n - self._long_n)
        self._load_n = batch.choose(holds, load_n, self._load_n)
        self._long_n = batch.choose(holds, long_n, self._long_n)

    def _learn(self, learns: Flag) -> None:
        """Mean and deviation of what is in use."""
        batch = self._batch
        used = self.used
        share = batch.choose(self.makes, self._quick, self._slow)
        deviation = batch.most(used - self._mean, self._mean - used)
        mean = self._mean + share * (used - self._mean)
        deviation = self._deviation + share * (deviation - self._deviation)
        self._mean = batch.choose(learns, mean, self._mean)
        self._deviation = batch.choose(learns, deviation, self._deviation)

    def _forget(self, empty: Flag) -> None:
        """The next hold is another one."""
        batch = self._batch
        self._mean = batch.choose(empty, 0.0, self._mean)
        self._deviation = batch.choose(empty, 0.0, self._deviation)
        self._load_n = batch.choose(empty, 0.0, self._load_n)
        self._long_n = batch.choose(empty, 0.0, self._long_n)


class SlipAnswer:
    """Leads the grip by the evidence of a slip.

    The wanted grip is N + lead * evidence while a slip is likely, with

    evidence = (p_risky - from_p) / (full_p - from_p), within 0 and 1. The drive's speed grows with
    the lead of the wanted grip over the measured one N, so the answer is as fast as the evidence is
    strong. Evidence fades within FADES_S instead of ending at once: the closing hand itself raises
    the normal force, so a slip soon looks like a firm grasp. When it has ended the drive is braked,
    and the grip stays where it is, or where the friction margin wants it. The lead sets the drive's
    speed. The grip itself rises by rise_n over the wearer's, or to what friction is known to need,
    and no further.

    In a young hold a model is most often wrong, and mostly for a sample or two. A slip begins with
    a rise of friction in use, so up to YOUNG_S from the contact on evidence counts as far as more
    is in use than usual in this hold: in full from FULL_TIMES the usual on. While what is usual is
    learned it does not count at all.
    """

    FADES_S = 0.06
    """Within it full evidence becomes none: about the drive's lag, in which no grip rises yet."""
    BRAKE_S = 0.02
    """So long after the evidence, in a known state, the target goes back: the drive coasts."""
    YOUNG_S = 2.0
    FULL_TIMES = 1.3
    LEAST_USUAL = 0.02
    """A smaller share of friction than this is none."""

    def __init__(
        self, batch: Batch, rate_hz: float, lead_n: float, rules: AnswerRules
    ) -> None:
        self._batch = batch
        self._period_s = 1.0 / rate_hz
        self._lead_n = lead_n
        self._rules = rules
        self._quiet_s = batch.zero()
        self._last_evidence = batch.zero()

    def step(
        self,
        sense: GripSense,
        wearer: WearersGrip,
        friction: FrictionInUse,
        given_n: Number,
        needed_n: Number,
    ) -> tuple[Number, Flag]:
        """(the wanted grip, N a side, 0 for none; whether there is evidence).

        given_n, needed_n: as Controller.want.
        """
        batch = self._batch
        wearers_n = wearer.grip_n
        holds = sense.known & batch.no(sense.empty)
        counts = self._counts(wearer, friction)
        now = batch.choose(holds, counts * self._evidence(sense), 0.0)
        fading = self._last_evidence - self._period_s / self.FADES_S
        evidence = batch.choose(holds, batch.most(now, fading), 0.0)
        rises = evidence > 0.0
        ahead_n = batch.most(sense.grip_n, wearers_n) + self._lead_n * evidence
        # A lead without an end would press the object out of the hand.
        most_n = batch.most(wearers_n + self._rules.rise_n, needed_n)
        ahead_n = batch.choose(sense.grip_n < most_n, ahead_n, most_n)
        kept_n = self._kept_n(sense, wearers_n, given_n, needed_n)
        self._last_evidence = batch.choose(sense.known, evidence, self._last_evidence)

        # bounded, so that it does not grow for days; only times below BRAKE_S matter
        later_s = batch.least(self._quiet_s + self._period_s, 1.0)
        quiet_s = batch.choose(rises, 0.0, later_s)
        self._quiet_s = batch.choose(sense.known, quiet_s, self._quiet_s)
        return batch.choose(rises, ahead_n, kept_n), rises

    def _evidence(self, sense: GripSense) -> Number:
        """How much of a full answer a slip calls for, 0 to 1."""
        rules = self._rules
        if not rules.detects:
            return self._batch.zero()
        share = (sense.p_risky - rules.from_p) / (rules.full_p - rules.from_p)
        return self._batch.within(0.0, share, 1.0)

    def _counts(self, wearer: WearersGrip, friction: FrictionInUse) -> Number:
        """How far evidence counts, 0 to 1: in a young hold as far as friction in use has risen."""
        batch = self._batch
        usual = batch.most(friction.usual, self.LEAST_USUAL)
        risen = (friction.used - usual) / ((self.FULL_TIMES - 1.0) * usual)
        risen = batch.choose(friction.makes, 0.0, batch.within(0.0, risen, 1.0))
        return batch.choose(wearer.held_s < self.YOUNG_S, risen, 1.0)

    def _kept_n(
        self, sense: GripSense, wearers_n: Number, given_n: Number, needed_n: Number
    ) -> Number:
        """The grip to keep without evidence: brake first, then stay where the grip is."""
        batch = self._batch
        braking = self._quiet_s < self.BRAKE_S
        # the one sample at which braking ends
        stops = batch.no(braking) & (self._quiet_s < self.BRAKE_S + self._period_s)
        kept_n = batch.choose(stops, batch.most(sense.grip_n, wearers_n), given_n)
        kept_n = batch.most(kept_n, needed_n)

        # no more than the wearer's grip is no target of ours
        kept_n = batch.choose(kept_n > wearers_n, kept_n, 0.0)

        # a target below the measured grip brakes the drive, which still closes
        back_n = batch.choose(wearers_n > 0.0, wearers_n, sense.grip_n)
        kept_n = batch.choose(braking, batch.most(back_n, needed_n), kept_n)

        return batch.choose(given_n > 0.0, kept_n, 0.0)


class LoadFollower:
    """The grip that keeps the share of friction in use where it was: it rises with the load.

    The reference is what is usual in this hold (FrictionInUse); at least the floor. `above` times
    the reference may be in use. A load is followed while more than STARTS times that is. The grip
    should then be so large that the load to come uses no more than may be in use:
    T / (2 above reference), where T is the load AHEAD_S later if it rises on as it does. A drive
    needs that long: where a support sinks away, a grip for the load of now is always late. The grip
    asked for is at most MOST_N and MOST_TIMES the wearer's grip over it. So a wearer who closes a
    touching hand soon grips by more than a target made. While what is usual is learned, nothing is
    followed. shear_gain: as Controller; the floor is a share of friction, so it is higher in the
    readings of a sensor that reads more of the shear.
    """

    STARTS = 1.2
    AHEAD_S = 0.12
    RATE_S = 0.03
    """Time constant of a low-pass over the load, which is so much behind a steady rise."""
    MOST_N, MOST_TIMES = 1.0, 2.0

    def __init__(
        self,
        batch: Batch,
        rate_hz: float,
        rules: AnswerRules,
        shear_gain: float | None = None,
    ) -> None:
        self._batch = batch
        self._rules = rules
        self._share = 1.0 / (1.0 + self.RATE_S * rate_hz)
        self._behind_n = batch.zero()
        self._floor = rules.floor * ((shear_gain or ASSUMED_GAIN) / ASSUMED_GAIN)
        # in another unit no rise is known to be large
        self._most_n = self.MOST_N if rules.in_newtons else math.inf

    def step(
        self, sense: GripSense, wearer: WearersGrip, friction: FrictionInUse
    ) -> Number:
        """The grip that the load asks for, N a side; 0 where it does not rise."""
        batch = self._batch
        behind_n = self._behind_n + self._share * (sense.load_n - self._behind_n)
        self._behind_n = batch.choose(sense.known, behind_n, self._behind_n)
        rise_n = batch.most(sense.load_n - behind_n, 0.0)
        ahead_n = sense.load_n + (self.AHEAD_S / self.RATE_S) * rise_n

        holds = sense.known & batch.no(sense.empty)
        reference = batch.most(friction.usual, self._floor)
        allowed = self._rules.above * reference
        rises = friction.used > self.STARTS * allowed
        rises = rises & holds & batch.no(friction.makes)

        # another person who takes the object raises the load as well
        taken = sense.p_safe >= self._rules.safe_p
        most_n = batch.choose(taken, self._rules.safe_follow_n, self._rules.follow_n)
        most_n = batch.least(most_n, self._most_n + self.MOST_TIMES * wearer.grip_n)
        asked_n = batch.least(ahead_n / (2.0 * allowed), wearer.grip_n + most_n)
        return batch.choose(rises & (most_n > 0.0), asked_n, 0.0)


class Holdfast(Controller):
    """The larger of two answers: to a slip, and to a load that rises. setting: the lead, N.

    What is fast is seen by its slip alone, what is slow by its load before anything slips. Up to
    EARLY_S from the contact on no target is more than EARLY_N above the wearer's grip: what is read
    then is mostly the closing hand.
    """

    SETTING = 22.0
    EARLY_S = 1.2
    EARLY_N = 2.0

    def __init__(
        self,
        batch: Batch,
        rate_hz: float,
        setting: float | None = None,
        rules: AnswerRules | None = None,
        shear_gain: float | None = None,
    ) -> None:
        super().__init__(batch, rate_hz, setting, rules, shear_gain)
        self._slip = SlipAnswer(batch, rate_hz, self._setting, self.rules)
        self._load = LoadFollower(batch, rate_hz, self.rules, shear_gain)
        self._friction = FrictionInUse(batch, rate_hz)
        # in another unit no target is known to be small
        self._early_n = self.EARLY_N if self.rules.in_newtons else math.inf

    def want(
        self, sense: GripSense, given_n: Number, needed_n: Number, holds_n: Number
    ) -> Want:
        batch = self._batch
        wearer, friction = self._wearer, self._friction
        wearers_n = wearer.step(sense, given_n)
        friction.step(sense, given_n, wearer)
        wanted_n, fresh = self._slip.step(sense, wearer, friction, given_n, needed_n)
        if self.rules.follows:
            asked_n = self._load.step(sense, wearer, friction)
            fresh = fresh | (asked_n > 0.0)
            wanted_n = batch.most(wanted_n, asked_n)

        # while the hand closes no sensor tells the wearer's grip from ours
        fresh = fresh & batch.no(wearer.closes)
        wanted_n = batch.choose(wearer.closes, 0.0, wanted_n)

        most_n = batch.choose(wearer.held_s < self.EARLY_S, self._early_n, math.inf)
        most_n = batch.least(most_n, self.rules.most_over_n)
        return Want(batch.least(wanted_n, wearers_n + most_n), fresh, holds_n)


CONTROLLERS: dict[str, type[Controller]] = {"none": Controller, "holdfast": Holdfast}
