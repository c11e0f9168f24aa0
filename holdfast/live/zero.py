"""Whether the zero of a run, taken from its first samples, was taken from an open hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.core.contract import NORMAL_AXIS, IntArray, Sample
from holdfast.edge_runtime.model_file import ModelCard

PULLS_FLOORS, PULLS_S = 2.0, 0.1
"""A fingertip is not pulled at: it reads so many touches (normal_floor) below zero, for so long,
where its zero was taken from a closed hand."""


class ZeroWatch:
    """An output of a run whose zero is taken from its first samples: says so, and when it is wrong.

    card: of the model, whose unit the samples have.
    """

    def __init__(self, card: ModelCard, report: Callable[[str], None]) -> None:
        self._report = report
        self._least = -PULLS_FLOORS * card.normal_floor
        self._unit = card.unit
        self._longest = max(1, round(PULLS_S * card.rate_hz))
        self._below: IntArray = np.zeros(card.n_channels // 3, dtype=np.int64)
        self._taken = self._warned = False
        rows = card.preparation.bias_rows
        report(
            f"no --bias: the zero is taken from the first {rows} samples; keep the hand open and "
            "touch nothing"
        )

    def write(self, prediction: object, sample: Sample, reading: object = None) -> None:
        """Look at one prepared sample."""
        if not self._taken and sample.valid.all():
            self._taken = True
            self._report("the zero is taken: the hand may close now")
        if self._warned:
            return
        normal = sample.values[NORMAL_AXIS::3]
        below = sample.valid & (normal < self._least)
        self._below = np.where(below, self._below + 1, 0)
        if (self._below > self._longest).any():
            self._warned = True
            sensor = int(self._below.argmax())
            self._report(
                f"warning: sensor {sensor + 1} reads {normal[sensor]:.2g} {self._unit} along its "
                "normal, as if pulled: the zero was taken while it was pressed. Open the hand and "
                "start again, or measure the zero with holdfast bias"
            )

    def close(self, reason: str = "") -> None:
        """Nothing to close."""
