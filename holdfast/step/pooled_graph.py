"""The features of pooled.py in the step graph: one table of numbers, and ratios of two of them.

A `Number` names what stands in the table: the signal, the row of the history, and the sensor or the
pool. `add` puts all numbers there that the features read, each tensor with the names of what it
holds. A feature is the largest of some ratios, and a ratio is looked up by the names of its two
numbers; no other part knows a place. Rows of the history (means, changes) are one product with a
constant matrix, pools another.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from holdfast.core.contract import NORMAL_FLOOR, FloatArray
from holdfast.step.pooled import (
    ALONG,
    FAMILIES,
    FINGERS,
    FLOORS,
    HELD,
    MOST,
    NORMAL,
    NOW,
    ONE,
    POOLS,
    PRESS,
    RECENT,
    SERIES,
    SHEAR,
    SMALL_MEAN,
    STEP,
    STEPS,
    TOUCH,
    PooledFeature,
    Ratio,
    Row,
    side_matrix,
)

if TYPE_CHECKING:
    from holdfast.step.history import History


class Number(NamedTuple):
    """A number of the table. member: a sensor by its place, or a pool by its name."""

    row: Row
    signal: str
    member: int | str


class Quotient(NamedTuple):
    """One ratio: above / max(below, least)."""

    above: Number
    below: Number
    least: float


class PooledGraph:
    """Adds the features of some families to a graph; name: of the first, for the state.

    quotients: each with its place, once, whatever features it is in. sets: of every feature, the
    places of those that it is the largest of. places: of the numbers in the table.
    """

    def __init__(
        self, history: History, features: list[PooledFeature], name: str
    ) -> None:
        self.graph = history.graph
        self.history = history
        self.spec = history.spec
        self.name = name
        self.sensors = range(history.spec.n_sensors)
        self.quotients: dict[Quotient, int] = {}
        self.sets: list[list[int]] = []
        for feature in features:
            self.sets.append(self._places_of(feature))

        numbers = [
            number for one in self.quotients for number in (one.above, one.below)
        ]
        self.signals = {number.signal for number in numbers}
        rows, series_rows = [NOW, RECENT, HELD, STEP], []
        for number in numbers:
            if number.signal not in SERIES:
                rows.append(number.row)
            elif number.row != MOST:
                series_rows.append(number.row)
        self.rows = list(dict.fromkeys(rows))
        self.series_rows = list(dict.fromkeys(series_rows))
        self.tensors: list[str] = []
        self.places: dict[Number, int] = {}

    def add(self) -> str:
        """Add all nodes; returns the name of the features, [B, features] float64."""
        graph = self.graph
        self._add_signals()
        if self.signals.intersection(SERIES):
            self._add_series()
        numbers = graph.node("Concat", *self.tensors, axis=1)

        above, below, least = zip(*self.quotients, strict=True)
        dividend = graph.node("Gather", numbers, self._at(above), axis=1)
        divisor = graph.node("Gather", numbers, self._at(below), axis=1)
        limited = graph.node("Max", divisor, np.array(least))
        ratios = graph.node("Div", dividend, limited)

        # A short set repeats its members, which does not change the largest. Features lie side by
        # side, so that the largest of all of them is taken at once.
        width = max(map(len, self.sets))
        sets = np.array([np.resize(one, width) for one in self.sets])
        members = graph.node("Gather", ratios, sets.T, axis=1)
        return graph.node("ReduceMax", members, [1], keepdims=0)

    def _places_of(self, feature: PooledFeature) -> list[int]:
        """The places of all quotients that a feature is the largest of; new ones are added."""
        found = []
        for ratio in feature.ratios:
            members = self.sensors if ratio.pool == FINGERS else [ratio.pool]
            for member in members:
                above = Number(ratio.row, ratio.signal, member)
                below = self._divisor(ratio, member)
                one = Quotient(above, below, self._least(ratio))
                found.append(self.quotients.setdefault(one, len(self.quotients)))
        return found

    def _divisor(self, ratio: Ratio, member: int | str) -> Number:
        """The number that a ratio of this member divides by; of the pool "0", it is 0."""
        if ratio.over == STEPS:
            return Number(Row("mean", ratio.row.span_s), ratio.signal, member)
        if ratio.other is not None:
            signal, row = ratio.other
            return Number(row, signal, member)
        return Number(NOW, NORMAL, member if ratio.over == FINGERS else ratio.over)

    def _least(self, ratio: Ratio) -> float:
        """The least that a ratio divides by; without a divisor, max(0, 1) = 1."""
        if ratio.row == ONE:
            # the sum of the weights to their mean; on one side, each counts twice
            return float(side_matrix(self.spec).sum())
        floor = NORMAL_FLOOR[self.spec.unit]
        return floor * FLOORS[ratio.over] if ratio.over in FLOORS else 1.0

    def _touch(self) -> tuple[float, float]:
        """Normal forces at which a finger touches not at all, and wholly."""
        floor = NORMAL_FLOOR[self.spec.unit]
        return TOUCH[0] * floor, TOUCH[1] * floor

    def _at(self, numbers: Iterable[Number]) -> list[int]:
        """Their places in the table."""
        return [self.places[one] for one in numbers]

    def _put(
        self,
        tensor: str,
        signals: Iterable[str],
        rows: Iterable[Row],
        members: Iterable[str | int] = ("T+O",),
    ) -> None:
        """Put [B, numbers] into the table: signals, their rows, and the members of each row."""
        self.tensors.append(tensor)
        for signal, row, member in product(signals, rows, members):
            self.places[Number(row, signal, member)] = len(self.places)

    def _add_signals(self) -> None:
        """Put every signal of every row: of each sensor and of each pool, with its weight."""
        graph = self.graph
        table, signals, normal = self._signals()
        weight = self._weight(normal)
        weighted = graph.node("Mul", table, weight)

        none, whole = self._touch()
        sums = side_matrix(self.spec) @ np.array(list(POOLS.values())).T
        pools = np.hstack([np.eye(len(self.sensors)), sums]) / (whole - none)
        pooled = graph.node("MatMul", weighted, pools)
        flat = graph.node("Flatten", pooled, axis=1)
        self._put(flat, signals, self.rows, [*self.sensors, *POOLS])

    def _signals(self) -> tuple[str, list[str], str]:
        """[B, signals x rows, S] by sensor; the signals; and the normal forces [B, rows, S]."""
        graph = self.graph
        samples = graph.node("MatMul", self._time_and_one(), self.history.samples())

        squares = graph.node("Mul", samples, samples)
        of_shear = graph.node("MatMul", squares, self._sums(1.0, 1.0, 0.0))
        lengths = graph.node("Sqrt", of_shear)
        normal = graph.node("MatMul", samples, self._sums(0.0, 0.0, 1.0))
        press = graph.node("Abs", normal)
        parts, signals = [lengths, press, normal], [SHEAR, PRESS, NORMAL]
        if ALONG in self.signals:
            parts.append(self._along(samples, lengths))
            signals.append(ALONG)
        return graph.node("Concat", *parts, axis=1), signals, normal

    def _time(self, rows: list[Row]) -> FloatArray:
        """[rows, L] weights of the history's samples."""
        return np.array([row.weights(self.spec) for row in rows])

    def _time_and_one(self) -> FloatArray:
        """[rows, L + 1]: of the samples, and of the 1.0 behind them.

        RECENT, which only weights read, is the force above that of no touch.
        """
        time = np.pad(self._time(self.rows), ((0, 0), (0, 1)))
        if ONE in self.rows:
            time[self.rows.index(ONE), -1] = 1.0
        time[self.rows.index(RECENT), -1] = -self._touch()[0]
        return time

    def _sums(self, *axes: float) -> FloatArray:
        """[C, S]: adds the channels of a sensor, each times a factor."""
        return np.kron(np.eye(len(self.sensors)), np.array(axes)[:, None])

    def _along(self, samples: str, lengths: str) -> str:
        """[B, rows, S]: the shear of the rows along the mean of the row HELD."""
        graph = self.graph
        held = [self.rows.index(HELD)]
        direction = graph.node("Gather", samples, held, axis=1)
        products = graph.node("Mul", samples, direction)
        projected = graph.node("MatMul", products, self._sums(1.0, 1.0, 0.0))

        length = graph.node("Gather", lengths, held, axis=1)
        small = SMALL_MEAN * NORMAL_FLOOR[self.spec.unit]
        return graph.node("Div", projected, graph.node("Add", length, small))

    def _weight(self, normal: str) -> str:
        """[B, 1, S]: how far a sensor touches, times all sensors of its side over its usable ones.

        Not a share yet: a whole touch is the difference of the two forces of `_touch`.
        """
        graph = self.graph
        recent = [self.rows.index(RECENT)]
        pressed = graph.node("Gather", normal, recent, axis=1)
        none, whole = self._touch()
        touch = graph.node("Clip", pressed, 0.0, whole - none)

        # its own weight, over the usable share of the sensors of its side
        sides = side_matrix(self.spec)
        same = (sides @ sides.T > 0.0).astype(np.float64)
        first_of_sensor = np.arange(0, self.spec.n_channels, 3)
        own = graph.node("Gather", self.history.weight, first_of_sensor, axis=2)
        share = graph.node("MatMul", own, same / same.sum(axis=0))
        return graph.node("Mul", touch, graph.node("Div", own, share))

    def _add_series(self) -> None:
        """Put the means of both series over each span, and the largest of each.

        Both lie in one line, a number of the one, a number of the other, the oldest first.
        """
        graph = self.graph
        now = self._at([Number(STEP, SHEAR, "T+O"), Number(STEP, PRESS, "T+O")])
        newest = graph.node("Gather", self.tensors[0], now, axis=1)
        both, length = self._kept_series(newest)

        # the history is as long as the series, or one of them is filled up in front
        time = self._time(self.series_rows)[:, -length:]
        time = np.pad(time, ((0, 0), (length - time.shape[1], 0)))
        # all means of the one series, then all of the other
        of_series = [np.kron(time.T, one[:, None]) for one in np.eye(2)]
        means = graph.node("MatMul", both, np.hstack(of_series))
        self._put(means, SERIES, self.series_rows)

        by_time = graph.reshape(both, 0, length, 2)
        largest = graph.node("ReduceMax", by_time, [1], keepdims=0)
        self._put(largest, SERIES, [MOST])

    def _kept_series(self, newest: str) -> tuple[str, int]:
        """[B, 2 x length] past and newest samples of both series, and the length.

        The past fills as few rows of the state as hold it: an even number of numbers. What is left
        in front repeats the newest sample, so that the largest of all is that of the span.
        """
        graph, width = self.graph, self.spec.n_channels
        past = self.spec.lag(MOST.span_s) - 1
        n_rows = -(-2 * past // width)
        n_rows += n_rows * width % 2
        length = n_rows * width // 2 + 1
        field = f"series_{self.name}"
        before = graph.node("Flatten", graph.state(field, n_rows), axis=1)
        both = graph.node("Concat", before, newest, axis=1)

        samples = np.arange(1, length)
        samples[: length - 1 - past] = length - 1
        places = np.stack([2 * samples, 2 * samples + 1], axis=1)
        following = places.reshape(n_rows, width)
        graph.keep(field, graph.node("Gather", both, following, axis=1))
        return both, length


def add_pooled(history: History, names: list[str]) -> str:
    """Add families that follow each other; returns [B, features] float64."""
    features: list[PooledFeature] = []
    for name in names:
        features += FAMILIES[name].features
    return PooledGraph(history, features, names[0]).add()
