"""Removing the bias from a live stream, as the model's preparation does for a recording.

A recording is prepared as a whole; a live stream has only its past. The first unloaded rows decide.
Until they have come, every sensor is invalid, so the state is unknown and not a guess.
"""

from __future__ import annotations

import numpy as np

from holdfast.edge_runtime.contract import BoolArray, FloatArray
from holdfast.edge_runtime.preparation import Preparation


class Tare:
    """Prepares samples one by one: values [C] in, [C] out, and which sensors [S] can be trusted.

    A sensor's bias comes from its own first valid, finite rows, so a sensor that comes late is
    tared late. For a whole recording without invalid rows the result equals Preparation.apply.

    resting [C]: what the unloaded hand reads, where that is known (`holdfast bias`); then the first
    rows may be loaded.
    """

    def __init__(
        self, preparation: Preparation, n_channels: int, resting: FloatArray | None = None
    ) -> None:
        self._preparation = preparation
        self._rows: list[list[FloatArray]] = [[] for _ in range(n_channels // 3)]
        self._sign, self._bias = np.ones(n_channels), np.zeros(n_channels)
        self._known = np.full(
            n_channels // 3, preparation.bias_rows == 0 and not preparation.flip_negative_normal
        )
        if resting is not None:
            self._sign, self._bias = preparation.learn(resting[None])
            self._known[:] = True

    @property
    def known(self) -> BoolArray:
        """[S] whose bias is known."""
        return self._known

    def prepare(self, values: FloatArray, valid: BoolArray) -> tuple[FloatArray, BoolArray]:
        """Prepare one sample; a sensor without a known bias is invalid."""
        if not self._known.all():
            finite = np.isfinite(values).reshape(-1, 3).all(axis=1)
            for sensor in np.flatnonzero(valid & finite & ~self._known):
                self._learn(int(sensor), values[3 * sensor : 3 * sensor + 3])
        return values * self._sign - self._bias, valid & self._known

    def _learn(self, sensor: int, values: FloatArray) -> None:
        rows, wanted = self._rows[sensor], max(1, self._preparation.bias_rows)
        rows.append(values.copy())
        if len(rows) < wanted:
            return
        here = slice(3 * sensor, 3 * sensor + 3)
        self._sign[here], self._bias[here] = self._preparation.learn(np.array(rows))
        self._known[sensor] = True
        rows.clear()
