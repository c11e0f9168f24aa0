"""Controller, friction margin and supervisor joined: from one prediction to one grip command.

Friction, as far as a slip has shown it: what the fingers hold, and what they need.

While the object slides the fingers bear no more than friction allows, so the ratio of the force
along the skin to the normal force stands still at the friction coefficient (Coulomb), whatever the
load is. It is never larger, so the largest ratio that has stood still is the best one:

    ratio        r = T / 2N
    mu_hat       the largest r that stood still for SAMPLES, while a slip was all but certain
    needed_n     spare T / (2 mu_hat)             N: normal force of either side
    margin       1 - T / (2 mu_hat N)             0: about to slide
    holds_n      needed_n; before a slip has shown friction, T / (2 held)

Nothing is known before the first slip: then mu_hat is 0 here and null in messages, never a guess.
The largest ratio that the hand has held in quiet (`held`) bounds friction from below, so a grip of
holds_n is known to hold the load. Less is a guess.

r is of all fingers' sums, because one finger's ratio is mostly noise at 0.3 N. It is in the
sensors' own units. shear_gain: by how much they read too little along the skin, from their
calibration.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from holdfast.core.contract import BoolArray, FloatArray, Prediction, Unit
from holdfast.core.errors import UsageError
from holdfast.edge_runtime.batch import ONE_LANE, Lanes, Number
from holdfast.edge_runtime.grip import CONTROLLERS, AnswerRules, Controller, GripSense
from holdfast.edge_runtime.supervisor import (
    HOLD,
    IDLE,
    MODES,
    YIELD,
    GripCommand,
    Limits,
    Supervisor,
)

if TYPE_CHECKING:
    from holdfast.edge_runtime.grip import GripSense


FIRM_N = 0.3
"""A ratio counts from this grip on, N a side."""
SAMPLES = 6
"""A caught object's load and grip may grow together for less than this: that is no slide."""
STEADY = 0.1
"""Ratios whose spread over the largest is below this stand still."""
SURE_P = 0.9
"""p(risky slip) from which a slip is all but certain."""
QUIET_P = 0.2
SPARE = 1.25
"""Grip over the least grip that friction needs."""
LEAST_MU = 0.05
QUIET_S = 0.1


class FrictionMargin:
    """Friction of the object in the hand; forgets it when the hand is empty."""

    def __init__(self, lanes: Lanes, rate_hz: float, shear_gain: float = 1.0) -> None:
        self._lanes, self._gain = lanes, shear_gain
        self._share = 1.0 / (1.0 + QUIET_S * rate_hz)
        self._last = [lanes.zero()] * (SAMPLES - 1)
        self._slid, self._quiet = lanes.zero(), lanes.zero()
        self.held, self.mu_hat = lanes.zero(), lanes.zero()
        self.needed_n, self.holds_n, self.margin = (
            lanes.zero(),
            lanes.zero(),
            lanes.zero(),
        )

    def step(self, sense: GripSense) -> None:
        """Take in one sample."""
        lanes = self._lanes
        load_n = self._gain * sense.load_n
        firm = (sense.grip_n > FIRM_N) & sense.known
        ratio = lanes.choose(
            firm, load_n / (2.0 * lanes.most(sense.grip_n, FIRM_N)), 0.0
        )
        self._take(sense, ratio)
        self._hold(sense, ratio, firm)
        self._forget(sense)
        self._conclude(sense, load_n, firm)

    def _conclude(self, sense: GripSense, load_n: Number, firm: Number) -> None:
        """mu_hat, margin and the needed grip after this sample."""
        lanes = self._lanes
        sure = self._slid > 0.0
        lower = lanes.most(lanes.most(self._slid, self.held), LEAST_MU)
        slides_n = load_n / (2.0 * lower)
        self.mu_hat = lanes.choose(sure, lower, 0.0)
        self.needed_n = lanes.choose(sure, SPARE * slides_n, 0.0)
        self.holds_n = lanes.choose(sure, self.needed_n, slides_n)
        used = slides_n / lanes.most(sense.grip_n, FIRM_N)
        self.margin = lanes.choose(sure & firm, 1.0 - used, 0.0)

    def _take(self, sense: GripSense, ratio: Number) -> None:
        """A sample of friction, where the ratio stands still while a slip is all but certain."""
        lanes, likely = self._lanes, sense.known & (sense.p_risky > SURE_P)
        ratio = lanes.choose(likely, ratio, 0.0)
        low = high = ratio
        for one in self._last:
            low, high = lanes.least(low, one), lanes.most(high, one)
        still = high - low < STEADY * high
        self._slid = lanes.choose(still, lanes.most(self._slid, low), self._slid)
        self._last = [ratio, *self._last[:-1]]

    def _hold(self, sense: GripSense, ratio: Number, firm: Number) -> None:
        """The largest ratio that was held in quiet."""
        lanes = self._lanes
        quiet = firm & (sense.p_risky < QUIET_P) & (sense.p_safe < QUIET_P)
        smooth = self._quiet + self._share * (ratio - self._quiet)
        self._quiet = lanes.choose(quiet, smooth, self._quiet)
        self.held = lanes.choose(quiet, lanes.most(self.held, self._quiet), self.held)

    def _forget(self, sense: GripSense) -> None:
        lanes, gone = self._lanes, sense.empty & sense.known
        self._slid = lanes.choose(gone, 0.0, self._slid)
        self._quiet = lanes.choose(gone, 0.0, self._quiet)
        self.held = lanes.choose(gone, 0.0, self.held)


FORCE_CONTROLLERS = ("pd-shear", "sliding-mode")
"""Controllers whose parameters are in N: they need forces, not raw fields."""
LARGEST = 1e9
"""No sensor reads more, N or uT; a larger number counts as no force."""
CUE_P = AnswerRules.from_p
"""p(risky slip) from which the wearer's vibration cue begins; full at 1."""


def controller_of(
    name: str, lanes: Lanes, rate_hz: float, setting: float | None = None
) -> Controller:
    """A controller by its name; setting: None for its default. Raises UsageError."""
    if name not in CONTROLLERS:
        raise UsageError(
            f"no controller {name!r}", next_step=f"choose from {', '.join(CONTROLLERS)}"
        )
    kind = CONTROLLERS[name]
    return kind(lanes, rate_hz, kind.SETTING if setting is None else setting)


class GripLoop:
    """Friction margin, controller and supervisor of one hand, or of many."""

    def __init__(
        self,
        lanes: Lanes,
        rate_hz: float,
        controller: Controller,
        limits: Limits | None = None,
        shear_gain: float = 1.0,
    ) -> None:
        self.controller = controller
        self.margin = FrictionMargin(lanes, rate_hz, shear_gain)
        self.supervisor = Supervisor(lanes, rate_hz, limits)

    def step(self, sense: GripSense) -> Number:
        """One sample: the target, N a side; 0 for none."""
        self.margin.step(sense)
        margin, given_n = self.margin, self.supervisor.given_n
        wanted_n = self.controller.want(sense, given_n, margin.needed_n)
        return self.supervisor.step(
            sense, wanted_n, self.controller.fresh, margin.holds_n
        )


class GripControl:
    """The grip controller of one hand, beside its monitor: one command a sample.

    name: of CONTROLLERS. setting: the controller's own, None for its default. unit: of the forces.
    In uT or count there is no N: a friction ratio still means something, a grip in N does not, so
    controllers that need N are refused, the ceiling is the hand's own business, and every command
    says `reduced`. Raises UsageError.
    """

    def __init__(
        self,
        name: str,
        rate_hz: float,
        setting: float | None = None,
        unit: Unit = "N",
        n_fingers: int = 6,
        limits: Limits | None = None,
    ) -> None:
        self.reduced, self._n_fingers = unit != "N", n_fingers
        if self.reduced and name in FORCE_CONTROLLERS:
            raise UsageError(
                f"{name} needs forces in N, this model answers in {unit}",
                next_step="calibrate the sensors (holdfast calibrate), or choose holdfast",
            )
        self.limits = limits or Limits()
        controller = controller_of(name, ONE_LANE, rate_hz, setting)
        limits = (
            replace(self.limits, ceiling_n=math.inf) if self.reduced else self.limits
        )
        self._loop = GripLoop(ONE_LANE, rate_hz, controller, limits)

    def step(
        self, prediction: Prediction, forces: FloatArray, valid: BoolArray
    ) -> GripCommand:
        """One sample. forces [C]: prepared, in the model's unit; valid [S]. Raises UsageError."""
        if forces.shape != (3 * self._n_fingers,) or valid.shape != (self._n_fingers,):
            raise UsageError(
                f"{forces.size // 3} fingers, the grip controller was made for {self._n_fingers}",
                next_step="use a model made for this hand",
            )
        target_n = self._loop.step(sense_of(prediction, forces, valid))
        return self._command(prediction, target_n)

    def _command(self, prediction: Prediction, target_n: float) -> GripCommand:
        supervisor, margin = self._loop.supervisor, self._loop.margin
        mode = int(supervisor.mode)
        observed = margin.mu_hat > 0.0
        return GripCommand(
            sequence=prediction.sequence,
            t_ns=prediction.t_acquired_ns,
            mode=MODES[mode],
            target_n=target_n if target_n > 0.0 and not self.reduced else None,
            slew_n_s=self.limits.slew_n_s,
            feedback=_cue(prediction),
            reason=_reason(prediction, mode, self.reduced),
            mu_hat=margin.mu_hat if observed else None,
            margin=margin.margin if observed else None,
            needed_n=margin.needed_n if observed and not self.reduced else None,
        )


def sense_of(prediction: Prediction, forces: FloatArray, valid: BoolArray) -> GripSense:
    """What a controller knows of one sample; no force where a sensor is not valid or not finite."""
    f, grip_n, load_n = forces.tolist(), 0.0, 0.0
    for x, y, z, good in zip(f[::3], f[1::3], f[2::3], valid.tolist(), strict=True):
        if good and abs(x) + abs(y) + abs(z) < LARGEST:
            grip_n += z if z > 0.0 else 0.0
            load_n += math.sqrt(x * x + y * y)
    grip_n *= 0.5
    return GripSense(
        grip_n=grip_n,
        load_n=load_n,
        p_risky=prediction.p_risky,
        p_safe=prediction.p_situation["safe_slip"],
        known=prediction.state != "unknown",
        empty=prediction.state == "nothing",
        opening=prediction.opening,
        overridden=prediction.overridden,
    )


def _cue(prediction: Prediction) -> float:
    """Strength of the wearer's vibration cue, 0 to 1."""
    if prediction.state == "unknown" or prediction.p_risky < CUE_P:
        return 0.0
    return prediction.p_risky


def _reason(prediction: Prediction, mode: int, reduced: bool) -> str:
    if prediction.overridden:
        reason = "override"
    elif prediction.opening:
        reason = "opening"
    elif prediction.state == "unknown":
        reason = f"unknown: {prediction.why}"
    elif mode in (IDLE, YIELD, HOLD):
        reason = prediction.state
    else:
        reason = "risky slip" if prediction.p_risky >= CUE_P else "friction margin"
    return f"{reason} (reduced: no N)" if reduced else reason
