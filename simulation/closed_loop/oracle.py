"""The best that this drive can do: it knows the trial's action, its friction and its load.

From the first sample after load onset it closes as fast as the drive can, until the grip holds the
largest load that will come by kinetic friction, with a tenth to spare; in a hand-over it does
nothing. What it cannot keep, no controller can: the drops that it keeps are the preventable ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.edge_runtime.contract import FloatArray
from holdfast.edge_runtime.grip import GripSense
from holdfast.edge_runtime.trial_layout import RISKY_ACTIONS
from holdfast.simulation.closed_loop.loop import LoopTruth
from holdfast.simulation.protocol import GRAVITY_M_S2, PlannedTrial

SPARE = 1.1


class Oracle:
    """B hands. onset_s [B]: load onset in a hand that does nothing, inf where there is none."""

    def __init__(
        self, trials: Sequence[PlannedTrial], onset_s: FloatArray, ceiling_n: float
    ) -> None:
        self.ceiling_n = ceiling_n
        risky = np.array([trial.action in RISKY_ACTIONS for trial in trials])
        self.act_s = np.where(risky, onset_s, np.inf)
        self.needed_n = np.array([needed_grip_n(trial) for trial in trials])
        self.mu_hat = np.full(len(trials), np.nan)

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] N a side; 0 for none."""
        close_n = np.where(now.grip_n < self.needed_n, self.ceiling_n, self.needed_n)
        wanted: FloatArray = np.where(now.t_s >= self.act_s, close_n, 0.0)
        return wanted


def needed_grip_n(trial: PlannedTrial) -> float:
    """Grip of either side, N, that holds the weight and the largest pull by kinetic friction."""
    weight_n = trial.thing.mass_g * 1e-3 * GRAVITY_M_S2
    load_n = weight_n + (trial.drawn["cap_n"] if trial.action == "pull" else 0.0)
    return SPARE * load_n / (2.0 * max(trial.kinetic_friction, 1e-3))
