"""A quiet, open hand: noise or drift and nothing else, for a minute; how much is called nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import NOTHING, SITUATIONS, BoolArray, FloatArray, Json
from holdfast.core.hand_card import Side
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.simulation.effects.effect import stream
from holdfast.simulation.loop.closed_loop import model_of
from studies.distortions.chain import Drift, Noise
from studies.distortions.law import PlanRequest, distorted
from studies.distortions.statistics import mean_interval

MINUTE_S = 60.0
HANDS = 20
RESTING_N = 23.0
"""The normal reading of a magnet that nothing touches, N; the bias takes it off."""
LEVELS_MN = (0.0, 1.0, 3.0, 6.0, 10.0, 20.0, 30.0, 40.0)
DRIFT_N_S = 0.020
DRIFT_NOISES_MN = (0.0, 3.0, 20.0)
OUTPUTS = ("situation", "unknown")


@dataclass(frozen=True)
class QuietHand:
    """One row: white noise on every axis, mN rms, and a drift of every axis, N a second."""

    noise_mn: float
    drift_n_s: float = 0.0

    @property
    def name(self) -> str:
        """Of its random streams."""
        return f"quiet {self.noise_mn:g} {self.drift_n_s:g}"

    def readings(
        self, seed: int, hand: int, rate_hz: float, sensors: int
    ) -> FloatArray:
        """[T, S, 3] of a minute, N."""
        t_s = np.arange(round(MINUTE_S * rate_hz)) / rate_hz
        values = np.zeros((len(t_s), sensors, 3))
        values[..., 2] = RESTING_N
        valid: BoolArray = np.ones(values.shape[:2], dtype=np.bool_)
        rng = stream(seed, hand, self.name)
        # Noise and drift are alike on both sides.
        sides: tuple[Side, ...] = tuple(["opposing"] * sensors)
        request = PlanRequest(rng, t_s, sides)
        for law in (Noise(1e-3 * self.noise_mn), Drift(self.drift_n_s)):
            values, valid = distorted(law, values, valid, request)
        return values


def quiet_rows() -> list[QuietHand]:
    """Every row, the quietest first."""
    noisy = [QuietHand(level) for level in LEVELS_MN]
    return [*noisy, *(QuietHand(level, DRIFT_N_S) for level in DRIFT_NOISES_MN)]


@dataclass(frozen=True)
class QuietJob:
    """One row by a model file. hands: minutes that are run."""

    model: ModelChoice
    row: QuietHand
    seed: int
    hands: int = HANDS

    def __call__(self) -> Json:
        """The figures of the row: shares of the samples after the start, 95 % over hands."""
        model = model_of(self.model)
        card = model.card
        minutes = []
        for hand in range(self.hands):
            values = self.row.readings(
                self.seed, hand, card.rate_hz, card.n_channels // 3
            )
            raw = values.reshape(len(values), -1)
            minutes.append(card.preparation.apply(raw))

        step = model.stepper(OUTPUTS, self.hands)
        samples = np.stack(minutes, axis=1)
        counts = np.zeros((self.hands, len(SITUATIONS)))
        for k, sample in enumerate(samples):
            step.sample[:] = sample
            step.valid[:] = True
            out = step.step()
            # Until the filters have settled the answer is unknown in every hand.
            if k >= card.settle_samples:
                known = np.flatnonzero(~out["unknown"])
                counts[known, out["situation"][known]] += 1.0

        shares = counts / max(1, len(samples) - card.settle_samples)
        empty = shares[:, NOTHING].tolist()
        return {
            "noise_mn": self.row.noise_mn,
            "drift_mn_s": 1e3 * self.row.drift_n_s,
            "minutes": self.hands,
            "nothing": float(np.mean(empty)),
            "nothing_ci": mean_interval(empty),
            "called": dict(zip(SITUATIONS, shares.mean(axis=0).tolist(), strict=True)),
        }
