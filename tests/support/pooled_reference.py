"""The pooled features (holdfast/export/pooled.py) again, in plain numpy over a whole stream.

Samples before the first are zero, as the state of the graph is.
"""

from __future__ import annotations

import math

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, Unit
from holdfast.core.trial_layout import NORMAL_FLOOR

SPANS = (2, 4, 8, 16, 32, 64)
"""Samples at 150 Hz."""
ACTIVITY = (4, 8, 15, 37.5, 75)


def before(signal: FloatArray, lag: int) -> FloatArray:
    """signal[t - lag], zero before the first."""
    start = np.zeros((lag, *signal.shape[1:]))
    return np.concatenate([start, signal])[: len(signal)]


def mean(signal: FloatArray, count: int) -> FloatArray:
    """The mean of the last samples."""
    return np.mean([before(signal, back) for back in range(count)], axis=0)


def length(vectors: FloatArray) -> FloatArray:
    return np.sqrt((vectors**2).sum(axis=-1))


class PooledReference:
    """thumb [S]: which sensors are on the thumb's side. usable [T, S]."""

    def __init__(
        self,
        values: FloatArray,
        rate_hz: float,
        unit: Unit,
        thumb: list[bool],
        usable: BoolArray | None = None,
    ) -> None:
        x = values.reshape(len(values), -1, 3)
        self.h, self.z = x[..., :2], x[..., 2]
        self.rate_hz = rate_hz
        self.floor = NORMAL_FLOOR[unit]
        self.longest = math.floor(0.5 * rate_hz + 1e-9)
        self.thumb = np.array(thumb)
        self.opposing = ~self.thumb
        if self.thumb.all() or self.opposing.all():
            self.thumb = self.opposing = np.ones(len(thumb), bool)

        pressed = mean(self.z, self.samples(4))
        touch = np.clip((pressed / self.floor - 1 / 6) / 0.5, 0.0, 1.0)
        counts = np.ones(x.shape[:2]) if usable is None else usable.astype(float)
        share = np.ones(x.shape[:2])
        for side in (self.thumb, self.opposing):
            share[:, side] = counts[:, side].mean(axis=1, keepdims=True)
        self.w = touch * counts / np.maximum(share, 1.0 / x.shape[1])

        nt, no = self.sides(self.z)
        self.n = nt + no
        self.zs = np.maximum(self.n, self.floor)
        self.zt = np.maximum(nt, 0.5 * self.floor)
        self.zo = np.maximum(no, 0.5 * self.floor)
        self.zf = np.maximum(self.w * self.z, 0.5 * self.floor)

        ago, span = round(0.053 * rate_hz), self.samples(0.453 * 150)
        span = min(span, self.longest + 1 - ago)
        self.m = before(mean(self.h, span), ago)
        self.u = self.m / (length(self.m) + 0.1 * self.floor)[..., None]
        self.step_h = length(self.h - before(self.h, 1))
        self.step_z = np.abs(self.z - before(self.z, 1))

    def samples(self, at_150_hz: float) -> int:
        count = round(at_150_hz / 150 * self.rate_hz)
        return min(max(1, count), self.longest)

    def sides(self, signal: FloatArray) -> tuple[FloatArray, FloatArray]:
        weighted = self.w * signal
        thumb = weighted[:, self.thumb].sum(axis=1)
        return thumb, weighted[:, self.opposing].sum(axis=1)

    def both(self, signal: FloatArray) -> FloatArray:
        thumb, opposing = self.sides(signal)
        return thumb + opposing

    def fingers(self, signal: FloatArray) -> FloatArray:
        """The largest over its own normal force, at most 3."""
        return np.minimum(self.w * signal / self.zf, 3.0).max(axis=1)

    def change(self, signal: FloatArray, span: int) -> FloatArray:
        lag = self.samples(span)
        smooth = 1
        if span > 6:
            smooth = self.samples(3)
        lag = min(lag, self.longest + 1 - smooth)
        smoothed = mean(signal, smooth)
        return smoothed - before(smoothed, lag)

    def family(self, name: str) -> FloatArray:
        """[T, F]."""
        return np.stack(getattr(self, name.removeprefix("pooled_"))(), axis=1)

    def state(self) -> list[FloatArray]:
        shear = length(self.h)
        lt, lo = self.sides(shear)
        m = self.both(length(self.m))
        of_thumb = np.minimum(lt / self.zt, 3.0)
        of_opposing = np.minimum(lo / self.zo, 3.0)
        return [
            self.n,
            self.sides(self.z)[0] / self.zs,
            lt,
            lo,
            of_thumb,
            of_opposing,
            np.maximum(of_thumb, of_opposing),
            np.minimum((lt + lo) / self.zs, 3.0),
            self.fingers(shear),
            m / self.zs,
            m,
        ]

    def along(self) -> list[FloatArray]:
        features = []
        for span in SPANS:
            dh = self.change(self.h, span)
            along = (dh * self.u).sum(axis=-1)
            across = dh[..., 0] * self.u[..., 1] - dh[..., 1] * self.u[..., 0]
            at, ao = self.sides(along)
            ct, co = self.sides(across)
            features += [
                (at + ao) / self.zs,
                at + ao,
                np.abs(at - ao) / self.zs,
                (np.abs(ct) + np.abs(co)) / self.zs,
                np.maximum(at / self.zt, ao / self.zo),
                np.maximum(-at / self.zt, -ao / self.zo),
            ]
        return features

    def shear(self) -> list[FloatArray]:
        features = []
        for span in SPANS:
            dh = length(self.change(self.h, span))
            features += [self.both(dh) / self.zs, self.both(dh), self.fingers(dh)]
        return features

    def normal(self) -> list[FloatArray]:
        features = []
        for span in SPANS:
            dz = self.change(self.z, span)
            nt, no = self.sides(dz)
            features += [
                nt + no,
                (nt + no) / self.zs,
                np.maximum(nt / self.zt, no / self.zo),
                np.maximum(-nt / self.zt, -no / self.zo),
                self.fingers(np.abs(dz)),
            ]
        return features

    def load(self) -> list[FloatArray]:
        shear = length(self.h)
        return [self.both(self.change(shear, span)) / self.zs for span in SPANS]

    def activity(self) -> list[FloatArray]:
        features = []
        for span in ACTIVITY:
            h = mean(self.step_h, self.samples(span))
            z = mean(self.step_z, self.samples(span))
            features += [self.both(h) / self.zs, self.both(z) / self.zs]
            features.append(self.fingers(h))
        return [*features, self.both(h), self.both(z)]
