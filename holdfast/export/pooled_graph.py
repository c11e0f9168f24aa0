"""The features of pooled.py in the step graph: one table of numbers, and ratios of two of them.

A `Number` names what stands in the table: the signal, the row of the history, and the sensor or the
pool. `add` puts all numbers there that the features read, each tensor with the names of what it
holds. A feature is the largest of some ratios, and a ratio is looked up by the names of its two
numbers; no other part knows a place. Rows of the history (means, changes) are one product with a
constant matrix, pools another.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from holdfast.core.contract import NORMAL_FLOOR, FloatArray
from holdfast.export.pooled import (
    ACROSS,
    ALONG,
    FAMILIES,
    FINGERS,
    FLOORS,
    HELD,
    LONGEST_S,
    MOST,
    NORMAL,
    NOW,
    POOLS,
    PRESS,
    RECENT,
    SERIES,
    SHEAR,
    SMALL_MEAN,
    STEP,
    STEPS,
    TOUCH,
    TOUCHING,
    PooledFeature,
    Ratio,
    Row,
    side_matrix,
)

if TYPE_CHECKING:
    from holdfast.export.history import History

STEPS_OF = {
    series: signal for series, signal in zip(SERIES, (SHEAR, PRESS), strict=True)
}
"""Series -> the signal whose steps it keeps."""


class Number(NamedTuple):
    """A number of the table. member: a sensor by its place, or a pool by its name."""

    signal: str
    row: Row
    member: int | str


class PooledGraph:
    """Adds the features of some families to a graph; name: of the first, for the state."""

    def __init__(
        self, history: History, features: list[PooledFeature], name: str
    ) -> None:
        self.graph = history.graph
        self.history = history
        self.spec = history.spec
        self.name = name
        self.sensors = range(history.spec.n_sensors)
        self.features = [self._quotients(feature) for feature in features]

        # what the features read, in their order; each once
        read = [
            one for feature in self.features for both in feature for one in both[:2]
        ]
        self.read = list(dict.fromkeys(read))
        self.tensors: list[str] = []
        self.places: dict[Number, int] = {}
        self.length = 0

    def add(self) -> str:
        """[B, features] float64."""
        self._add_signals()
        if any(one.signal in SERIES for one in self.read):
            self._add_series()
        numbers = self.graph.node("Concat", *self.tensors, axis=1)

        # each ratio once, whatever features it is in
        quotients = list(
            dict.fromkeys(one for all_of in self.features for one in all_of)
        )
        above = [self.places[dividend] for dividend, _, _ in quotients]
        below = [self.places[divisor] for _, divisor, _ in quotients]
        least = np.array([limit for _, _, limit in quotients])
        dividend = self.graph.node("Gather", numbers, above, axis=1)
        divisor = self.graph.node("Gather", numbers, below, axis=1)
        limited = self.graph.node("Max", divisor, least)
        ratios = self.graph.node("Div", dividend, limited)

        # A short set repeats its members, which does not change the largest. Features lie side by
        # side, so that the largest of all of them is taken at once.
        place = {one: place for place, one in enumerate(quotients)}
        width = max(len(all_of) for all_of in self.features)
        sets = [
            np.resize([place[one] for one in all_of], width) for all_of in self.features
        ]
        members = self.graph.node("Gather", ratios, np.transpose(sets), axis=1)
        return self.graph.node("ReduceMax", members, [1], keepdims=0)

    def _quotients(self, feature: PooledFeature) -> list[tuple[Number, Number, float]]:
        """All that a feature is the largest of: dividend, divisor, and the least divisor."""
        found = []
        for ratio in feature.ratios:
            of_fingers = ratio.pool == FINGERS
            for member in self.sensors if of_fingers else [ratio.pool]:
                above = Number(ratio.signal, ratio.row, member)
                found.append((above, self._divisor(ratio, member), self._least(ratio)))
        return found

    def _divisor(self, ratio: Ratio, member: int | str) -> Number:
        """The number that a ratio of this member divides by; of the pool "0", it is 0."""
        if ratio.over == STEPS:
            return Number(ratio.signal, Row("mean", ratio.row.span_s), member)
        if ratio.other is not None:
            return Number(*ratio.other, member)
        return Number(NORMAL, NOW, member if ratio.over == FINGERS else ratio.over)

    def _least(self, ratio: Ratio) -> float:
        """The least that a ratio divides by; without a divisor, max(0, 1) = 1."""
        if ratio.signal == TOUCHING:
            # to a mean share
            none, whole = self._touch()
            return len(self.sensors) * (whole - none)
        floor = NORMAL_FLOOR[self.spec.unit]
        return floor * FLOORS[ratio.over] if ratio.over in FLOORS else 1.0

    def _touch(self) -> tuple[float, float]:
        """Normal forces at which a finger touches not at all, and wholly."""
        floor = NORMAL_FLOOR[self.spec.unit]
        return TOUCH[0] * floor, TOUCH[1] * floor

    def _put(self, tensor: str, names: Sequence[Number | None]) -> None:
        """Put [B, numbers] into the table. names: of each; None for what no feature reads."""
        self.tensors.append(tensor)
        for place, name in enumerate(names, start=self.length):
            if name is not None:
                self.places[name] = place
        self.length += len(names)

    def _add_signals(self) -> None:
        """Put every signal of every row: of each sensor and of each pool, with its weight."""
        graph = self.graph
        of_samples = [one for one in self.read if one.signal not in (*SERIES, TOUCHING)]
        rows = dict.fromkeys(
            [NOW, RECENT, HELD, STEP, *(one.row for one in of_samples)]
        )
        table, signals, normal = self._signals(list(rows), of_samples)
        weight = self._weight(normal, list(rows).index(RECENT))
        weighted = graph.node("Mul", table, weight)

        none, whole = self._touch()
        factors = np.array(list(POOLS.values()))
        sums = side_matrix(self.spec) @ factors.T
        pools = np.hstack([np.eye(len(self.sensors)), sums]) / (whole - none)
        pooled = graph.node("MatMul", weighted, pools)

        members: list[int | str] = [*self.sensors, *POOLS]
        names = [
            Number(signal, row, member)
            for row in rows
            for signal in signals
            for member in members
        ]
        self._put(graph.node("Flatten", pooled, axis=1), names)
        if any(one.signal == TOUCHING for one in self.read):
            touching = graph.node("ReduceSum", weight, [2], keepdims=0)
            self._put(touching, [Number(TOUCHING, NOW, "T+O")])

    def _signals(
        self, rows: list[Row], read: Iterable[Number]
    ) -> tuple[str, list[str], str]:
        """[B, rows x signals, S] by sensor; the signals; and the normal forces [B, rows, S]."""
        graph = self.graph
        time = np.array([row.weights(self.spec) for row in rows])
        samples = graph.node("MatMul", time, self.history.samples)

        # length of the shear and size of the normal force, of each sensor
        squares = graph.node("Mul", samples, samples)
        both = np.hstack([self._sums(1.0, 1.0, 0.0), self._sums(0.0, 0.0, 1.0)])
        lengths = graph.node("Sqrt", graph.node("MatMul", squares, both))
        normal = graph.node("MatMul", samples, self._sums(0.0, 0.0, 1.0))
        parts, signals = [lengths, normal], [SHEAR, PRESS, NORMAL]

        used = {one.signal for one in read}
        held = rows.index(HELD)
        for signal in (ALONG, ACROSS):
            if signal in used:
                parts.append(self._turned(signal, samples, lengths, held))
                signals.append(signal)
        table = graph.node("Concat", *parts, axis=2)
        shape = (0, len(rows) * len(signals), len(self.sensors))
        return graph.reshape(table, *shape), signals, normal

    def _sums(self, *axes: float) -> FloatArray:
        """[C, S]: adds the channels of a sensor, each times a factor."""
        return np.kron(np.eye(len(self.sensors)), np.array(axes)[:, None])

    def _turned(self, signal: str, samples: str, lengths: str, held: int) -> str:
        """[B, rows, S]: the shear of the rows along the mean of the row `held`, or across it."""
        graph = self.graph
        direction = graph.node("Gather", samples, [held], axis=1)
        if signal == ACROSS:
            right_angle = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
            turned = np.kron(np.eye(len(self.sensors)), right_angle)
            direction = graph.node("MatMul", direction, turned)
        products = graph.node("Mul", samples, direction)
        projected = graph.node("MatMul", products, self._sums(1.0, 1.0, 0.0))

        starts, stops = [held, 0], [held + 1, len(self.sensors)]
        length = graph.node("Slice", lengths, starts, stops, [1, 2])
        small = SMALL_MEAN * NORMAL_FLOOR[self.spec.unit]
        return graph.node("Div", projected, graph.node("Add", length, small))

    def _weight(self, normal: str, recent: int) -> str:
        """[B, 1, S]: how far a sensor touches, times all sensors of its side over its usable ones.

        Not a share yet: a whole touch is the difference of the two forces of `_touch`.
        """
        graph = self.graph
        pressed = graph.node("Gather", normal, [recent], axis=1)
        none, whole = self._touch()
        touch = graph.node("Sub", graph.node("Clip", pressed, none, whole), none)

        # its own weight, over the usable share of the sensors of its side
        sides = side_matrix(self.spec)
        same = (sides @ sides.T > 0.0).astype(np.float64)
        first_of_sensor = [3 * sensor for sensor in self.sensors]
        own = graph.node("Gather", self.history.weight, first_of_sensor, axis=2)
        share = graph.node("MatMul", own, same / same.sum(axis=0))
        return graph.node("Mul", touch, graph.node("Div", own, share))

    def _add_series(self) -> None:
        """Put the means of both series over each span, and the largest of each.

        Both lie in one line, a number of the one, a number of the other, the oldest first.
        """
        graph = self.graph
        now = [self.places[Number(STEPS_OF[one], STEP, "T+O")] for one in SERIES]
        newest = graph.node("Gather", self.tensors[0], now, axis=1)
        both, length = self._kept_series(newest)

        of_series = [one.row for one in self.read if one.signal in SERIES]
        rows = dict.fromkeys(row for row in of_series if row.kind != MOST.kind)
        time = np.zeros((length, len(rows)))
        for column, row in enumerate(rows):
            weights = row.weights(self.spec)[-length:]
            time[length - len(weights) :, column] = weights
        means = graph.node("MatMul", both, np.kron(time, np.eye(len(SERIES))))
        names = [Number(one, row, "T+O") for row in rows for one in SERIES]
        self._put(means, names)

        recent = np.arange(2 * length).reshape(length, 2)[-self.spec.lag(MOST.span_s) :]
        values = graph.node("Gather", both, recent, axis=1)
        largest = graph.node("ReduceMax", values, [1], keepdims=0)
        self._put(largest, [Number(one, MOST, "T+O") for one in SERIES])

    def _kept_series(self, newest: str) -> tuple[str, int]:
        """[B, 2 x length] past and newest samples of both series, and the length.

        The past fills as few rows of the state as hold it: an even number of numbers.
        """
        graph, width = self.graph, self.spec.n_channels
        past = self.spec.lag(LONGEST_S) - 1
        n_rows = -(-2 * past // width)
        n_rows += n_rows * width % 2
        field = f"series_{self.name}"
        before = graph.node("Flatten", graph.state(field, n_rows), axis=1)
        both = graph.node("Concat", before, newest, axis=1)
        moved = graph.columns(both, 2, 2 + n_rows * width)
        graph.keep(field, graph.reshape(moved, 0, n_rows, width))
        return both, n_rows * width // 2 + 1


def add_pooled(history: History, names: list[str]) -> str:
    """Add families that follow each other; returns [B, features] float64."""
    features: list[PooledFeature] = []
    for name in names:
        features += FAMILIES[name]
    return PooledGraph(history, features, names[0]).add()
