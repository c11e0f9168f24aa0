"""Grip controllers: from what the hand senses to the grip it should have, in N a side.

Pure formulas with a fixed step: no clock, no randomness. Each runs on one hand or on B hands with
the same bits (edge_runtime/lanes.py). A controller only wants; edge_runtime/supervisor.py decides
what may reach the hand. "Own grip" is the grip that the wearer set: it is measured while nothing is
wanted.

    none           wants nothing
    pd-shear       own + kp (T - T0) + kd dT/dt            T: load along the skin, above T0
    sliding-mode   r + k sat((r - N) / phi)                r: own grip; no provision against slip
    smsp           own + one step for every slip event
    ismsp          own + the integral of the slip signal
    holdfast       N + lead * evidence while a slip is likely; taken back when it was a hand-over

pd-shear is the scheme of the SensorHand Speed as the thesis describes it (2.4, [46]); sliding-mode,
smsp and ismsp are those of Engeberg and Meek, IEEE/ASME Trans. Mechatronics 18(1), 2013 ([47] of
the thesis), with the file's band-pass detector as their slip signal. holdfast is ours
(docs/shared-control.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from edge_runtime.friction import FrictionMargin
from edge_runtime.lanes import Flag, Lanes, Number, least, most, within


@dataclass(frozen=True, slots=True)
class GripSense:
    """What a controller knows at one sample.

    grip_n: normal force of either side (half of all fingers' sum). load_n: force along the skin,
    all fingers' sum. p_risky, p_safe: probabilities of risky slip and safe slip. slip: the
    band-pass detector fires while something is held. known: the state is not unknown. empty: the
    state is "nothing". opening, overridden: what the wearer commands.
    """

    grip_n: Number
    load_n: Number
    p_risky: Number
    p_safe: Number
    slip: Flag
    known: Flag
    empty: Flag
    opening: Flag
    overridden: Flag


class OwnGrip:
    """The grip that the wearer set, measured while nothing is wanted; 0 while nothing is held."""

    TIME_S = 0.1

    def __init__(self, lanes: Lanes, rate_hz: float) -> None:
        self._lanes, self._share = lanes, 1.0 / (1.0 + self.TIME_S * rate_hz)
        self.grip_n = lanes.zero()

    def step(self, sense: GripSense, wanted_n: Number) -> Number:
        """The own grip after one sample; it stands still while something is wanted."""
        lanes = self._lanes
        measured_n = self.grip_n + self._share * (sense.grip_n - self.grip_n)
        idle = (wanted_n <= 0.0) & sense.known
        self.grip_n = lanes.choose(idle, lanes.choose(sense.empty, 0.0, measured_n), self.grip_n)
        return self.grip_n


class NoController:
    """Wants nothing: the hand keeps the grip that its wearer set."""

    SETTING = 0.0

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._nothing = lanes.zero()

    def want(self, sense: GripSense) -> Number:
        """0."""
        return self._nothing


class PdShear:
    """own + kp (T - T0) + kd dT/dt while the load T along the skin exceeds T0; setting: kp.

    N = own grip, T0 = 1 N a fixed threshold, kd = 5 ms * kp.
    """

    SETTING = 1.0
    THRESHOLD_N = 1.0
    RATE_S = 0.005

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._lanes, self._rate_hz, self._kp = lanes, rate_hz, setting
        self._own = OwnGrip(lanes, rate_hz)
        self._load_n, self._wanted_n = lanes.zero(), lanes.zero()

    def want(self, sense: GripSense) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes = self._lanes
        own_n = self._own.step(sense, self._wanted_n)
        rate_n_s = (sense.load_n - self._load_n) * self._rate_hz
        self._load_n = sense.load_n
        above_n = sense.load_n - self.THRESHOLD_N + self.RATE_S * rate_n_s
        on = (sense.load_n > self.THRESHOLD_N) & lanes.no(sense.empty)
        self._wanted_n = lanes.choose(on, own_n + self._kp * most(lanes, above_n, 0.0), 0.0)
        return self._wanted_n


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
        self._held_s, self._reference_n = lanes.zero(), lanes.zero()

    def want(self, sense: GripSense) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes = self._lanes
        own_n = self._own.step(sense, self._reference_n)
        self._held_s = lanes.choose(sense.empty, 0.0, self._held_s + self._period_s)
        settled = self._held_s >= self.SETTLED_S
        fresh = settled & (self._reference_n <= 0.0)
        kept_n = lanes.choose(fresh, own_n, self._reference_n)
        self._reference_n = lanes.choose(settled, kept_n, 0.0)
        error = (self._reference_n - sense.grip_n) / self.BOUNDARY_N
        pushed_n = self._reference_n + self._gain_n * within(lanes, -1.0, error, 1.0)
        return lanes.choose(self._reference_n > 0.0, pushed_n, 0.0)


class SlipSteps:
    """own + one step for each slip event, kept until the hand is empty; setting: the step, N."""

    SETTING = 3.0

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._lanes, self._step_n = lanes, setting
        self._own = OwnGrip(lanes, rate_hz)
        self._slipped, self._wanted_n = lanes.false(), lanes.zero()

    def want(self, sense: GripSense) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes = self._lanes
        own_n = self._own.step(sense, self._wanted_n)
        begins = sense.slip & lanes.no(self._slipped)
        self._slipped = sense.slip
        raised_n = most(lanes, self._wanted_n, own_n) + self._step_n
        wanted_n = lanes.choose(begins, raised_n, self._wanted_n)
        self._wanted_n = lanes.choose(sense.empty & sense.known, 0.0, wanted_n)
        return self._wanted_n


class SlipIntegral:
    """own + the integral of the slip signal, kept until the hand is empty; setting: N per s."""

    SETTING = 60.0

    def __init__(self, lanes: Lanes, rate_hz: float, setting: float) -> None:
        self._lanes, self._rise_n = lanes, setting / rate_hz
        self._own = OwnGrip(lanes, rate_hz)
        self._wanted_n = lanes.zero()

    def want(self, sense: GripSense) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes = self._lanes
        own_n = self._own.step(sense, self._wanted_n)
        raised_n = most(lanes, self._wanted_n, own_n) + self._rise_n
        wanted_n = lanes.choose(sense.slip, raised_n, self._wanted_n)
        self._wanted_n = lanes.choose(sense.empty & sense.known, 0.0, wanted_n)
        return self._wanted_n


@dataclass(frozen=True)
class AnswerRules:
    """Parameters of the holdfast controller.

    from_p, full_p: p(risky) at which an answer begins, and at which it is a full one. yield_p:
    p(safe slip) from which the hand gives back. strike_n: largest lead of the wanted grip over the
    measured one. graded: the lead grows with the evidence; otherwise it is always strike_n.
    revocable: a hand-over ends an answer; otherwise only the empty hand does. margin: keep what the
    friction margin needs. spare: grip over the least grip that friction needs.
    """

    from_p: float = 0.35
    full_p: float = 0.75
    yield_p: float = 0.5
    strike_n: float = 15.0
    spare: float = 1.25
    graded: bool = True
    revocable: bool = True
    margin: bool = True


class Holdfast:
    """N + lead * evidence while a slip is likely; what friction needs after it; given back then.

    evidence = (p_risky - from_p) / (full_p - from_p), within 0 and 1. The drive's speed grows with
    the lead of the wanted grip over the measured one N, so the answer is as fast as the evidence is
    strong. Without evidence the grip stays where it is, or where the friction margin wants it.
    setting: the largest lead, N.
    """

    SETTING = AnswerRules.strike_n

    def __init__(
        self, lanes: Lanes, rate_hz: float, setting: float, rules: AnswerRules | None = None
    ) -> None:
        self._lanes, self._lead_n, self.rules = lanes, setting, rules or AnswerRules()
        self._own = OwnGrip(lanes, rate_hz)
        self.margin = FrictionMargin(lanes, rate_hz)
        self._wanted_n, self._rises = lanes.zero(), lanes.false()

    def want(self, sense: GripSense) -> Number:
        """The wanted grip, N a side; 0 for none."""
        lanes, rules = self._lanes, self.rules
        own_n = self._own.step(sense, self._wanted_n)
        self.margin.step(sense)
        wanted_n = lanes.choose(self._wanted_n > 0.0, self._kept_n(sense, own_n), 0.0)
        evidence = self._evidence(sense)
        rises = (evidence > 0.0) & sense.known & lanes.no(sense.empty)
        ahead_n = most(lanes, sense.grip_n, own_n) + self._lead_n * evidence
        wanted_n = lanes.choose(rises, most(lanes, wanted_n, ahead_n), wanted_n)
        ends = sense.empty & sense.known
        if rules.revocable:
            ends = ends | (sense.known & (sense.p_safe > rules.yield_p))
        self._wanted_n = lanes.choose(ends & lanes.no(rises), 0.0, wanted_n)
        self._rises = rises
        return self._wanted_n

    def _evidence(self, sense: GripSense) -> Number:
        """0 to 1."""
        rules, lanes = self.rules, self._lanes
        share = (sense.p_risky - rules.from_p) / (rules.full_p - rules.from_p)
        if not rules.graded:
            return lanes.choose(share >= 1.0, 1.0, 0.0)
        return within(lanes, 0.0, share, 1.0)

    def _kept_n(self, sense: GripSense, own_n: Number) -> Number:
        """The grip to keep when the evidence is over."""
        lanes = self._lanes
        stopped_n = most(lanes, least(lanes, self._wanted_n, sense.grip_n), own_n)
        return lanes.choose(self._rises, stopped_n, self._wanted_n)


CONTROLLERS: dict[str, Callable[..., object]] = {
    "none": NoController,
    "pd-shear": PdShear,
    "sliding-mode": SlidingMode,
    "smsp": SlipSteps,
    "ismsp": SlipIntegral,
    "holdfast": Holdfast,
}
