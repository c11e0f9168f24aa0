"""Features that are pooled over the sensors, by side: no order, number or turn of sensors matters.

Every sensor gives the same numbers, its signals: the length of its shear, its normal force, the
changes of both, and the change of shear along its own mean shear. A pool of a signal is its sum by
side (thumb's and opposing), or its largest over the fingers. So a learner of these features fits
every hand card, however each sensor is turned about its normal.

    w       weight of a sensor, which all its signals are multiplied by: how far it touches (0 to 1)
            x (0 if it is not usable, else all sensors of its side over the usable ones)
    T, O    sum of a signal over the thumb's and over the opposing side; a hand with sensors on one
            side has the same sum on both, as its reaction
    N       normal force T + O; Zs = max(N, floor), ZT and ZO: of a side, with half the floor
    zf      normal force of a sensor, at least half the floor
    u       direction of a sensor's mean shear from 0.50 to 0.05 s ago; shorter for a small mean

`FAMILIES` lists all features; it is the one place to edit. pooled_graph.py adds them to a graph,
and a test has them again in plain numpy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.hand_card import hand_or_usual
from holdfast.step.spec import StepSpec

CHANGES_S = (2 / 150, 4 / 150, 8 / 150, 16 / 150, 32 / 150, 64 / 150)
"""Spans of changes, in s."""
LONGEST_S = 0.47
"""Of a series, in s: the weights of its oldest number look back a little further."""
ACTIVITY_S = (4 / 150, 8 / 150, 0.10, 0.25, LONGEST_S)
"""Spans of mean step sizes, in s."""
SMOOTH_S = 0.02
"""A change over more than twice this span compares means of so many seconds, not samples."""
TOUCH = (0.05 / 0.3, 0.2 / 0.3)
"""A finger touches not at all, and wholly, at these shares of the floor."""
SMALL_MEAN = 0.1
"""Share of the floor at which a sensor's mean shear has half of a direction."""


@dataclass(frozen=True)
class Row:
    """A weighted mean over the history of a signal. kind: "now", "step", "mean" or "change".

    Two kinds are no mean: "most", the largest of a series, and "one", 1.0 whatever the signal.
    span_s: of the mean, or between the two ends of a change. ago_s: where a mean ends.
    """

    kind: str
    span_s: float = 0.0
    ago_s: float = 0.0

    def weights(self, spec: StepSpec) -> FloatArray:
        """[L], the oldest sample first."""
        length = spec.history_samples + 1
        row = np.zeros(length)
        if self.kind == "one":
            return row
        if self.kind == "now":
            return _mean(row, 0, 1)
        if self.kind == "step":
            return _mean(row, 0, 1) - _mean(row, 1, 1)

        span = spec.lag(self.span_s)
        if self.kind == "mean":
            first = round(self.ago_s * spec.rate_hz)
            return _mean(row, first, min(span, length - first))
        smooth = 1
        if self.span_s > 2.0 * SMOOTH_S:
            smooth = spec.lag(SMOOTH_S)
        span = min(span, length - smooth)
        return _mean(row, 0, smooth) - _mean(row, span, smooth)


def _mean(row: FloatArray, ago: int, count: int) -> FloatArray:
    """[L] weights of a mean of samples that ends so many samples ago."""
    weights = np.zeros(len(row))
    stop = len(row) - ago
    weights[stop - count : stop] = 1.0 / count
    return weights


NOW = Row("now")
STEP = Row("step")
ONE = Row("one")
RECENT = Row("mean", 4 / 150)
HELD = Row("mean", 0.453, 0.053)
"""From 0.50 to 0.05 s ago."""
MOST = Row("most", LONGEST_S)
"""Of a series."""

SHEAR, ALONG, NORMAL, PRESS = "h", "a", "z", "|z|"
"""Signals of a row of samples: length of the shear, shear along u, normal force and its size."""
SHEAR_STEP, NORMAL_STEP = "|step h|", "|step z|"
"""Series: T + O of the size of the step since the sample before, with the weights of that time."""
SERIES = (SHEAR_STEP, NORMAL_STEP)

POOLS: dict[str, tuple[float, float]] = {
    "T": (1.0, 0.0),
    "O": (0.0, 1.0),
    "-T": (-1.0, 0.0),
    "-O": (0.0, -1.0),
    "T+O": (1.0, 1.0),
    "T-O": (1.0, -1.0),
    "O-T": (-1.0, 1.0),
    "0": (0.0, 0.0),
}
"""Pool -> factors of the sums of both sides."""
FINGERS = "f"
"""No pool: the signal of each sensor."""
STEPS = "mean step"
"""Instead of a normal force: the mean of the same series over the same span."""
OTHER = "other"
"""Instead of a normal force: another signal or row, which the ratio names."""
FLOORS = {"T+O": 1.0, "T": 0.5, "O": 0.5, FINGERS: 0.5, STEPS: 0.0005, OTHER: 0.02}
"""Least force that something is divided by, as a share of the floor of the unit."""


@dataclass(frozen=True)
class Ratio:
    """A pooled signal over the normal force of a pool; over: which, "0" for none.

    other: with over OTHER, the signal and the row of the same pool to divide by.
    """

    signal: str
    row: Row
    pool: str = "T+O"
    over: str = "0"
    other: tuple[str, Row] | None = None


@dataclass(frozen=True)
class PooledFeature:
    """One ratio, or the largest of several."""

    name: str
    ratios: tuple[Ratio, ...]


def _one(
    name: str, signal: str, row: Row, pool: str = "T+O", over: str = "0"
) -> PooledFeature:
    return PooledFeature(name, (Ratio(signal, row, pool, over),))


def _sides(name: str, signal: str, row: Row, sign: str = "") -> PooledFeature:
    """The larger one of T / ZT and O / ZO; sign "-": of their negatives."""
    ratios = tuple(Ratio(signal, row, sign + side, side) for side in ("T", "O"))
    return PooledFeature(f"max {sign}{name} / Z", ratios)


def _fingers(name: str, signal: str, row: Row) -> PooledFeature:
    """The largest of a signal over the normal force of its finger."""
    return PooledFeature(f"max {name} / zf", (Ratio(signal, row, FINGERS, FINGERS),))


def _state() -> list[PooledFeature]:
    return [
        _one("N", NORMAL, NOW),
        _one("NT / Zs", NORMAL, NOW, "T", "T+O"),
        _one("LT", SHEAR, NOW, "T"),
        _one("LO", SHEAR, NOW, "O"),
        _one("LT / ZT", SHEAR, NOW, "T", "T"),
        _one("LO / ZO", SHEAR, NOW, "O", "O"),
        _sides("L", SHEAR, NOW),
        _one("L / Zs", SHEAR, NOW, "T+O", "T+O"),
        _fingers("L", SHEAR, NOW),
        _one("|m| / Zs", SHEAR, HELD, "T+O", "T+O"),
        _one("|m|", SHEAR, HELD),
        _one("touch", NORMAL, ONE),
    ]


def _along(span_s: float) -> list[PooledFeature]:
    row = Row("change", span_s)
    # the larger one of both
    turned = Ratio(ALONG, row, "T-O", "T+O"), Ratio(ALONG, row, "O-T", "T+O")
    return [
        _one("A / Zs", ALONG, row, "T+O", "T+O"),
        _one("A", ALONG, row),
        PooledFeature("|AT - AO| / Zs", turned),
        _sides("A", ALONG, row),
        _sides("A", ALONG, row, "-"),
    ]


def _shear(span_s: float) -> list[PooledFeature]:
    row = Row("change", span_s)
    return [
        _one("|dh| / Zs", SHEAR, row, "T+O", "T+O"),
        _one("|dh|", SHEAR, row),
        _fingers("|dh|", SHEAR, row),
    ]


def _normal(span_s: float) -> list[PooledFeature]:
    row = Row("change", span_s)
    return [
        _one("dN", NORMAL, row),
        _one("dN / Zs", NORMAL, row, "T+O", "T+O"),
        _sides("dN", NORMAL, row),
        _sides("dN", NORMAL, row, "-"),
        _fingers("|dz|", PRESS, row),
    ]


def _activity(span_s: float) -> list[PooledFeature]:
    row = Row("mean", span_s)
    features = []
    for series in SERIES:
        features.append(_one(f"{series} / Zs", series, row, "T+O", "T+O"))
        if span_s == LONGEST_S:
            features.append(_one(series, series, row))
    return features


def _jump() -> list[PooledFeature]:
    features = []
    for series in SERIES:
        features.append(_one(f"max {series} / Zs", series, MOST, "T+O", "T+O"))
        features.append(_one(f"max {series} / mean", series, MOST, "T+O", STEPS))
    return features


def _hand_ratio(name: str, signal: str, row: Row, other: str, of: Row) -> PooledFeature:
    """A number of the hand over another one, which are large and small together."""
    return PooledFeature(name, (Ratio(signal, row, "T+O", OTHER, (other, of)),))


def _ratio() -> list[PooledFeature]:
    """How much of a change is along the load, or in the normal force, and how sudden it is.

    Gains, friction and the size of the grip cancel.
    """
    features = []
    for span_s in CHANGES_S:
        row = Row("change", span_s)
        features.append(_hand_ratio("A / |dh|", ALONG, row, SHEAR, row))
    for span_s in CHANGES_S[1::2]:
        row = Row("change", span_s)
        features.append(_hand_ratio("dN / |dh|", NORMAL, row, SHEAR, row))
    for recent, longer in ((0, 3), (1, 4)):
        for series in SERIES:
            row = Row("mean", ACTIVITY_S[recent])
            of = Row("mean", ACTIVITY_S[longer])
            features.append(_hand_ratio(f"{series} / before", series, row, series, of))
    for recent, longer in ((0, 2), (1, 4), (2, 5)):
        row = Row("change", CHANGES_S[recent])
        of = Row("change", CHANGES_S[longer])
        features.append(_hand_ratio("|dh| / longer", SHEAR, row, SHEAR, of))
    return features


def _for_each(
    family: Callable[[float], list[PooledFeature]], spans_s: tuple[float, ...]
) -> tuple[PooledFeature, ...]:
    """The features of a family for each span, span by span."""
    features: list[PooledFeature] = []
    for span_s in spans_s:
        features += family(span_s)
    return tuple(features)


@dataclass(frozen=True)
class Family:
    """A group of features. formula, reason: for the table of docs/how-it-works.md."""

    features: tuple[PooledFeature, ...]
    formula: str
    reason: str


FAMILIES = {
    "pooled_state": Family(
        tuple(_state()), "N, L by side; L / Z by side, largest of fingers", "the hold"
    ),
    "pooled_along": Family(
        _for_each(_along, CHANGES_S),
        "dh along u, by side",
        "pull along the load, or against it",
    ),
    "pooled_shear": Family(
        _for_each(_shear, CHANGES_S),
        "|dh|, of hand and finger",
        "change of shear in any direction",
    ),
    "pooled_normal": Family(
        _for_each(_normal, CHANGES_S),
        "dN by side, |dz| of fingers",
        "change of the normal force",
    ),
    "pooled_activity": Family(
        _for_each(_activity, ACTIVITY_S),
        "means of |step h|, |step z|",
        "rubbing and swinging",
    ),
    "pooled_jump": Family(
        tuple(_jump()),
        "largest |step h|, |step z| in 0.5 s",
        "one jump, or even noise",
    ),
    "pooled_ratio": Family(
        tuple(_ratio()),
        "A / |dh|, dN / |dh|; recent / longer",
        "how sudden, and which way",
    ),
}
"""Every group of pooled features by its name."""


def side_matrix(spec: StepSpec) -> FloatArray:
    """[sensors, 2]: 1 where a sensor belongs to the thumb's or the opposing side.

    Without a card, as many sensors as the usual hand has are that hand's, and others lie on one
    side. Sensors that all lie on one side count for both.
    """
    hand = hand_or_usual(spec.hand, spec.n_sensors)
    thumb = np.array(hand.of_thumb if hand else [False] * spec.n_sensors)
    sides = np.stack([thumb, ~thumb], axis=1).astype(np.float64)
    if not sides.any(axis=0).all():
        sides[:] = 1.0
    return sides
