"""Contacts in more detail: a brush of several elements, silicone with memory, a rough object."""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.effect import Effect, EffectBatch, Parameter, PhysicsEffect

MOST_ELEMENTS = 50
"""Largest number of elements of a brush that a scene may ask for."""


def pressure(count: float) -> FloatArray:
    """[E] share of the normal force on each of E elements: p ~ 1 - x^2 over the patch; sum 1.

    A soft fingertip presses hardest in the middle (Johnson, "Contact mechanics", 1985, chapter 4),
    so the outer elements reach mu N first: incipient slip. A single element bears everything and
    slips all at once.
    """
    elements = int(count)

    # From the middle of the patch, x = 0, to its edge; each element at the middle of its part.
    x = (np.arange(elements) + 0.5) / elements
    share = 1.0 - x * x
    return share / share.sum()


class Lag(PhysicsEffect):
    """Standard linear solid: N gains q, dq/dt = ratio k d(depth)/dt - q / time, stepped implicitly.

    Pressed in and held, the force falls from (1 + ratio) k depth to k depth as exp(-t / time); in
    and out again it makes a hysteresis loop (Findley, Lai & Onaran, "Creep and relaxation of
    nonlinear viscoelastic materials", 1976). Force N, stiffness N/m, time s.
    """

    kind = "lags"

    def __init__(self, batch: EffectBatch) -> None:
        stiffness = np.stack([trial.finger_n_per_m for trial in batch.trials], axis=1)
        self.stiffness = stiffness * batch.values("ratio")
        self.time_s = batch.values("time_s")
        self.held_n = np.zeros(self.stiffness.shape)

    def terms(self, dt_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(stiffness, held), [S, B] each: q after the step = held + stiffness * change of depth."""
        # Backward Euler, solved for the force q at the end of the step.
        left = 1.0 / (1.0 + dt_s / self.time_s)
        return self.stiffness * left, self.held_n * left

    def moved(
        self, change_m: FloatArray, touching: BoolArray, dt_s: FloatArray
    ) -> None:
        """Take in the change of depth; without contact the memory is lost."""
        stiffness, held = self.terms(dt_s)
        self.held_n = np.where(touching, held + stiffness * change_m, 0.0)


class Texture(PhysicsEffect):
    """Friction limit of an element times 1 + depth sin(2 pi s / wavelength + phase), s its slip.

    At a slip speed v the force swings with v / wavelength, Hz: the vibration by which skin and slip
    sensors detect slip (Johansson & Flanagan, Nat. Rev. Neurosci. 10, 2009). Each element has a
    random phase. The effect needs fine steps.
    """

    kind = "textures"

    def __init__(self, batch: EffectBatch) -> None:
        self.depth = batch.values("depth")
        # Radians of the swing for each metre of slip.
        self.per_m = 2e3 * np.pi / batch.values("wavelength_mm")
        # Phases of the most elements, so that a trial's draws do not depend on their number.
        shape = MOST_ELEMENTS, len(batch.trials[0].finger_n_per_m)
        phases = [rng.uniform(0.0, 2.0 * np.pi, shape) for rng in batch.rngs]
        self.phase = np.stack(phases, axis=2)

        # None until the first step shows how many elements a brush has.
        self.slipped_m: FloatArray | None = None

    def scale(self, slipped_m: FloatArray) -> FloatArray:
        """[E, S, B] factor of the friction limit; slipped_m [E, S, B]: slip in the last step."""
        if self.slipped_m is not None:
            slipped_m = self.slipped_m + slipped_m
        self.slipped_m = slipped_m
        place = self.per_m * slipped_m + self.phase[: len(slipped_m)]
        return 1.0 + self.depth * np.sin(place)


EFFECTS = {
    "brush": Effect(
        pressure,
        {"count": Parameter(5.0, "", 1, MOST_ELEMENTS, "elements of each contact")},
        constant="count",
        sets="pressure",
    ),
    "texture": Effect(
        Texture,
        {
            "wavelength_mm": Parameter(
                {"uniform": [0.6, 2.0]},
                "mm",
                0.05,
                50,
                "spatial period of the roughness",
            ),
            "depth": Parameter(
                {"uniform": [0.1, 0.3]}, "", 0, 0.9, "how much friction swings"
            ),
        },
        longest_step_s=1e-3,
    ),
    "lag": Effect(
        Lag,
        {
            "ratio": Parameter(
                {"uniform": [0.1, 0.5]},
                "",
                0,
                10,
                "stiffness that relaxes over stiffness that stays",
            ),
            "time_s": Parameter(
                {"log_uniform": [0.05, 0.8]},
                "s",
                0.001,
                100,
                "time constant of relaxation",
            ),
        },
    ),
}
