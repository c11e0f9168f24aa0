"""What happens to raw channels before the step graph: the sign of the magnet, then the bias.

Training, replay and the live path use the same object, and its parameters are in the model's
metadata. So a model sees on the hand what it saw in training.

A recording is prepared as a whole (Preparation.apply); a live stream has only its past (Tare). The
first unloaded rows of a sensor that are valid decide. Until they have come, the sensor of a stream
is invalid, so the state is unknown and not a guess.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from holdfast.core.contract import NORMAL_AXIS, BoolArray, FloatArray, Json

MOST_ROWS = 100_000
"""A bias is taken from fewer rows; these would be ten minutes of a resting hand."""


class Preparation(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How a stream is tared from its first, unloaded rows.

    bias_rows: how many rows the bias is taken from (0: the stream is already tared). statistic:
    mean or median over these rows, each channel on its own; rows that are lost do not count.
    flip_negative_normal: turn a sensor round where the first value of z is below -flip_beyond (a
    reversed magnet). flip_beyond: in the stream's unit, above the noise; otherwise a stream that is
    already tared would be turned at random. turns: the whole sensor, as a reversed magnet turns the
    field on all three axes, or its normal alone, as the thesis has it.
    """

    bias_rows: Annotated[int, Meta(ge=0, le=MOST_ROWS)] = 0
    statistic: Literal["mean", "median"] = "median"
    flip_negative_normal: bool = False
    flip_beyond: Annotated[float, Meta(ge=0.0, lt=1e9)] = 0.0
    turns: Literal["normal", "sensor"] = "normal"

    def apply(self, raw: FloatArray, valid: BoolArray | None = None) -> FloatArray:
        """[T, C] raw -> [T, C] prepared, same unit; valid [T, C/3] as in `learn`."""
        sign, bias = self.learn(raw, valid)
        return raw * sign - bias

    def learn(
        self, raw: FloatArray, valid: BoolArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """(sign [C], bias [C]) of a recording [T, C]: prepared = raw * sign - bias.

        Each sensor is learned from its own first `bias_rows` rows that are valid [T, C/3] and
        finite, as a Tare does; one without such a row keeps sign 1 and bias 0.
        """
        finite = np.isfinite(raw).reshape(len(raw), -1, 3)
        usable: BoolArray = np.logical_and.reduce(finite, axis=2)
        if valid is not None:
            usable &= valid
        sign = np.ones(raw.shape[1])
        bias = np.zeros(raw.shape[1])
        middle = np.mean if self.statistic == "mean" else np.median

        for sensor in range(usable.shape[1]):
            here = slice(3 * sensor, 3 * sensor + 3)
            rows = np.flatnonzero(usable[:, sensor])[: max(1, self.bias_rows)]
            first = raw[rows, here]
            if len(first) and self.flip_negative_normal:
                sign[here] = self._sign(first[0])
            # turned first, because the bias is that of the turned channels
            if len(first) and self.bias_rows:
                bias[here] = [middle(channel) for channel in (first * sign[here]).T]
        return sign, bias

    def _sign(self, reading: FloatArray) -> FloatArray:
        """[3] -1 for the axes that a reversed magnet turns, by a sensor's first reading [3]."""
        sign = np.ones(3)
        if reading[NORMAL_AXIS] < -self.flip_beyond:
            sign[0 if self.turns == "sensor" else NORMAL_AXIS :] = -1.0
        return sign

    def to_json(self) -> Json:
        """As a JSON object, for the metadata."""
        return msgspec.structs.asdict(self)


class Tare:
    """Prepares samples one by one: values [C] in, [C] out, and which sensors [S] can be trusted.

    A sensor's bias comes from its own first valid, finite rows, so a sensor that comes late is
    tared late. From then on the result equals Preparation.apply of the whole recording.

    resting [C]: what the unloaded hand reads, where that is known (`holdfast bias`); then the first
    rows may be loaded.
    """

    def __init__(
        self,
        preparation: Preparation,
        n_channels: int,
        resting: FloatArray | None = None,
    ) -> None:
        self._preparation = preparation
        self._rows: list[list[FloatArray]] = [[] for _ in range(n_channels // 3)]
        self._sign = np.ones(n_channels)
        self._bias = np.zeros(n_channels)
        learns = preparation.bias_rows > 0 or preparation.flip_negative_normal
        if resting is not None:
            self._sign, self._bias = preparation.learn(resting[None])
            learns = False
        self._learns = learns
        """Whether the bias of a sensor is still to come."""
        self._known = np.full(n_channels // 3, not learns)

    @property
    def known(self) -> BoolArray:
        """[S] whose bias is known."""
        return self._known

    @property
    def learned(self) -> tuple[FloatArray, FloatArray]:
        """(sign [C], bias [C]) as far as they are known."""
        return self._sign, self._bias

    def prepare(
        self, values: FloatArray, valid: BoolArray
    ) -> tuple[FloatArray, BoolArray]:
        """Prepare one sample; a sensor without a known bias is invalid."""
        # nothing to learn is the usual case, and costs nothing
        if self._learns:
            # a lost or non-finite reading says nothing about the bias
            finite = np.isfinite(values).reshape(-1, 3).all(axis=1)
            learning = valid & finite & ~self._known
            for sensor in np.flatnonzero(learning):
                reading = values[3 * sensor : 3 * sensor + 3]
                self._learn(int(sensor), reading)
        return values * self._sign - self._bias, valid & self._known

    def _learn(self, sensor: int, values: FloatArray) -> None:
        """One more row of a sensor; with the last one that it needs, its bias is known."""
        rows = self._rows[sensor]
        rows.append(values.copy())
        if len(rows) < self._preparation.bias_rows:
            return

        here = slice(3 * sensor, 3 * sensor + 3)
        sign, bias = self._preparation.learn(np.array(rows))
        self._sign[here] = sign
        self._bias[here] = bias
        self._known[sensor] = True
        self._learns = not self._known.all()
        rows.clear()
