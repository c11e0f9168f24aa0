"""Grip controllers: from what the hand senses to the grip it should have, in N a side.

Pure formulas with a fixed step: no clock, no randomness. Each runs on one hand or on B hands with
the same bits (edge_runtime/batch.py). A controller only wants; edge_runtime/supervisor.py decides
what may reach the hand. "Own grip" is the grip that the wearer set: it is measured while no
target is given.

    none           wants nothing
    pd-shear       own + kp (T - T0) + kd dT/dt            T: load along the skin, above T0
    sliding-mode   r + k sat((r - N) / phi)                r: own grip; no provision against slip
    smsp           own + one step for every slip event
    ismsp          own + the integral of the slip signal
    holdfast       N + lead * evidence while a slip is likely; taken back when it was a hand-over

pd-shear is the scheme of the SensorHand Speed as the thesis describes it (2.4, [46]); sliding-mode,
smsp and ismsp are those of Engeberg and Meek, IEEE/ASME Trans. Mechatronics 18(1), 2013 ([47] of
the thesis). Their slip signal here is the model's: p(risky slip) above SLIP_P in a firm grip, so
that controllers differ in their answers only. holdfast is ours (docs/shared-control.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from holdfast.edge_runtime.batch import Flag, Lanes, Number

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


class OwnGrip:
    """The grip that the wearer set, measured while no target is given; 0 while nothing is held."""

    TIME_S = 0.1

    def __init__(self, lanes: Lanes, rate_hz: float) -> None:
        self._lanes, self._share = lanes, 1.0 / (1.0 + self.TIME_S * rate_hz)
        self.grip_n = lanes.zero()

    def step(self, sense: GripSense, given_n: Number) -> Number:
        """The own grip after one sample; it stands still while a target is given."""
        lanes = self._lanes
        measured_n = self.grip_n + self._share * (sense.grip_n - self.grip_n)
        idle = (given_n <= 0.0) & sense.known
        self.grip_n = lanes.choose(
            idle, lanes.choose(sense.empty, 0.0, measured_n), self.grip_n
        )
        return self.grip_n


class NoController:
    """Wants nothing: the hand keeps the grip that its wearer set."""

    SETTING = 0.0

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._nothing, self.fresh = lanes.zero(), lanes.false()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """0."""
        return self._nothing


class PdShear:
    """own + kp (T - T0) + kd dT/dt while the load T along the skin exceeds T0; setting: kp.

    T0 = 1 N, a fixed threshold; kd = 5 ms * kp.
    """

    SETTING = 1.0
    THRESHOLD_N = 1.0
    RATE_S = 0.005

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._lanes, self._rate_hz, self._kp = lanes, rate_hz, setting
        self._own = OwnGrip(lanes, rate_hz)
        self._load_n, self.fresh = lanes.zero(), lanes.false()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes = self._lanes
        own_n = self._own.step(sense, given_n)
        load_n = lanes.choose(sense.known, sense.load_n, self._load_n)
        rate_n_s = (load_n - self._load_n) * self._rate_hz
        self._load_n = load_n
        above_n = load_n - self.THRESHOLD_N + self.RATE_S * rate_n_s
        self.fresh = (load_n > self.THRESHOLD_N) & lanes.no(sense.empty)
        return lanes.choose(
            self.fresh, own_n + self._kp * lanes.most(above_n, 0.0), 0.0
        )


class SlidingMode:
    """r + k sat((r - N) / phi): keeps the grip N at r, the own grip; setting: k, N.

    r is the own grip half a second after contact. There is no provision against slip.
    """

    SETTING = 2.0
    BOUNDARY_N = 1.0
    SETTLED_S = 0.5

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._lanes, self._gain_n = lanes, setting
        self._period_s = 1.0 / rate_hz
        self._own = OwnGrip(lanes, rate_hz)
        self._held_s, self._reference_n, self.fresh = (
            lanes.zero(),
            lanes.zero(),
            lanes.false(),
        )

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes = self._lanes
        own_n = self._own.step(sense, self._reference_n)
        self._held_s = lanes.choose(sense.empty, 0.0, self._held_s + self._period_s)
        self.fresh = self._held_s >= self.SETTLED_S
        kept_n = lanes.choose(self._reference_n > 0.0, self._reference_n, own_n)
        self._reference_n = lanes.choose(self.fresh, kept_n, 0.0)
        error = (self._reference_n - sense.grip_n) / self.BOUNDARY_N
        pushed_n = self._reference_n + self._gain_n * lanes.within(-1.0, error, 1.0)
        return lanes.choose(self.fresh, lanes.most(pushed_n, 0.0), 0.0)


def _slips(sense: GripSense) -> Flag:
    """The slip signal of the published controllers."""
    return (sense.p_risky > SLIP_P) & (sense.grip_n > HELD_N) & sense.known


class SlipSteps:
    """own + one step for each slip event; setting: the step, N."""

    SETTING = 8.0

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._lanes, self._step_n = lanes, setting
        self._own = OwnGrip(lanes, rate_hz)
        self._slipped, self.fresh = lanes.false(), lanes.false()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes = self._lanes
        own_n = self._own.step(sense, given_n)
        slips = _slips(sense)
        self.fresh = slips & lanes.no(self._slipped)
        self._slipped = lanes.choose(sense.known, slips, self._slipped)
        raised_n = lanes.most(given_n, own_n) + self._step_n
        return lanes.choose(self.fresh, raised_n, given_n)


class SlipIntegral:
    """own + the integral of the slip signal; setting: N per s of slip."""

    SETTING = 200.0

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._lanes, self._rise_n = lanes, setting / rate_hz
        self._own = OwnGrip(lanes, rate_hz)
        self.fresh = lanes.false()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes = self._lanes
        own_n = self._own.step(sense, given_n)
        self.fresh = _slips(sense)
        raised_n = lanes.most(given_n, own_n) + self._rise_n
        return lanes.choose(self.fresh, raised_n, given_n)


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


class Holdfast:
    """N + lead * evidence while a slip is likely; what friction needs after it; given back then.

    evidence = (p_risky - from_p) / (full_p - from_p), within 0 and 1. The drive's speed grows with
    the lead of the wanted grip over the measured one N, so the answer is as fast as the evidence is
    strong. When the evidence ends the drive is braked, and the grip stays where it is, or where the
    friction margin wants it, until the evidence says hand-over. setting: the largest lead, N.
    """

    SETTING = 22.0
    RATE_S = 0.03
    BRAKE_S = 0.02
    """So long after the evidence, in a known state, the target goes back: the drive coasts."""

    def __init__(
        self,
        lanes: Lanes,
        rate_hz: float,
        setting: float,
        rules: AnswerRules | None = None,
    ) -> None:
        self._lanes, self._lead_n, self.rules = lanes, setting, rules or AnswerRules()
        self._own = OwnGrip(lanes, rate_hz)
        self._rate_hz, self._share = rate_hz, 1.0 / (1.0 + self.RATE_S * rate_hz)
        self._period_s = 1.0 / rate_hz
        self._load_n, self._change_n_s, self._safe_run = (
            lanes.zero() for _ in range(3)
        )
        self._quiet_s, self.fresh = lanes.zero(), lanes.false()

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none. needed_n: by the friction margin, 0 if unknown."""
        lanes = self._lanes
        own_n = self._own.step(sense, given_n)
        evidence = self._evidence(sense)
        rises = (evidence > 0.0) & sense.known & lanes.no(sense.empty)
        ahead_n = lanes.most(sense.grip_n, own_n) + self._lead_n * evidence
        kept_n = self._kept_n(sense, own_n, given_n, needed_n)
        wanted_n = lanes.choose(rises, ahead_n, kept_n)
        ends = self._handed_over(sense) & lanes.no(rises)
        later_s = lanes.least(self._quiet_s + self._period_s, 1.0)
        quiet_s = lanes.choose(rises, 0.0, later_s)
        self._quiet_s = lanes.choose(sense.known, quiet_s, self._quiet_s)
        self.fresh = rises
        return lanes.choose(ends, 0.0, wanted_n)

    def _evidence(self, sense: GripSense) -> Number:
        """0 to 1."""
        rules, lanes = self.rules, self._lanes
        share = (sense.p_risky - rules.from_p) / (rules.full_p - rules.from_p)
        if not rules.graded:
            return lanes.choose(share >= 0.5, 1.0, 0.0)
        return lanes.within(0.0, share, 1.0)

    def _kept_n(
        self, sense: GripSense, own_n: Number, given_n: Number, needed_n: Number
    ) -> Number:
        """The grip to keep without evidence: brake first, then stay where the grip is."""
        lanes = self._lanes
        braking = self._quiet_s < self.BRAKE_S
        stops = lanes.no(braking) & (self._quiet_s < self.BRAKE_S + self._period_s)
        kept_n = lanes.choose(stops, lanes.most(sense.grip_n, own_n), given_n)
        if self.rules.margin:
            kept_n = lanes.most(kept_n, needed_n)
        back_n = lanes.most(lanes.choose(own_n > 0.0, own_n, sense.grip_n), needed_n)
        kept_n = lanes.choose(
            braking, back_n, lanes.choose(kept_n > own_n, kept_n, 0.0)
        )
        return lanes.choose(given_n > 0.0, kept_n, 0.0)

    def _handed_over(self, sense: GripSense) -> Flag:
        """Whether the evidence says hand-over: safe slip, while the load changes."""
        lanes, rules = self._lanes, self.rules
        load_n = lanes.choose(sense.known, sense.load_n, self._load_n)
        change_n_s = (load_n - self._load_n) * self._rate_hz
        self._load_n = load_n
        smooth_n_s = self._change_n_s + self._share * (change_n_s - self._change_n_s)
        self._change_n_s = lanes.choose(sense.known, smooth_n_s, self._change_n_s)
        moving = (self._change_n_s > rules.moving_n_s) | (
            self._change_n_s < -rules.moving_n_s
        )
        run = lanes.choose(
            moving & (sense.p_safe > rules.yield_p), self._safe_run + 1.0, 0.0
        )
        self._safe_run = lanes.choose(sense.known, run, self._safe_run)
        if not rules.revocable:
            return lanes.false()
        return self._safe_run >= rules.yield_samples


class Controller(Protocol):
    """What every controller has. fresh: whether it has evidence at the last sample."""

    SETTING: float
    fresh: Flag

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None: ...

    def want(self, sense: GripSense, given_n: Number, needed_n: Number) -> Number:
        """The wanted grip, N a side; 0 for none. given_n: what the supervisor gave last."""
        ...


CONTROLLERS: dict[str, type[Controller]] = {
    "none": NoController,
    "pd-shear": PdShear,
    "sliding-mode": SlidingMode,
    "smsp": SlipSteps,
    "ismsp": SlipIntegral,
    "holdfast": Holdfast,
}
