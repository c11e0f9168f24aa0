"""Who decides in a closed loop: a grip controller by its name, the oracle, or a vibration alone.

The best that this drive can do: it knows the trial's action, its friction and its load.

From the first sample after load onset it closes as fast as the drive can, until the grip holds the
largest load that will come by kinetic friction, with a tenth to spare; in a hand-over it does
nothing. What it cannot keep, no controller can: the drops that it keeps are the preventable ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.trial_layout import RISKY_ACTIONS
from holdfast.edge_runtime.batch import Batch, ManyHands
from holdfast.edge_runtime.grip import AnswerRules, GripSense, Holdfast
from holdfast.edge_runtime.grip_control import CUE_P, GripLoop, controller_of
from holdfast.edge_runtime.supervisor import Limits
from holdfast.simulation.closed_loop.loop import LoopController, LoopTruth, Make
from holdfast.simulation.effect import stream
from holdfast.simulation.protocol import GRAVITY_M_S2, PlannedTrial
from holdfast.simulation.scene import Scene
from holdfast.simulation.sensor.magnet import shear_gain

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


REACTION_S, REACTION_SPREAD = 0.28, 0.25
"""A wearer's reaction to a vibration: log-normal, its median in s and the deviation of its log."""


class Managed:
    """A grip controller behind margin and supervisor, for B hands."""

    def __init__(self, grip: GripLoop, lanes: int) -> None:
        self.grip, self.mu_hat = grip, np.full(lanes, np.nan)

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] target, N a side; 0 for none."""
        target_n: FloatArray = self.grip.step(sense)
        observed = self.grip.margin.mu_hat
        self.mu_hat = np.where(observed > 0.0, observed, self.mu_hat)
        return target_n


def managed(
    scene: Scene,
    name: str,
    setting: float | None = None,
    rules: AnswerRules | None = None,
    limits: Limits | None = None,
) -> Callable[[Sequence[PlannedTrial], float], Managed]:
    """A maker of the named controller; rules: of holdfast, for a study of its parts."""
    gain = shear_gain() if "dipole" in scene.card.effects else 1.0

    def make(trials: Sequence[PlannedTrial], rate_hz: float) -> Managed:
        batch: Batch = ManyHands(len(trials))
        controller = controller_of(name, batch, rate_hz, setting)
        if rules is not None:
            controller = Holdfast(batch, rate_hz, setting or Holdfast.SETTING, rules)
        grip = GripLoop(batch, rate_hz, controller, limits, gain)
        return Managed(grip, len(trials))

    return make


def oracle(onset_s: dict[int, float], ceiling_n: float) -> Make:
    """A maker of the oracle; onset_s: trial number -> load onset in a hand that does nothing."""

    def make(trials: Sequence[PlannedTrial], rate_hz: float) -> LoopController:
        onsets = np.array([onset_s[trial.number] for trial in trials])
        return Oracle(trials, onsets, ceiling_n)

    return make


class Vibration:
    """The hand only vibrates; a wearer who did not mean it closes the hand after a while.

    The wearer knows whether it was meant, and closes to what the load needs. Reaction times are
    log-normal about 0.28 s (vibrotactile: a simple reaction of 0.2 to 0.35 s).
    """

    def __init__(self, trials: Sequence[PlannedTrial], seed: int) -> None:
        rngs = [stream(seed, trial.number, "reaction") for trial in trials]
        self.reaction_s = np.array(
            [REACTION_S * np.exp(REACTION_SPREAD * rng.normal()) for rng in rngs]
        )
        self.meant = np.array([trial.action not in RISKY_ACTIONS for trial in trials])
        self.needed_n = np.array([needed_grip_n(trial) for trial in trials])
        self.felt_s = np.full(len(trials), np.inf)
        self.mu_hat = np.full(len(trials), np.nan)

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] N a side; 0 for none."""
        cue = sense.known & (sense.p_risky >= CUE_P) & ~self.meant
        self.felt_s = np.where(cue, np.minimum(self.felt_s, now.t_s), self.felt_s)
        acts = now.t_s >= self.felt_s + self.reaction_s
        wanted: FloatArray = np.where(acts, self.needed_n, 0.0)
        return wanted


def vibration(seed: int) -> Make:
    """A maker of the vibration alone."""
    return lambda trials, rate_hz: Vibration(trials, seed)
