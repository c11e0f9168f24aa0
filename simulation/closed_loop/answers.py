"""The very model file answers B hands at once: bias, graph, decision, as on the hand."""

from __future__ import annotations

import numpy as np

from edge_runtime.contract import NOTHING, RISKY_SLIP, SAFE_SLIP, BoolArray, FloatArray
from edge_runtime.graph import StepGraph
from edge_runtime.grip import GripSense
from edge_runtime.model import Model

OUTPUTS = ("p_situation", "situation", "unknown")


class HandModels:
    """One model file, B lanes; the bias of each lane is of its own first rows."""

    def __init__(self, model: Model, lanes: int) -> None:
        self.card = model.card
        self.graph = StepGraph(model.session, lanes, OUTPUTS)
        self._rows: list[FloatArray] = []
        self._tare: tuple[FloatArray, FloatArray] | None = None

    def answer(self, values: FloatArray, valid: BoolArray) -> GripSense:
        """One sample of every lane: values [B, C] in the model's unit, valid [B, S]."""
        graph = self.graph
        if self._tare is None:
            graph.sample[:], graph.valid[:] = 0.0, False
            self._learn(values)
        else:
            np.copyto(graph.sample, values * self._tare[0] - self._tare[1])
            np.copyto(graph.valid, valid)
        out = graph.step()
        readings = graph.sample.reshape(len(values), -1, 3)
        forces = np.where(graph.valid[..., None], readings, 0.0)
        situation, known = out["situation"], ~out["unknown"]
        grip_n = 0.5 * np.maximum(forces[..., 2], 0.0).sum(axis=1)
        load_n = np.sqrt(forces[..., 0] ** 2 + forces[..., 1] ** 2).sum(axis=1)
        nothing = np.zeros(len(values), dtype=np.bool_)
        return GripSense(
            grip_n=grip_n,
            load_n=load_n,
            p_risky=out["p_situation"][:, RISKY_SLIP].astype(np.float64),
            p_safe=out["p_situation"][:, SAFE_SLIP].astype(np.float64),
            known=known.copy(),
            empty=known & (situation == NOTHING),
            opening=nothing,
            overridden=nothing,
        )

    def _learn(self, values: FloatArray) -> None:
        self._rows.append(values.copy())
        if len(self._rows) < max(1, self.card.preparation.bias_rows):
            return
        first = np.stack(self._rows, axis=1)
        learned = [self.card.preparation.learn(rows) for rows in first]
        self._tare = np.stack([s for s, _ in learned]), np.stack([b for _, b in learned])
