"""The pooled features (holdfast/step/pooled.py) again, in plain numpy over a whole stream.

Samples before the first are zero, as the state of the graph is.
"""

from __future__ import annotations

import math

import numpy as np

from holdfast.core.contract import NORMAL_FLOOR, BoolArray, FloatArray, Unit

SPANS = (2, 4, 8, 16, 32, 64)
"""Samples at 150 Hz."""
ACTIVITY = (4, 8, 15, 37.5, 70.5)


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
        weights = np.ones(x.shape[:2])
        for side in (self.thumb, self.opposing):
            share = counts[:, side].mean(axis=1)
            some = share > 0.0
            weights[np.ix_(some, side)] = counts[some][:, side] / share[some, None]
        self.w = touch * weights

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
        # one number of the hand a sample
        self.step_h = self.both(length(self.h - before(self.h, 1)))
        self.step_z = self.both(np.abs(self.z - before(self.z, 1)))

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
        """The largest over its own normal force."""
        return np.asarray((self.w * signal / self.zf).max(axis=1))

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
        of_thumb = lt / self.zt
        of_opposing = lo / self.zo
        return [
            self.n,
            self.sides(self.z)[0] / self.zs,
            lt,
            lo,
            of_thumb,
            of_opposing,
            np.maximum(of_thumb, of_opposing),
            (lt + lo) / self.zs,
            self.fingers(shear),
            m / self.zs,
            m,
            self.w.mean(axis=1),
        ]

    def along(self) -> list[FloatArray]:
        features = []
        for span in SPANS:
            dh = self.change(self.h, span)
            along = (dh * self.u).sum(axis=-1)
            at, ao = self.sides(along)
            features += [
                (at + ao) / self.zs,
                at + ao,
                np.abs(at - ao) / self.zs,
                np.maximum(at / self.zt, ao / self.zo),
                np.maximum(-at / self.zt, -ao / self.zo),
            ]
        return features

    def across(self) -> list[FloatArray]:
        features = []
        for span in SPANS:
            dh = self.change(self.h, span)
            across = dh[..., 0] * self.u[..., 1] - dh[..., 1] * self.u[..., 0]
            ct, co = self.sides(across)
            features.append((np.abs(ct) + np.abs(co)) / self.zs)
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

    def activity(self) -> list[FloatArray]:
        features = []
        for span in ACTIVITY:
            for series in (self.step_h, self.step_z):
                recent = mean(series, self.samples(span))
                features.append(recent / self.zs)
                if span == ACTIVITY[-1]:
                    features.append(recent)
        return features

    def jump(self) -> list[FloatArray]:
        features = []
        for series in (self.step_h, self.step_z):
            span = self.samples(ACTIVITY[-1])
            recent = [before(series, back) for back in range(span)]
            most = np.max(recent, axis=0)
            least = 0.0005 * self.floor
            features.append(most / self.zs)
            usual = np.maximum(mean(series, span), least)
            features.append(most / usual)
        return features

    def ratio(self) -> list[FloatArray]:
        least = 0.02 * self.floor

        def over(above: FloatArray, below: FloatArray) -> FloatArray:
            return above / np.maximum(below, least)

        lengths, along, normal = [], [], []
        for span in SPANS:
            dh = self.change(self.h, span)
            lengths.append(self.both(length(dh)))
            along.append(self.both((dh * self.u).sum(axis=-1)))
            normal.append(self.both(self.change(self.z, span)))

        features = [over(a, d) for a, d in zip(along, lengths, strict=True)]
        features += [over(normal[k], lengths[k]) for k in (1, 3, 5)]
        for recent, longer in ((0, 3), (1, 4)):
            for series in (self.step_h, self.step_z):
                now = mean(series, self.samples(ACTIVITY[recent]))
                usual = mean(series, self.samples(ACTIVITY[longer]))
                features.append(over(now, usual))
        for recent, longer in ((0, 2), (1, 4), (2, 5)):
            features.append(over(lengths[recent], lengths[longer]))
        return features
