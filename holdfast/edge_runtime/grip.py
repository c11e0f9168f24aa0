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
    holdfast       N + lead * evidence while a slip is likely; taken back when it was a hand-over

pd-shear is the scheme of the SensorHand Speed as the thesis describes it (2.4, [46]); sliding-mode,
smsp and ismsp are those of Engeberg and Meek, IEEE/ASME Trans. Mechatronics 18(1), 2013 ([47] of
the thesis). Their slip signal here is the model's: p(risky slip) above SLIP_P in a firm grip, so
that controllers differ in their answers only. holdfast is ours (docs/shared-control.md).
"""

from __future__ import annotations

from dataclasses import dataclass

from holdfast.edge_runtime.batch import Batch, Flag, Number

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
    p(safe slip) from which the hand gives back, where the load changes by moving_n_s or more for
    yield_samples in a row. graded: the lead grows with the evidence; otherwise it is full from half
    the evidence on, or nothing. revocable: a hand-over ends an answer; otherwise only the empty
    hand does. margin: what the friction margin needs is kept.
    """

    from_p: float = 0.7
    full_p: float = 0.85
    yield_p: float = 0.5
    yield_samples: int = 2
    moving_n_s: float = 4.0
    graded: bool = True
    revocable: bool = True
    margin: bool = True


class Holdfast(Controller):
    """Leads the grip by the evidence of a slip, and gives back in a hand-over.

    The wanted grip is N + lead * evidence while a slip is likely, with

    evidence = (p_risky - from_p) / (full_p - from_p), within 0 and 1. The drive's speed grows with
    the lead of the wanted grip over the measured one N, so the answer is as fast as the evidence is
    strong. When the evidence ends the drive is braked, and the grip stays where it is, or where the
    friction margin wants it, until the evidence says hand-over. setting: the largest lead, N.
    """

    SETTING = 22.0
    RATE_S = 0.03
    """Time constant of the low-pass over the change of the load."""
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
        self._share = 1.0 / (1.0 + self.RATE_S * rate_hz)
        self._load_n = batch.zero()
        self._change_n_s = batch.zero()
        self._safe_run = batch.zero()
        self._quiet_s = batch.zero()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        batch = self._batch
        wearers_n = self._wearer.step(sense, given_n)
        evidence = self._evidence(sense)
        rises = (evidence > 0.0) & sense.known & batch.no(sense.empty)
        ahead_n = batch.most(sense.grip_n, wearers_n) + self._setting * evidence
        kept_n = self._kept_n(sense, wearers_n, given_n, needed_n)
        wanted_n = batch.choose(rises, ahead_n, kept_n)
        # a slip that is likely outweighs a hand-over
        ends = self._handed_over(sense) & batch.no(rises)

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
        load_n = batch.choose(sense.known, sense.load_n, self._load_n)
        change_n_s = (load_n - self._load_n) * self._rate_hz
        self._load_n = load_n

        # smoothed, because a difference of two samples is mostly noise
        smooth_n_s = self._change_n_s + self._share * (change_n_s - self._change_n_s)
        self._change_n_s = batch.choose(sense.known, smooth_n_s, self._change_n_s)

        # in a hand-over another person takes or gives weight; in a static hold nothing changes
        grows = self._change_n_s > rules.moving_n_s
        falls = self._change_n_s < -rules.moving_n_s
        safe = (grows | falls) & (sense.p_safe > rules.yield_p)
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
