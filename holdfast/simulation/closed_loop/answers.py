"""The very model file answers B hands at once: bias, graph, decision, as on the hand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NOTHING, RISKY_SLIP, SAFE_SLIP, BoolArray, FloatArray
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.grip import GripSense

IntArray = npt.NDArray[np.int64]


TOGETHER = 50
"""Hands in one call of the graph. Hands that are done cost nothing once all of a call are."""


OUTPUTS = ("p_situation", "situation", "unknown")


class HandModels:
    """One model file, B hands; the bias of each is of its own first rows.

    samples [B]: how many samples each hand needs answers for; after them its answers stand still.
    """

    def __init__(self, model: OpenedModel, samples: IntArray) -> None:
        self.card = model.card
        starts = range(0, len(samples), TOGETHER)
        groups = [slice(start, min(start + TOGETHER, len(samples))) for start in starts]
        self._groups = [(one, int(samples[one].max())) for one in groups]
        self._steps = [model.stepper(OUTPUTS, g.stop - g.start) for g in groups]
        shapes = {name: array.shape[1:] for name, array in self._steps[0].out.items()}
        self._out = {
            name: np.zeros((len(samples), *shape), self._steps[0].out[name].dtype)
            for name, shape in shapes.items()
        }
        self._answered = 0
        self._rows: list[FloatArray] = []
        self._tare: tuple[FloatArray, FloatArray] | None = None

    def answer(self, values: FloatArray, valid: BoolArray) -> GripSense:
        """One sample of every hand: values [B, C] in the model's unit, valid [B, S]."""
        if self._tare is None:
            self._learn(values)
            values, valid = np.zeros_like(values), np.zeros_like(valid)
        else:
            values = values * self._tare[0] - self._tare[1]
        self._step(values, valid)
        return self._sense(values, valid)

    def _step(self, values: FloatArray, valid: BoolArray) -> None:
        """Step the groups of hands that are not done."""
        for steps, (lanes, samples) in zip(self._steps, self._groups, strict=True):
            if self._answered < samples:
                steps.sample[:], steps.valid[:] = values[lanes], valid[lanes]
                for name, array in steps.step().items():
                    self._out[name][lanes] = array
        self._answered += 1

    def _sense(self, values: FloatArray, valid: BoolArray) -> GripSense:
        forces = np.where(valid[..., None], values.reshape(len(values), -1, 3), 0.0)
        out, nothing = self._out, np.zeros(len(values), dtype=np.bool_)
        known = ~out["unknown"]
        return GripSense(
            grip_n=0.5 * np.maximum(forces[..., 2], 0.0).sum(axis=1),
            load_n=np.sqrt(forces[..., 0] ** 2 + forces[..., 1] ** 2).sum(axis=1),
            p_risky=out["p_situation"][:, RISKY_SLIP].astype(np.float64),
            p_safe=out["p_situation"][:, SAFE_SLIP].astype(np.float64),
            known=known,
            empty=known & (out["situation"] == NOTHING),
            opening=nothing,
            overridden=nothing,
        )

    def _learn(self, values: FloatArray) -> None:
        self._rows.append(values.copy())
        if len(self._rows) < max(1, self.card.preparation.bias_rows):
            return
        first = np.stack(self._rows, axis=1)
        learned = [self.card.preparation.learn(rows) for rows in first]
        self._tare = (
            np.stack([s for s, _ in learned]),
            np.stack([b for _, b in learned]),
        )
