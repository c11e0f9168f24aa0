"""The hand's drive: how far the grip follows its target, and how late.

The drive is a motor behind a gear that cannot be driven back, so the grip stays as it is wherever
the object goes. It grips for the larger of its target and the grip that its wearer asks for, in N a
side, and closes to where that grip would be. While its wearer opens it no target counts:

    speed:   v' = (clip((target - x - lag v) / lag, -v_max, v_max) - v) / lag
    grip:    x' = v,    0 <= x <= ceiling,    and backlash between motor and fingers

x is the grip that the motor's place would give on the object in N a side; x + lag v is where it
would come to rest. A small change is critically damped, a large one is limited by v_max behind the
lag. v_max follows from the hand's own figures and the fingers: stroke over
closing time, times the stiffness of all fingers and the object in series.

Source: Michelangelo hand, 120 mm in 0.37 s and 70 N (thesis, 5.1.1; Front. Syst. Neurosci. 9:162,
2015, table 1). Lag and backlash are assumptions: none is published.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.scenes.protocol import Trials, of_each
from holdfast.simulation.scenes.script import body_of

Opening = Literal["wearer", "larger"]
OPENINGS: dict[Opening, str] = {
    "wearer": "the hand obeys its wearer's opening, whatever the target",
    "larger": "it grips for the larger of both: a hand that cannot tell",
}
"""Who decides when the wearer opens the hand."""
FELT_N_S = 0.5
FELT_N = 0.05
"""Speed and distance of a grip whose change cannot be felt."""
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=1e4)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1e4)]


class Drive(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Figures of a hand's drive; their sources are in the docstring of this module.

    lag_ms       time constant with which the speed follows the target
    ceiling_n    largest grip of either side
    closing_s    time of the whole stroke
    stroke_mm    how far the fingers can open
    backlash_mm  of the fingers' opening, at a change of direction
    """

    # a drive without lag or play is an ideal one; one without force or speed is none
    lag_ms: NotNegative = 50.0
    ceiling_n: Positive = 70.0
    closing_s: Positive = 0.37
    stroke_mm: Positive = 120.0
    backlash_mm: NotNegative = 0.3


class Actuator:
    """B drives, which follow the larger of the target and what the wearer's own control wants.

    From the wearer's opening on the target is ignored, until the wearer has closed the hand again;
    opening, of OPENINGS, says whether the hand can tell.

    own_n     [B] the wearer's: the grip that the place of the hand would give, N a side, if no
              target were given. Negative: so far open that this grip would be missing at contact
    motor_n   [B] the same of the motor
    place_n   [B] the same of the fingers behind the backlash
    """

    def __init__(
        self,
        drive: Drive,
        trials: Trials,
        opening: Opening = "wearer",
    ) -> None:
        self.drive = drive
        self.opening = opening
        # The grip with which the wearer closes the hand.
        self.own_n = of_each(trials, "grip_n")
        per_m = stiffness_n_per_m(trials)

        # Opening speed times stiffness, N/s: the grip that the fastest closing adds in a second.
        self.fastest_n_s = 1e-3 * drive.stroke_mm / drive.closing_s * per_m
        self.backlash_n = 1e-3 * drive.backlash_mm * per_m
        # Where the motor would hold the object, and where the fingers behind the backlash do.
        self.motor_n = self.own_n.copy()
        self.place_n = self.own_n.copy()
        self.speed_n_s = np.zeros(len(trials))

    @property
    def grip_n(self) -> FloatArray:
        """[B] the grip that the fingers' place gives, N a side; an open hand gives none."""
        grip_n: FloatArray = np.maximum(self.place_n, 0.0)
        return grip_n

    @property
    def wearers_n(self) -> FloatArray:
        """[B] the grip that the wearer asks for, N a side; an open hand has none."""
        own_n: FloatArray = np.maximum(self.own_n, 0.0)
        return own_n

    @property
    def kept_n(self) -> FloatArray:
        """[B] the target that keeps the grip as it is; 0 where it is the wearer's own."""
        kept_n: FloatArray = np.where(self.moving(self.own_n), self.motor_n, 0.0)
        return kept_n

    def obeyed_n(self, target_n: FloatArray, opens: BoolArray) -> FloatArray:
        """[B] the targets that count; opens [B]: the wearer opens the hand, or has opened it."""
        if self.opening == "larger":
            return target_n
        return np.where(opens, 0.0, target_n)

    def step(
        self, target_n: FloatArray, dt_s: float, own_n: FloatArray | None = None
    ) -> FloatArray:
        """Follow target_n [B], one that counts, for dt_s, 0 for none; returns place_n [B].

        own_n: the wearer's at the end of the step; None: as it was.
        """
        own_n = self.own_n if own_n is None else own_n
        larger_n = np.maximum(target_n, own_n)
        wanted_n = np.where(target_n > 0.0, larger_n, own_n)
        # The way of a hand that only its wearer moves is given, drive and all: the motor is at the
        # wearer's grip, and not on its way back to it.
        follows = (wanted_n == own_n) & ~self.moving(self.own_n)

        lag_s = 1e-3 * self.drive.lag_ms
        # A drive weaker than its wearer's grip does not open the hand.
        ceiling_n = np.maximum(self.drive.ceiling_n, own_n)
        # x + lag v: where the motor would come to rest
        rest_n = self.motor_n + lag_s * self.speed_n_s
        to_go_n = np.minimum(wanted_n, ceiling_n) - rest_n

        # A lag shorter than the step would overshoot.
        speed = to_go_n / max(lag_s, dt_s)
        speed = np.clip(speed, -self.fastest_n_s, self.fastest_n_s)

        # Explicit Euler in the lag, or at once where the step is longer.
        share = 1.0 if lag_s <= dt_s else dt_s / lag_s
        speed_n_s = self.speed_n_s + share * (speed - self.speed_n_s)
        moved_n = np.clip(self.motor_n + speed_n_s * dt_s, own_n, ceiling_n)
        self.speed_n_s = np.where(follows, 0.0, speed_n_s)
        self.motor_n = np.where(follows, own_n, moved_n)

        # The fingers rest until the motor has taken up the backlash.
        behind_n = np.clip(self.place_n, self.motor_n - self.backlash_n, self.motor_n)
        self.place_n = np.where(follows, own_n, behind_n)
        self.own_n = own_n
        return self.place_n

    def moving(self, target_n: FloatArray) -> BoolArray:
        """[B] whether a target still changes the grip by more than can be felt."""
        far: BoolArray = (
            np.abs(np.maximum(target_n, self.own_n) - self.motor_n) > FELT_N
        )
        fast = np.abs(self.speed_n_s) > FELT_N_S
        return fast | far


def stiffness_n_per_m(trials: Trials) -> FloatArray:
    """[B] N a side per m of opening: thumb, object and fingers in series."""
    # The number of elements of a brush plays no part: only the normal springs are used.
    body = body_of(trials, np.ones(1))
    thumb = body.stiffness_n_per_m[: body.thumb].sum(axis=0)
    fingers = body.stiffness_n_per_m[body.thumb :].sum(axis=0)
    return thumb * fingers / (thumb + fingers)
