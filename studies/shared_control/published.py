"""The published grip controllers that ours is compared with, behind the same supervisor.

    pd-shear       wearer's + kp (T - T0) + kd dT/dt       T: load along the skin, above T0
    sliding-mode   r + k sat((r - N) / phi)            r: wearer's grip; no provision against slip
    smsp           wearer's + one step for every slip event
    ismsp          wearer's + the integral of the slip signal

pd-shear is the scheme of the SensorHand Speed as the thesis describes it (2.4, [46]); sliding-mode,
smsp and ismsp are those of Engeberg and Meek, IEEE/ASME Trans. Mechatronics 18(1), 2013 ([47] of
the thesis). Their slip signal here is the model's: p(risky slip) above SLIP_P in a firm grip, so
that controllers differ in their answers only.
"""

from __future__ import annotations

from typing import Any

from holdfast.edge_runtime.batch import Flag, Number
from holdfast.edge_runtime.grip import CONTROLLERS as SHIPPED
from holdfast.edge_runtime.grip import Controller, GripSense, Want

SLIP_P = 0.5
"""p(risky slip) above which they see a slip."""
HELD_N = 0.5
"""They see one while the fingers press harder than this, N a side."""


class PdShear(Controller):
    """wearer's + kp (T - T0) + kd dT/dt while the load T along the skin exceeds T0; setting: kp.

    T0 = 1 N, a fixed threshold; kd = 5 ms * kp.
    """

    SETTING = 1.0
    THRESHOLD_N = 1.0
    RATE_S = 0.005
    """kd / kp."""

    def __init__(self, *given: Any, **more: Any) -> None:
        super().__init__(*given, **more)
        self._load_n = self._batch.zero()

    def want(
        self, sense: GripSense, given_n: Number, needed_n: Number, holds_n: Number
    ) -> Want:
        """As Controller.want."""
        batch = self._batch
        wearers_n = self._wearer.step(sense, given_n)

        # an unknown sample keeps the last load, so that its end makes no jump in the rate
        load_n = batch.choose(sense.known, sense.load_n, self._load_n)
        rate_n_s = (load_n - self._load_n) * self._rate_hz
        self._load_n = load_n

        above_n = load_n - self.THRESHOLD_N + self.RATE_S * rate_n_s
        fresh = (load_n > self.THRESHOLD_N) & batch.no(sense.empty)
        wanted_n = wearers_n + self._setting * batch.most(above_n, 0.0)

        return Want(batch.choose(fresh, wanted_n, 0.0), fresh, holds_n)


class SlidingMode(Controller):
    """r + k sat((r - N) / phi): keeps the grip N at r, the wearer's grip; setting: k, N.

    r is the wearer's grip half a second after contact. There is no provision against slip.
    """

    SETTING = 2.0
    BOUNDARY_N = 1.0
    SETTLED_S = 0.5

    def __init__(self, *given: Any, **more: Any) -> None:
        super().__init__(*given, **more)
        self._held_s = self._batch.zero()
        self._reference_n = self._batch.zero()

    def want(
        self, sense: GripSense, given_n: Number, needed_n: Number, holds_n: Number
    ) -> Want:
        """As Controller.want."""
        batch = self._batch
        # its reference counts as given: from then on it regulates the grip itself
        wearers_n = self._wearer.step(sense, self._reference_n)
        self._held_s = batch.choose(sense.empty, 0.0, self._held_s + self._period_s)
        fresh = self._held_s >= self.SETTLED_S
        kept_n = batch.choose(self._reference_n > 0.0, self._reference_n, wearers_n)
        self._reference_n = batch.choose(fresh, kept_n, 0.0)

        error = (self._reference_n - sense.grip_n) / self.BOUNDARY_N
        saturated = batch.within(-1.0, error, 1.0)
        pushed_n = self._reference_n + self._setting * saturated

        return Want(batch.choose(fresh, batch.most(pushed_n, 0.0), 0.0), fresh, holds_n)


def _slips(sense: GripSense) -> Flag:
    """The slip signal of the published controllers."""
    return (sense.p_risky > SLIP_P) & (sense.grip_n > HELD_N) & sense.known


class SlipSteps(Controller):
    """wearer's + one step for each slip event; setting: the step, N."""

    SETTING = 8.0

    def __init__(self, *given: Any, **more: Any) -> None:
        super().__init__(*given, **more)
        self._slipped = self._batch.false()

    def want(
        self, sense: GripSense, given_n: Number, needed_n: Number, holds_n: Number
    ) -> Want:
        """As Controller.want."""
        batch = self._batch
        wearers_n = self._wearer.step(sense, given_n)
        slips = _slips(sense)
        # an event is the first sample of a slip
        fresh = slips & batch.no(self._slipped)
        self._slipped = batch.choose(sense.known, slips, self._slipped)
        raised_n = batch.most(given_n, wearers_n) + self._setting
        return Want(batch.choose(fresh, raised_n, given_n), fresh, holds_n)


class SlipIntegral(Controller):
    """wearer's + the integral of the slip signal; setting: N per s of slip."""

    SETTING = 200.0

    def want(
        self, sense: GripSense, given_n: Number, needed_n: Number, holds_n: Number
    ) -> Want:
        """As Controller.want."""
        batch = self._batch
        wearers_n = self._wearer.step(sense, given_n)
        fresh = _slips(sense)
        rise_n = self._setting / self._rate_hz
        raised_n = batch.most(given_n, wearers_n) + rise_n
        return Want(batch.choose(fresh, raised_n, given_n), fresh, holds_n)


CONTROLLERS: dict[str, type[Controller]] = {
    "none": SHIPPED["none"],
    "pd-shear": PdShear,
    "sliding-mode": SlidingMode,
    "smsp": SlipSteps,
    "ismsp": SlipIntegral,
    "holdfast": SHIPPED["holdfast"],
}
"""By the names of the tables."""
