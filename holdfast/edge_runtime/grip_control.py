"""One grip command for each prediction: friction margin, controller and supervisor joined.

Friction, as far as a slip has shown it: what the fingers hold, and what they need. While the object
slides the fingers bear no more than friction allows, so the ratio of the force along the skin to
the normal force stands still at the friction coefficient (Coulomb), whatever the load is. It is
never larger, so the largest ratio that has stood still is the best one:

    ratio        r = T / 2N
    mu_hat       the largest r that stood still for SAMPLES, while a slip was all but certain
    needed_n     spare T / (2 mu_hat)             N: normal force of either side
    margin       1 - T / (2 mu_hat N)             0: about to slide
    holds_n      needed_n; before a slip has shown friction, T / (2 held)

Nothing is known before the first slip: then mu_hat is 0 here and null in messages, never a guess.
The largest ratio that the hand has held in quiet (`held`) bounds friction from below, so a grip of
holds_n is known to hold the load. Less is a guess.

r is of all fingers' sums, because one finger's ratio is mostly noise at 0.3 N. T is what is read
over the sensors' shear gain (read over true), so mu_hat is that of the object, and N is as read.
"""

from __future__ import annotations

import math
from dataclasses import replace

from holdfast.core.contract import BoolArray, FloatArray, Prediction, Unit
from holdfast.core.errors import UsageError
from holdfast.edge_runtime.batch import ONE_HAND, Batch, Flag, Number
from holdfast.edge_runtime.grip import (
    CONTROLLERS,
    LARGEST,
    AnswerRules,
    Controller,
    GripSense,
    clamped,
)
from holdfast.edge_runtime.supervisor import (
    HOLD,
    IDLE,
    MODES,
    YIELD,
    GripCommand,
    Limits,
    Supervisor,
)

FIRM_N = 0.3
"""A ratio counts from this grip on, N a side."""
SAMPLES = 6
"""A caught object's load and grip may grow together for less than this: that is no slide."""
STEADY = 0.1
"""Ratios whose spread over the largest is below this stand still."""
SURE_P = 0.9
"""p(risky slip) from which a slip is all but certain."""
QUIET_P = 0.2
"""p(any slip) below which the hand holds in quiet."""
SPARE = 1.25
"""Grip over the least grip that friction needs."""
LEAST_MU = 0.05
"""A floor, so that the grip that is asked for stays bounded."""
QUIET_S = 0.1
"""Time constant of the low-pass over the ratio in a quiet hold."""


class FrictionMargin:
    """Friction of the object in the hand; forgets it when the hand is empty.

    shear_gain: ratio of shear and normal force as read, over the true one; from the calibration.
    """

    def __init__(self, batch: Batch, rate_hz: float, shear_gain: float = 1.0) -> None:
        self._batch = batch
        self._gain = shear_gain
        self._share = 1.0 / (1.0 + QUIET_S * rate_hz)
        self._last = [batch.zero()] * (SAMPLES - 1)
        self._slid = batch.zero()
        self._quiet = batch.zero()
        self.held = batch.zero()
        self.mu_hat = batch.zero()
        self.needed_n = batch.zero()
        self.holds_n = batch.zero()
        self.margin = batch.zero()

    def step(self, sense: GripSense) -> None:
        batch = self._batch
        load_n = sense.load_n / self._gain

        # below FIRM_N the ratio of two noisy numbers means nothing
        firm = (sense.grip_n > FIRM_N) & sense.known
        both_sides_n = 2.0 * batch.most(sense.grip_n, FIRM_N)
        ratio = batch.choose(firm, load_n / both_sides_n, 0.0)

        self._take_slide(sense, ratio)
        self._take_quiet(sense, ratio, firm)
        self._forget(sense)

        sure = self._slid > 0.0
        # what the hand has held without a slip bounds friction from below
        lower = batch.most(batch.most(self._slid, self.held), LEAST_MU)
        slides_n = load_n / (2.0 * lower)
        self.mu_hat = batch.choose(sure, lower, 0.0)
        self.needed_n = batch.choose(sure, SPARE * slides_n, 0.0)
        self.holds_n = batch.choose(sure, self.needed_n, slides_n)

        used = slides_n / batch.most(sense.grip_n, FIRM_N)
        self.margin = batch.choose(sure & firm, 1.0 - used, 0.0)

    def _take_slide(self, sense: GripSense, ratio: Number) -> None:
        """A sample of friction, where the ratio stands still while a slip is all but certain."""
        batch = self._batch
        likely = sense.known & (sense.p_risky > SURE_P)

        # a 0 in the row keeps it from standing still
        row = [batch.choose(likely, ratio, 0.0), *self._last]
        low, high = batch.span(row)

        # While the object slides the ratio is the friction coefficient, whatever the load is
        # (Coulomb).
        still = high - low < STEADY * high
        # the least of the row, so that noise does not raise the estimate
        slid = batch.most(self._slid, low)
        self._slid = batch.choose(still, slid, self._slid)
        self._last = row[:-1]

    def _take_quiet(self, sense: GripSense, ratio: Number, firm: Flag) -> None:
        """The largest ratio that was held in quiet."""
        batch = self._batch
        no_slip = (sense.p_risky < QUIET_P) & (sense.p_safe < QUIET_P)
        quiet = firm & no_slip
        # smoothed, or one noisy sample would claim a friction that is not there
        smooth = self._quiet + self._share * (ratio - self._quiet)
        self._quiet = batch.choose(quiet, smooth, self._quiet)
        held = batch.most(self.held, self._quiet)
        self.held = batch.choose(quiet, held, self.held)

    def _forget(self, sense: GripSense) -> None:
        """The next object has another friction."""
        batch = self._batch
        gone = sense.empty & sense.known
        self._slid = batch.choose(gone, 0.0, self._slid)
        self._quiet = batch.choose(gone, 0.0, self._quiet)
        self.held = batch.choose(gone, 0.0, self.held)


class GripLoop:
    """Friction margin, controller and supervisor of one hand, or of many."""

    def __init__(
        self,
        batch: Batch,
        rate_hz: float,
        controller: Controller,
        limits: Limits | None = None,
    ) -> None:
        self._batch = batch
        self.controller = controller
        # without a measured gain the margin takes the larger load: the grip may be too firm
        self.margin = FrictionMargin(batch, rate_hz, controller.shear_gain or 1.0)
        self.supervisor = Supervisor(batch, rate_hz, limits)

    def step(self, sense: GripSense) -> Number:
        """One sample, whatever it says: the target, N a side; 0 for none, up to the ceiling."""
        sense = clamped(self._batch, sense)
        self.margin.step(sense)
        # what was given, not what was wanted: a controller must not wind up
        margin = self.margin
        given_n = self.supervisor.given_n
        want = self.controller.want(sense, given_n, margin.needed_n, margin.holds_n)
        return self.supervisor.step(sense, want)


class GripControl:
    """The grip controller of one hand, next to its monitor: one command a sample.

    name: of CONTROLLERS. setting: the controller's own, None for its default. unit: of the forces.
    In uT or count there is no N: a friction ratio still means something, a grip in N does not. So
    the ceiling is left to the hand, and every command says `reduced`. shear_gain: read over true,
    of the calibration. thumb: which fingers press from the thumb's side; None where half of all
    fingers' sum is the grip of a side. rules: those that come with the model (AnswerRules.of).
    Raises UsageError.
    """

    def __init__(
        self,
        name: str,
        rate_hz: float,
        setting: float | None = None,
        unit: Unit = "N",
        n_fingers: int = 6,
        limits: Limits | None = None,
        shear_gain: float | None = None,
        thumb: tuple[bool, ...] | None = None,
        rules: AnswerRules | None = None,
    ) -> None:
        self.rules = rules or AnswerRules()
        self.reduced = unit != "N"
        self._n_fingers = n_fingers
        self._thumb = thumb
        if name not in CONTROLLERS:
            raise UsageError(
                f"no controller {name!r}",
                next_step=f"choose from {', '.join(CONTROLLERS)}",
            )

        self.limits = limits or Limits()
        within = self.limits
        if self.reduced:
            # a ceiling in N says nothing about numbers in another unit
            within = replace(within, ceiling_n=math.inf)
            self.rules = self.rules.without_newtons()
        kind = CONTROLLERS[name]
        controller = kind(ONE_HAND, rate_hz, setting, self.rules, shear_gain)
        self._loop = GripLoop(ONE_HAND, rate_hz, controller, within)

    def step(
        self, prediction: Prediction, forces: FloatArray, valid: BoolArray
    ) -> GripCommand:
        """One sample. forces [C]: prepared, in the model's unit; valid [S]. Raises UsageError."""
        fingers = self._n_fingers
        if forces.shape != (3 * fingers,) or valid.shape != (fingers,):
            raise UsageError(
                f"{forces.size // 3} sensors, the grip controller was made for {fingers}",
                next_step="use a model made for this hand",
            )

        sense = sense_of(prediction, forces, valid, self._thumb)
        target_n = self._loop.step(sense)
        return self._command(prediction, target_n)

    def _command(self, prediction: Prediction, target_n: float) -> GripCommand:
        """The message for one target. What is not known is None, never a guess."""
        supervisor = self._loop.supervisor
        margin = self._loop.margin
        mode = int(supervisor.mode)
        given = target_n > 0.0 and not self.reduced

        # before the first slip nothing is known of the friction
        observed = margin.mu_hat > 0.0
        return GripCommand(
            sequence=prediction.sequence,
            t_ns=prediction.t_acquired_ns,
            mode=MODES[mode],
            target_n=target_n if given else None,
            slew_n_s=self.limits.slew_n_s,
            feedback=_cue(prediction, self.rules.from_p),
            reason=_reason(prediction, mode, self.rules.from_p, self.reduced),
            mu_hat=margin.mu_hat if observed else None,
            margin=margin.margin if observed else None,
            needed_n=margin.needed_n if observed and not self.reduced else None,
        )


def sense_of(
    prediction: Prediction,
    forces: FloatArray,
    valid: BoolArray,
    thumb: tuple[bool, ...] | None = None,
) -> GripSense:
    """What a controller knows of one sample of one hand. forces [C], valid [S]; thumb: forces_of.

    While the answer is degraded no slip is called safe.
    """
    # Python's own floats: numpy on six numbers is several times slower
    grip_n, load_n = forces_of(ONE_HAND, forces.tolist(), valid.tolist(), thumb)
    return GripSense(
        grip_n=grip_n,
        load_n=load_n,
        p_risky=prediction.p_risky,
        # a lost finger must not calm
        p_safe=0.0 if prediction.degraded else prediction.p_situation["safe_slip"],
        known=prediction.state != "unknown",
        empty=prediction.state == "nothing",
        opening=prediction.opening,
        overridden=prediction.overridden,
    )


def forces_of(
    batch: Batch,
    axes: list[Number],
    valid: list[Flag],
    thumb: tuple[bool, ...] | None = None,
) -> tuple[Number, Number]:
    """(grip of either side, all fingers' force along the skin) of one sample, as they are read.

    axes: x, y, z of each finger in turn. valid: of each finger; one that is not, or not finite, has
    no force. thumb: which fingers press from the thumb's side. Then the others of its side stand in
    for a finger that is not valid, and a side without any has the force of the other one, its
    reaction.
    """
    grip_n, load_n = batch.zero(), batch.zero()
    weights = _weights(batch, thumb, valid)
    for x, y, z, flag, weight in zip(
        axes[::3], axes[1::3], axes[2::3], valid, weights, strict=True
    ):
        # a larger number counts as no force, and NaN is not below LARGEST
        good = flag & (abs(x) + abs(y) + abs(z) < LARGEST)
        # a finger can press, not pull: less than 0 is noise
        grip_n = grip_n + batch.choose(good & (z > 0.0), weight * z, 0.0)
        skin_n = batch.root(x * x + y * y)
        load_n = load_n + batch.choose(good, weight * skin_n, 0.0)

    # the fingers press from two sides, each with half of the sum
    return 0.5 * grip_n, load_n


def _weights(
    batch: Batch, thumb: tuple[bool, ...] | None, valid: list[Flag]
) -> list[Number]:
    """What each finger counts, so that both sides together bear what the whole hand bears."""
    if thumb is None or (len(set(thumb)) == 2 and batch.every(valid)):
        return [1.0] * len(valid)

    read: dict[bool, Number] = dict.fromkeys(thumb, batch.zero())
    for side, good in zip(thumb, valid, strict=True):
        read[side] = read[side] + batch.choose(good, 1.0, 0.0)
    sides_read = batch.zero()
    for count in read.values():
        sides_read = sides_read + batch.choose(count > 0.0, 1.0, 0.0)

    sides = 2.0 / batch.most(sides_read, 1.0)
    return [sides * thumb.count(side) / batch.most(read[side], 1.0) for side in thumb]


def _cue(prediction: Prediction, from_p: float) -> float:
    """Strength of the wearer's vibration cue: 0 below from_p, and p(risky slip) above."""
    p_risky: float = ONE_HAND.within(0.0, prediction.p_risky, 1.0)
    if prediction.state == "unknown" or p_risky < from_p:
        return 0.0
    return p_risky


def _reason(prediction: Prediction, mode: int, from_p: float, reduced: bool) -> str:
    """Why the hand does what it does, for people."""
    if prediction.overridden:
        reason = "override"
    elif prediction.opening:
        reason = "opening"
    elif prediction.state == "unknown":
        reason = f"unknown: {prediction.why}"
    elif mode in (IDLE, YIELD, HOLD):
        reason = prediction.state
    else:
        reason = "risky slip" if prediction.p_risky >= from_p else "friction margin"
    return f"{reason} (reduced: no N)" if reduced else reason
