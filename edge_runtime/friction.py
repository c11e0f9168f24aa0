"""Friction, as far as a slip has shown it: what the fingers hold, and what they need.

While the object slides the fingers bear no more than friction allows, so the ratio of the force
along the skin to the normal force stands still at the friction coefficient (Coulomb), whatever the
load is:

    sample       r = T / 2N    while a slip is likely and r stands still (STEADY)
    mu_hat       mean of the samples minus their standard deviation: what can be relied on
    needed_n     spare T / (2 mu_hat)             N: normal force of either side
    margin       1 - T / (2 mu_hat N)             0: about to slide

Nothing is known before the first slip: then mu_hat is 0 here and null in messages, never a guess.
A ratio that the hand has held in quiet (`held`) bounds friction from below.

r is of all fingers' sums, because one finger's ratio is mostly noise at 0.3 N. It is in the
sensors' own units. shear_gain: by how much they read too little along the skin, from their
calibration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from edge_runtime.lanes import Lanes, Number

if TYPE_CHECKING:
    from edge_runtime.grip import GripSense

FIRM_N = 0.3
"""A ratio counts from this grip on, N a side."""
STEADY = 0.08
"""Largest change of the ratio from one sample to the next, over the ratio, while it slides."""
SURE_P = 0.5
"""p(risky slip) from which a slip is likely."""
QUIET_P = 0.2
SAMPLES = 4
"""So many samples make an estimate."""
REMEMBERED = 20.0
"""The estimate follows the last samples, about so many."""
SPARE = 1.25
"""Grip over the least grip that friction needs."""
LEAST_MU = 0.05
QUIET_S = 0.1


class FrictionMargin:
    """Friction of the object in the hand; forgets it when the hand is empty."""

    def __init__(self, lanes: Lanes, rate_hz: float, shear_gain: float = 1.0) -> None:
        self._lanes, self._gain = lanes, shear_gain
        self._share = 1.0 / (1.0 + QUIET_S * rate_hz)
        self._count, self._mean, self._variance = lanes.zero(), lanes.zero(), lanes.zero()
        self._ratio, self._quiet = lanes.zero(), lanes.zero()
        self.held, self.mu_hat = lanes.zero(), lanes.zero()
        self.needed_n, self.margin = lanes.zero(), lanes.zero()

    def step(self, sense: GripSense) -> None:
        """Take in one sample."""
        lanes = self._lanes
        load_n = self._gain * sense.load_n
        firm = (sense.grip_n > FIRM_N) & sense.known
        ratio = lanes.choose(firm, load_n / (2.0 * lanes.most(sense.grip_n, FIRM_N)), 0.0)
        self._take(sense, ratio, firm)
        self._hold(sense, ratio, firm)
        self._ratio = ratio
        self._forget(sense)
        self._conclude(sense, load_n, firm)

    def _conclude(self, sense: GripSense, load_n: Number, firm: Number) -> None:
        """mu_hat, margin and the needed grip after this sample."""
        lanes = self._lanes
        sure = self._count >= SAMPLES
        lower = lanes.most(self._mean - lanes.root(self._variance), LEAST_MU)
        lower = lanes.most(lower, self.held)
        slides_n = load_n / (2.0 * lower)
        self.mu_hat = lanes.choose(sure, lower, 0.0)
        self.needed_n = lanes.choose(sure, SPARE * slides_n, 0.0)
        used = slides_n / lanes.most(sense.grip_n, FIRM_N)
        self.margin = lanes.choose(sure & firm, 1.0 - used, 0.0)

    def _take(self, sense: GripSense, ratio: Number, firm: Number) -> None:
        """A sample of friction, where there is one."""
        lanes = self._lanes
        change = ratio - self._ratio
        steady = (change < STEADY * ratio) & (change > -STEADY * ratio)
        slides = firm & steady & (sense.p_risky > SURE_P)
        count = self._count + 1.0
        share = 1.0 / lanes.choose(count < REMEMBERED, count, REMEMBERED)
        off = ratio - self._mean
        mean = self._mean + share * off
        variance = (1.0 - share) * (self._variance + share * off * off)
        self._count = lanes.choose(slides, count, self._count)
        self._mean = lanes.choose(slides, mean, self._mean)
        self._variance = lanes.choose(slides, variance, self._variance)

    def _hold(self, sense: GripSense, ratio: Number, firm: Number) -> None:
        """The largest ratio that was held in quiet."""
        lanes = self._lanes
        quiet = firm & (sense.p_risky < QUIET_P) & (sense.p_safe < QUIET_P)
        smooth = self._quiet + self._share * (ratio - self._quiet)
        self._quiet = lanes.choose(quiet, smooth, self._quiet)
        self.held = lanes.choose(quiet, lanes.most(self.held, self._quiet), self.held)

    def _forget(self, sense: GripSense) -> None:
        lanes, gone = self._lanes, sense.empty & sense.known
        self._count = lanes.choose(gone, 0.0, self._count)
        self._quiet = lanes.choose(gone, 0.0, self._quiet)
        self.held = lanes.choose(gone, 0.0, self.held)
