"""The grip force of a hand is never quite steady."""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effect import Effect, EffectBatch, Parameter, PhysicsEffect

RIPPLES = 3
"""Sines of an unsteady grip."""


class Fluctuation(PhysicsEffect):
    """The grip force is never quite steady: it swings slowly by a share of itself.

    closure = steady closure (1 + share sqrt(2 / n) sum of n sines); the normal springs are linear,
    so `share` is the standard deviation of the force over its mean. 2 to 4 % in people who hold a
    force: Jones, Hamilton & Wolpert, J. Neurophysiol. 88, 2002.

    rate   [RIPPLES, B] angular frequencies, rad/s
    phase  [RIPPLES, B] rad
    size   [B] amplitude of each sine
    """

    kind = "grips"

    def __init__(self, batch: EffectBatch) -> None:
        low_hz = batch.values("from_hz")
        wide_hz = batch.values("to_hz") - low_hz
        # The order of these draws is part of the format of simulated sets.
        places = np.stack([rng.uniform(size=RIPPLES) for rng in batch.rngs], axis=1)
        turns = np.stack([rng.uniform(size=RIPPLES) for rng in batch.rngs], axis=1)
        self.rate = 2.0 * np.pi * (low_hz + wide_hz * places)
        self.phase = 2.0 * np.pi * turns
        self.size = batch.values("share") * np.sqrt(2.0 / RIPPLES)

    def closure_m(self, closure_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """[S, B] closure of unsteady fingers; open ones stay where they are."""
        waves = np.sin(self.rate * t_s + self.phase)
        swing = 1.0 + self.size * waves.sum(axis=0)
        return np.where(closure_m > 0.0, closure_m * swing, closure_m)


FLUCTUATION = {
    "share": Parameter(0.03, "", 0, 0.3, "standard deviation over the grip"),
    "from_hz": Parameter(0.5, "Hz", 0.01, 30, "lowest frequency"),
    "to_hz": Parameter(3.0, "Hz", 0.01, 30, "highest frequency"),
}
"""Parameters of the effect `fluctuation`."""
EFFECTS = {
    "fluctuation": Effect("fluctuation", "physics", Fluctuation, FLUCTUATION),
}
