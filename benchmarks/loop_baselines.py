"""Baselines of a closed loop: the oracle, and a vibration alone.

They take the place of a grip controller, to show what one closure of the drive or a warned wearer
could do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.trial_layout import VOLUNTARY_ACTIONS
from holdfast.edge_runtime.grip import GripSense
from holdfast.simulation.actions import EMPTY_HANDED, action_named
from holdfast.simulation.effects.effect import stream
from holdfast.simulation.loop.closed_loop import LoopController, LoopTruth, Make
from holdfast.simulation.physics.body import GRAVITY_M_S2
from holdfast.simulation.scenes.protocol import PlannedTrial

SPARE = 1.1
"""Grip over what the largest load needs: a tenth to spare."""
CLOSURES = (SPARE, 1.5, 2.0, 3.0, np.inf)
"""How far oracles close, over what the largest load needs; the last one to the drive's ceiling."""
REACTION_S = 0.28
"""Median of the reaction of a wearer to a vibration, s."""
REACTION_SPREAD = 0.25
"""Standard deviation of the logarithm of that reaction: it is log-normal."""


def may_slip(action: str) -> bool:
    """Whether an object that leaves the hand in this action is a drop that a hand should prevent.

    Not so in a hand-over, and not in a disturbed hold, whose drops are counted apart.
    """
    if action in EMPTY_HANDED or action == "hold":
        return False
    return action not in VOLUNTARY_ACTIONS


class Oracle:
    """What one closure of the drive can do: it knows each trial's action, friction and load.

    From the first sample after load onset it closes as fast as the drive can, until the grip is
    `closure` times what holds the largest load that will come by kinetic friction; in a hand-over
    it does nothing. onset_s [B]: load onset in a hand that does nothing, inf where there is none.

    A further closure holds more, and may also push a curved object out of the hand, so none is the
    best for every event: a drop is preventable where any of CLOSURES keeps the object.
    """

    def __init__(
        self,
        trials: Sequence[PlannedTrial],
        onset_s: FloatArray,
        ceiling_n: float,
        closure: float = SPARE,
    ) -> None:
        self.ceiling_n = ceiling_n
        risky = np.array([may_slip(trial.action) for trial in trials])
        self.act_s = np.where(risky, onset_s, np.inf)
        self.needed_n = np.array([needed_grip_n(trial, closure) for trial in trials])
        self.mu_hat = np.full(len(trials), np.nan)

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] N a side; 0 for none."""
        # A target at the ceiling moves the drive at its full speed.
        too_weak = now.grip_n < self.needed_n
        close_n = np.where(too_weak, self.ceiling_n, self.needed_n)
        return np.where(now.t_s >= self.act_s, close_n, 0.0)


def needed_grip_n(trial: PlannedTrial, spare: float = SPARE) -> float:
    """Grip of either side, N: `spare` times what holds the largest load by kinetic friction."""
    weight_n = trial.object.mass_g * 1e-3 * GRAVITY_M_S2
    load_n = action_named(trial.action).load_n(trial, weight_n)

    # Coulomb: both sides hold, each with friction times its normal force
    # The bound keeps the grip finite for an object without friction.
    friction = max(trial.kinetic_friction, 1e-3)
    return spare * load_n / (2.0 * friction)


class Vibration:
    """The hand only vibrates; a wearer who did not mean it closes the hand after a while.

    The wearer knows whether it was meant, and closes to what the load needs. Reaction times are
    log-normal about 0.28 s (vibrotactile: a simple reaction of 0.2 to 0.35 s). cue_p: p(risky slip)
    from which the hand vibrates.
    """

    def __init__(self, trials: Sequence[PlannedTrial], seed: int, cue_p: float) -> None:
        self.cue_p = cue_p
        # Every trial has a stream of its own, so a reaction does not depend on the batch.
        spreads = []
        for trial in trials:
            rng = stream(seed, trial.number, "reaction")
            spreads.append(np.exp(REACTION_SPREAD * rng.normal()))
        self.reaction_s = REACTION_S * np.array(spreads)
        self.meant = np.array([not may_slip(trial.action) for trial in trials])
        self.needed_n = np.array([needed_grip_n(trial) for trial in trials])
        self.felt_s = np.full(len(trials), np.inf)
        self.mu_hat = np.full(len(trials), np.nan)

    def step(self, sense: GripSense, now: LoopTruth) -> FloatArray:
        """[B] N a side; 0 for none."""
        cue = sense.known & (sense.p_risky >= self.cue_p) & ~self.meant

        # Only the first vibration starts a reaction.
        first_s = np.minimum(self.felt_s, now.t_s)
        self.felt_s = np.where(cue, first_s, self.felt_s)
        acts = now.t_s >= self.felt_s + self.reaction_s
        return np.where(acts, self.needed_n, 0.0)


def oracle(
    onset_s: dict[int, float],
    ceiling_n: float,
    closure: float = SPARE,
    knows_after_s: float = 0.0,
) -> Make:
    """A maker of the oracle; onset_s: trial number -> load onset in a hand that does nothing.

    knows_after_s: by so much later it knows.
    """

    def make(trials: Sequence[PlannedTrial], rate_hz: float) -> LoopController:
        onsets_s = np.array([onset_s[trial.number] for trial in trials])
        return Oracle(trials, onsets_s + knows_after_s, ceiling_n, closure)

    return make


def vibration(seed: int, cue_p: float) -> Make:
    """A maker of the vibration alone."""
    return lambda trials, rate_hz: Vibration(trials, seed, cue_p)
