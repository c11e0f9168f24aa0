"""Roughness of the object: friction changes with the place, so that slipping vibrates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.edge_runtime.contract import FloatArray
from holdfast.simulation.effect import Drawn, Effect
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.values import Parameter

MOST_ELEMENTS = 50


class Texture:
    """Friction limit of an element times 1 + depth sin(2 pi s / wavelength + phase), s its slip.

    At a slip speed v the force swings with v / wavelength, Hz: the vibration by which skin and slip
    sensors detect slip (Johansson & Flanagan, Nat. Rev. Neurosci. 10, 2009). Each element has a
    random phase. The effect needs fine steps.
    """

    def __init__(
        self,
        drawn: Sequence[Drawn],
        trials: Sequence[PlannedTrial],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        self.depth = np.array([d["depth"] for d in drawn])
        self.per_m = 2e3 * np.pi / np.array([d["wavelength_mm"] for d in drawn])
        shape = MOST_ELEMENTS, len(trials[0].finger_n_per_m)
        self.phase = np.stack([rng.uniform(0.0, 2.0 * np.pi, shape) for rng in rngs], axis=2)
        self.slipped_m: FloatArray | None = None

    def scale(self, slipped_m: FloatArray) -> FloatArray:
        """[E, S, B] factor of the friction limit; slipped_m [E, S, B]: slip in the last step."""
        self.slipped_m = slipped_m if self.slipped_m is None else self.slipped_m + slipped_m
        place = self.per_m * self.slipped_m + self.phase[: len(slipped_m)]
        factor: FloatArray = 1.0 + self.depth * np.sin(place)
        return factor

    def busy_s(self, lane: int) -> list[tuple[float, float]]:
        """No interval of its own."""
        return []


TEXTURE = Effect(
    "texture",
    "physics",
    make=Texture,
    parameters={
        "wavelength_mm": Parameter(
            {"uniform": [0.6, 2.0]}, "mm", 0.05, 50, "spatial period of the roughness"
        ),
        "depth": Parameter({"uniform": [0.1, 0.3]}, "", 0, 0.9, "how much friction swings"),
    },
    longest_step_s=1e-3,
)
