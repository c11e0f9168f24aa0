"""Silicone yields with a delay: a Maxwell branch beside the normal spring."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.edge_runtime.contract import BoolArray, FloatArray
from holdfast.simulation.effect import Drawn, Effect
from holdfast.simulation.values import Parameter


class Lag:
    """Standard linear solid: N gains q, dq/dt = ratio k d(depth)/dt - q / time, stepped implicitly.

    Pressed in and held, the force falls from (1 + ratio) k depth to k depth as exp(-t / time); in
    and out again it makes a hysteresis loop (Findley, Lai & Onaran, "Creep and relaxation of
    nonlinear viscoelastic materials", 1976). Force N, stiffness N/m, time s.
    """

    def __init__(
        self, drawn: Sequence[Drawn], trials: Sequence[object], rngs: Sequence[np.random.Generator]
    ) -> None:
        stiffness = np.stack([getattr(trial, "finger_n_per_m") for trial in trials], axis=1)  # noqa: B009
        self.stiffness = stiffness * np.array([d["ratio"] for d in drawn])
        self.time_s = np.array([d["time_s"] for d in drawn])
        self.held_n = np.zeros(self.stiffness.shape)

    def terms(self, dt_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(stiffness, held), [S, B] each: q after the step = held + stiffness * change of depth."""
        left = 1.0 / (1.0 + dt_s / self.time_s)
        return self.stiffness * left, self.held_n * left

    def moved(self, change_m: FloatArray, touching: BoolArray, dt_s: FloatArray) -> None:
        """Take in the change of depth; without contact the memory is lost."""
        stiffness, held = self.terms(dt_s)
        self.held_n = np.where(touching, held + stiffness * change_m, 0.0)

    def busy_s(self, lane: int) -> list[tuple[float, float]]:
        """No interval of its own."""
        return []


LAG = Effect(
    "lag",
    "physics",
    make=Lag,
    parameters={
        "ratio": Parameter(
            {"uniform": [0.1, 0.5]}, "", 0, 10, "stiffness that relaxes over stiffness that stays"
        ),
        "time_s": Parameter(
            {"log_uniform": [0.05, 0.8]}, "s", 0.001, 100, "time constant of relaxation"
        ),
    },
)
