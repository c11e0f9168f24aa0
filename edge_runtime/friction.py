"""Friction, as far as a slip has shown it: what the fingers hold, and what they need.

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

from typing import TYPE_CHECKING

from holdfast.edge_runtime.lanes import Lanes, Number

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
        self.needed_n, self.holds_n, self.margin = lanes.zero(), lanes.zero(), lanes.zero()

    def step(self, sense: GripSense) -> None:
        """Take in one sample."""
        lanes = self._lanes
        load_n = self._gain * sense.load_n
        firm = (sense.grip_n > FIRM_N) & sense.known
        ratio = lanes.choose(firm, load_n / (2.0 * lanes.most(sense.grip_n, FIRM_N)), 0.0)
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
