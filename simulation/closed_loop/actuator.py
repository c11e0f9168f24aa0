"""The hand's drive: how far the grip follows its target, and how late.

The drive is a motor behind a gear that cannot be driven back, so the grip stays as it is wherever
the object goes. Its target is a grip in N a side; it closes to where that grip would be:

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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.edge_runtime.contract import FloatArray
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.script import body_of


@dataclass(frozen=True)
class Drive:
    """Figures of a hand's drive. backlash_mm: of the fingers' opening, at a change of direction."""

    lag_ms: float = 50.0
    ceiling_n: float = 70.0
    closing_s: float = 0.37
    stroke_mm: float = 120.0
    backlash_mm: float = 0.3


class Actuator:
    """B drives. grip_n [B]: the grip that the fingers' place gives, in N a side."""

    def __init__(self, drive: Drive, trials: Sequence[PlannedTrial]) -> None:
        self.drive = drive
        self.own_n = np.array([trial.grip_n for trial in trials])
        per_m = stiffness_n_per_m(trials)
        self.fastest_n_s = 1e-3 * drive.stroke_mm / drive.closing_s * per_m
        self.backlash_n = 1e-3 * drive.backlash_mm * per_m
        self.motor_n, self.grip_n = self.own_n.copy(), self.own_n.copy()
        self.speed_n_s = np.zeros(len(trials))

    def step(self, target_n: FloatArray, dt_s: float) -> FloatArray:
        """Follow target_n [B] for dt_s; returns the grip [B]."""
        lag_s = 1e-3 * self.drive.lag_ms
        rest_n = self.motor_n + lag_s * self.speed_n_s
        wanted = (np.minimum(target_n, self.drive.ceiling_n) - rest_n) / max(lag_s, dt_s)
        wanted = np.clip(wanted, -self.fastest_n_s, self.fastest_n_s)
        share = 1.0 if lag_s <= dt_s else dt_s / lag_s
        self.speed_n_s = self.speed_n_s + share * (wanted - self.speed_n_s)
        self.motor_n = np.clip(self.motor_n + self.speed_n_s * dt_s, 0.0, self.drive.ceiling_n)
        self.grip_n = np.clip(self.grip_n, self.motor_n - self.backlash_n, self.motor_n)
        return self.grip_n

    def moving(self, target_n: FloatArray) -> FloatArray:
        """[B] whether the grip still changes by more than can be felt."""
        return (np.abs(self.speed_n_s) > 0.5) | (np.abs(target_n - self.motor_n) > 0.05)


def stiffness_n_per_m(trials: Sequence[PlannedTrial]) -> FloatArray:
    """[B] N a side per m of opening: thumb, object and fingers in series."""
    body = body_of(trials, np.ones(1))
    thumb = body.stiffness_n_per_m[: body.thumb].sum(axis=0)
    fingers = body.stiffness_n_per_m[body.thumb :].sum(axis=0)
    series: FloatArray = thumb * fingers / (thumb + fingers)
    return series
