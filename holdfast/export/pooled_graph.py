"""The features of pooled.py in the step graph, with few nodes: what they share is added once.

Rows of the history (means, changes) are one product with a constant matrix. From them come the
signals of every sensor, in one table; a product adds their pools. Two look-ups and a division make
all ratios, one more look-up what is the largest of several.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from holdfast.core.contract import NORMAL_FLOOR, FloatArray
from holdfast.export.pooled import (
    ACROSS,
    ALONG,
    FAMILIES,
    FINGERS,
    FLOORS,
    HELD,
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

LEAST_WEIGHT = 1e-12
"""Added to the weight of every sensor, also of one that is not usable."""


class PooledGraph:
    """Adds the features of some families to a graph; name: of the first, for the state."""

    def __init__(
        self, history: History, features: list[PooledFeature], name: str
    ) -> None:
        self.history = history
        self.name = name
        self.graph = history.graph
        self.spec = history.spec
        self.features = features
        self.n_sensors = history.spec.n_sensors
        self.sides = side_matrix(history.spec)
        ratios = [ratio for feature in features for ratio in feature.ratios]
        self.ratios = list(dict.fromkeys(ratios))

        of_samples = [NOW, RECENT]
        of_series: list[Row] = []
        for ratio in self.ratios:
            if ratio.signal in SERIES:
                of_series.append(_mean_row(ratio.row))
            elif ratio.signal != TOUCHING:
                of_samples.append(ratio.row)
            if ratio.other is not None:
                # of the same kind: both of a series, or both of samples
                into = of_series if ratio.signal in SERIES else of_samples
                into.append(ratio.other[1])
        used = {ratio.signal for ratio in self.ratios}
        self.columns = [SHEAR, PRESS, NORMAL]
        self.columns += [one for one in (ALONG, ACROSS) if one in used]
        if used & {ALONG, ACROSS}:
            of_samples.append(HELD)
        if of_series:
            of_samples.append(STEP)
        self.rows = list(dict.fromkeys(of_samples))
        self.series_rows = list(dict.fromkeys(of_series))
        self.has_touch = TOUCHING in used
        # ratio -> its places among the ratios
        self.found: dict[Ratio, list[int]] = {}

    def add(self) -> str:
        """[B, features] float64."""
        graph = self.graph
        signals, weight = self._signals()
        if self.weight:
            weight = graph.node("Mul", weight, self.weight)
        weighted = graph.node("Mul", signals, weight)

        # every sensor, then its pools
        factors = np.array(list(POOLS.values()))
        pools = np.hstack([np.eye(self.n_sensors), self.sides @ factors.T])
        least, whole = self._touch()
        pooled = graph.node("MatMul", weighted, pools / (whole - least))
        parts = [graph.node("Flatten", pooled, axis=1)]
        if self.has_touch:
            parts.append(graph.node("ReduceSum", weight, [2], keepdims=0))
        if self.series_rows:
            parts += self._series(parts[0])
        numbers = parts[0] if len(parts) == 1 else graph.node("Concat", *parts, axis=1)
        return self._chosen(self._ratios(numbers))

    @cached_property
    def weight(self) -> str:
        """[B, 1, sensors] float64: 0, or all sensors of a side over its usable ones.

        1 on a side without a usable sensor. "" where every sensor is needed, so that it is 1.
        """
        counted = self.history.counted
        if not counted:
            return ""
        graph = self.graph
        first_of_sensor = list(range(0, self.spec.n_channels, 3))
        usable = graph.node("Gather", counted, first_of_sensor, axis=2)
        # far below any weight that counts, so that nothing over nothing is 1
        some = graph.node("Add", usable, LEAST_WEIGHT)

        # the usable share of the sensors of its side
        same = (self.sides @ self.sides.T > 0.0).astype(np.float64)
        share = graph.node("MatMul", some, same / same.sum(axis=0))
        return graph.node("Div", some, share)

    def _touch(self) -> tuple[float, float]:
        """Normal forces at which a finger touches not at all, and wholly."""
        floor = NORMAL_FLOOR[self.spec.unit]
        return TOUCH[0] * floor, TOUCH[1] * floor

    def _signals(self) -> tuple[str, str]:
        """[B, rows x columns, sensors] every signal of every row, and touch [B, 1, sensors].

        touch: from 0 to the difference of the two forces of `_touch`.
        """
        graph = self.graph
        time = np.array([row.weights(self.spec) for row in self.rows])
        samples = graph.node("MatMul", time, self.history.samples)

        # length of the shear and size of the normal force, of each sensor
        squares = graph.node("Mul", samples, samples)
        both = np.hstack([self._sensors(1.0, 1.0, 0.0), self._sensors(0.0, 0.0, 1.0)])
        squared = graph.node("MatMul", squares, both)
        lengths = graph.node("Sqrt", squared)
        normal = graph.node("MatMul", samples, self._sensors(0.0, 0.0, 1.0))
        parts = [lengths, normal, *self._turned(samples, lengths)]
        table = graph.node("Concat", *parts, axis=2)
        n_signals = len(self.rows) * len(self.columns)
        signals = graph.reshape(table, 0, n_signals, self.n_sensors)

        recent = self.rows.index(RECENT)
        pressed = graph.columns(normal, recent, recent + 1)
        least, whole = self._touch()
        limited = graph.node("Clip", pressed, least, whole)
        return signals, graph.node("Sub", limited, least)

    def _sensors(self, *axes: float) -> FloatArray:
        """[C, sensors]: adds the channels of a sensor, each times a factor."""
        return np.kron(np.eye(self.n_sensors), np.array(axes)[:, None])

    def _turned(self, samples: str, lengths: str) -> list[str]:
        """The shear of the rows along u and across it, as far as they are used: [B, rows, S]."""
        if HELD not in self.rows or {ALONG, ACROSS}.isdisjoint(self.columns):
            return []
        graph = self.graph
        held = self.rows.index(HELD)
        mean = graph.columns(samples, held, held + 1)
        starts, stops = [held, 0], [held + 1, self.n_sensors]
        length = graph.node("Slice", lengths, starts, stops, [1, 2])
        small = SMALL_MEAN * NORMAL_FLOOR[self.spec.unit]
        divisor = graph.node("Add", length, small)

        directions = []
        if ALONG in self.columns:
            directions.append(mean)
        if ACROSS in self.columns:
            right_angle = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
            turned = np.kron(np.eye(self.n_sensors), right_angle)
            directions.append(graph.node("MatMul", mean, turned))
        parts = []
        for direction in directions:
            products = graph.node("Mul", samples, direction)
            to_sensors = self._sensors(1.0, 1.0, 0.0)
            projected = graph.node("MatMul", products, to_sensors)
            parts.append(graph.node("Div", projected, divisor))
        return parts

    def _series(self, numbers: str) -> list[str]:
        """[B, rows x 2] the rows of both series, and [B, 2] the largest of each."""
        graph = self.graph
        steps = [self._places(SHEAR, STEP, "T+O"), self._places(PRESS, STEP, "T+O")]
        now = graph.node("Gather", numbers, np.reshape(steps, (1, 2)), axis=1)

        # the series lies flat in as few rows of the state as hold it
        length = self.spec.history_samples
        width = self.spec.n_channels
        n_rows = -(-2 * length // width)
        # two numbers a sample: an even number of places
        n_rows += n_rows * width % 2
        kept = n_rows * width // 2
        field = f"series_{self.name}"
        table = graph.state(field, n_rows)
        before = graph.reshape(table, 0, kept, 2)
        series = graph.node("Concat", before, now, axis=1)
        moved = graph.columns(series, 1, kept + 1)
        graph.keep(field, graph.reshape(moved, 0, n_rows, width))

        time = np.zeros((len(self.series_rows), kept + 1))
        for k, row in enumerate(self.series_rows):
            time[k, -length - 1 :] = row.weights(self.spec)
        means = graph.node("MatMul", time, series)
        span = self.spec.lag(MOST.span_s)
        recent = graph.columns(series, kept + 1 - span, kept + 1)
        largest = graph.node("ReduceMax", recent, [1], keepdims=0)
        return [graph.node("Flatten", means, axis=1), largest]

    def _ratios(self, numbers: str) -> str:
        """[B, ..]: every ratio; one of fingers has a number for each sensor."""
        graph = self.graph
        floor = NORMAL_FLOOR[self.spec.unit]
        above: list[int] = []
        below: list[int] = []
        floors: list[float] = []
        for ratio in self.ratios:
            places = self._places(ratio.signal, ratio.row, ratio.pool)
            self.found[ratio] = list(range(len(above), len(above) + len(places)))
            above += places
            if ratio.over == STEPS:
                mean = _mean_row(ratio.row)
                below += self._places(ratio.signal, mean, ratio.pool)
            elif ratio.other is not None:
                below += self._places(*ratio.other, ratio.pool)
            else:
                below += self._places(NORMAL, NOW, ratio.over)
            # without a divisor, max(0, 1) = 1
            least = floor * FLOORS[ratio.over] if ratio.over in FLOORS else 1.0
            if ratio.signal == TOUCHING:
                # to a mean share
                least = self.n_sensors * (self._touch()[1] - self._touch()[0])
            floors += [least] * len(places)

        dividend = graph.node("Gather", numbers, above, axis=1)
        normal = graph.node("Gather", numbers, below, axis=1)
        divisor = graph.node("Max", normal, np.array(floors))
        return graph.node("Div", dividend, divisor)

    def _places(self, signal: str, row: Row, pool: str) -> list[int]:
        """Places of a pooled signal among all numbers: one, or one for each sensor."""
        width = self.n_sensors + len(POOLS)
        behind = len(self.rows) * len(self.columns) * width
        if signal == TOUCHING:
            return [behind]
        if signal in SERIES:
            is_most = row.kind == MOST.kind
            of_row = len(self.series_rows) if is_most else self.series_rows.index(row)
            return [behind + self.has_touch + 2 * of_row + SERIES.index(signal)]

        of_signal = self.rows.index(row) * len(self.columns)
        first = (of_signal + self.columns.index(signal)) * width
        if pool == FINGERS:
            return list(range(first, first + self.n_sensors))
        return [first + self.n_sensors + list(POOLS).index(pool)]

    def _chosen(self, ratios: str) -> str:
        """[B, features]: ratios as they are, and the largest of several."""
        graph = self.graph
        n_ratios = sum(len(places) for places in self.found.values())
        order: list[int] = []
        sets: list[list[int]] = []
        for feature in self.features:
            found: list[int] = []
            for ratio in feature.ratios:
                found += self.found[ratio]
            if feature.is_largest:
                order.append(n_ratios + len(sets))
                sets.append(found)
            else:
                order += found

        if sets:
            width = max(len(found) for found in sets)
            # a short set repeats its members, which does not change the largest
            table = [np.resize(found, width) for found in sets]
            values = graph.node("Gather", ratios, np.array(table), axis=1)
            largest = graph.node("ReduceMax", values, [2], keepdims=0)
            ratios = graph.node("Concat", ratios, largest, axis=1)
        return graph.node("Gather", ratios, order, axis=1)


def _mean_row(row: Row) -> Row:
    """The mean of a series over the span of its row."""
    return Row("mean", row.span_s)


def add_pooled(history: History, names: list[str]) -> str:
    """Add families that follow each other; returns [B, features] float64."""
    features: list[PooledFeature] = []
    for name in names:
        features += FAMILIES[name]
    return PooledGraph(history, features, names[0]).add()
