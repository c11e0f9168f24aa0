"""The best that this drive can do: it knows the trial's action, its friction and its load.

From the moment the action begins it closes as fast as the drive can, until the grip holds the
largest load that will come by kinetic friction, with a tenth to spare; in a hand-over it does
nothing. What it cannot keep, no controller can: the drops that it keeps are the preventable ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge_runtime.contract import FloatArray
from edge_runtime.trial_layout import RISKY_ACTIONS
from simulation.protocol import GRAVITY_M_S2, PlannedTrial
from simulation.script import Times

SPARE = 1.1


class Oracle:
    """B hands. want: the grip at times t_s [B], where the drive's grip is grip_n [B]."""

    def __init__(self, trials: Sequence[PlannedTrial], ceiling_n: float) -> None:
        self.ceiling_n = ceiling_n
        risky = np.array([trial.action in RISKY_ACTIONS for trial in trials])
        self.act_s = np.where(risky, [Times.of(trial).act for trial in trials], np.inf)
        self.needed_n = np.array([needed_grip_n(trial) for trial in trials])

    def want(self, t_s: FloatArray, grip_n: FloatArray) -> FloatArray:
        """[B] N a side; 0 for none."""
        close_n = np.where(grip_n < self.needed_n, self.ceiling_n, self.needed_n)
        wanted: FloatArray = np.where(t_s >= self.act_s, close_n, 0.0)
        return wanted


def needed_grip_n(trial: PlannedTrial) -> float:
    """Grip of either side, N, that holds the weight and the largest pull by kinetic friction."""
    weight_n = trial.thing.mass_g * 1e-3 * GRAVITY_M_S2
    load_n = weight_n + (trial.drawn["cap_n"] if trial.action == "pull" else 0.0)
    friction = trial.thing.friction * trial.drawn["friction_factor"] * trial.thing.kinetic_share
    return SPARE * load_n / (2.0 * max(friction, 1e-3))
