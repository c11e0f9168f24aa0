"""The features of pooled.py in the step graph, with few nodes: what they share is added once.

Rows of the history (means, changes) are one product with a constant matrix. From them come the
signals of every sensor, in one table; a product adds their pools. Two look-ups and a division make
all ratios, one more look-up what is the largest of several.

`own_scaled` is not pooled: it scales the changes of each sensor by what that sensor bears itself.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from holdfast.core.contract import NORMAL_AXIS, FloatArray
from holdfast.core.trial_layout import NORMAL_FLOOR
from holdfast.export.history import History
from holdfast.export.pooled import (
    ACROSS,
    ALONG,
    FAMILIES,
    FINGERS,
    FLOORS,
    HELD,
    NORMAL,
    NOW,
    POOLS,
    PRESS,
    RECENT,
    SHEAR,
    SIZES,
    SMALL_MEAN,
    STEP,
    TOUCH,
    PooledFeature,
    Ratio,
    Row,
    side_matrix,
)
from holdfast.export.spec import USUAL_SENSORS, StepSpec


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
        of_sizes: list[Row] = []
        for ratio in self.ratios:
            rows = of_sizes if ratio.signal in SIZES else of_samples
            rows.append(ratio.row)
        used = {ratio.signal for ratio in self.ratios}
        self.turned = bool(used & {ALONG, ACROSS})
        if self.turned:
            of_samples.append(HELD)
        if of_sizes:
            of_samples.append(STEP)
        self.rows = list(dict.fromkeys(of_samples))
        self.size_rows = list(dict.fromkeys(of_sizes))
        # columns of the table of signals, each of all sensors
        self.columns = [SHEAR, PRESS, NORMAL]
        if self.turned:
            self.columns += [ALONG, ACROSS]
        if self.size_rows:
            self.columns += SIZES
        # ratio -> its places among the ratios
        self.found: dict[Ratio, list[int]] = {}

    def add(self) -> str:
        """[B, features] float64."""
        graph = self.graph
        signals, touch = self._signals()
        weight = touch
        if self.weight:
            weight = graph.node("Mul", touch, self.weight)
        weighted = graph.node("Mul", signals, weight)

        # every sensor, then its pools
        factors = np.array(list(POOLS.values()))
        pools = np.hstack([np.eye(self.n_sensors), self.sides @ factors.T])
        least, whole = self._touch()
        pooled = graph.node("MatMul", weighted, pools / (whole - least))
        numbers = graph.node("Flatten", pooled, axis=1)
        return self._chosen(self._ratios(numbers))

    @cached_property
    def weight(self) -> str:
        """[B, 1, sensors] float64: 0, or all sensors of a side over its usable ones.

        "" where every sensor is needed, so that it is always 1.
        """
        counted = self.history.counted
        if not counted:
            return ""
        graph = self.graph
        first_of_sensor = list(range(0, self.spec.n_channels, 3))
        usable = graph.node("Gather", counted, first_of_sensor, axis=2)

        # the usable share of the sensors of its side
        same = (self.sides @ self.sides.T > 0.0).astype(np.float64)
        share = graph.node("MatMul", usable, same / same.sum(axis=0))
        # a side without a usable sensor is unknown, whatever its sum
        some = graph.node("Max", share, 1.0 / self.n_sensors)
        return graph.node("Div", usable, some)

    def _touch(self) -> tuple[float, float]:
        """Normal forces at which a finger touches not at all, and wholly."""
        floor = NORMAL_FLOOR[self.spec.unit]
        return TOUCH[0] * floor, TOUCH[1] * floor

    def _signals(self) -> tuple[str, str]:
        """[B, rows x columns, sensors] every signal of every row, and touch [B, 1, sensors].

        touch: from 0 to the difference of the two forces of `_touch`.
        """
        graph = self.graph
        n_rows = max(len(self.rows), len(self.size_rows))
        time = _time_matrix(self.rows, n_rows, self.spec)
        samples = graph.node("MatMul", time, self.history.samples)

        # length of the shear and size of the normal force, of each sensor
        squares = graph.node("Mul", samples, samples)
        both = np.hstack([self._sensors(1.0, 1.0, 0.0), self._sensors(0.0, 0.0, 1.0)])
        squared = graph.node("MatMul", squares, both)
        lengths = graph.node("Sqrt", squared)
        normal = graph.node("MatMul", samples, self._sensors(0.0, 0.0, 1.0))
        parts = [lengths, normal]

        if self.turned:
            parts.append(self._turned(samples, lengths))
        if self.size_rows:
            parts.append(self._sizes(lengths, n_rows))
        table = graph.node("Concat", *parts, axis=2)
        signals = graph.reshape(table, 0, n_rows * len(self.columns), self.n_sensors)

        recent = self.rows.index(RECENT)
        pressed = graph.columns(normal, recent, recent + 1)
        least, whole = self._touch()
        limited = graph.node("Clip", pressed, least, whole)
        return signals, graph.node("Sub", limited, least)

    def _sensors(self, *axes: float) -> FloatArray:
        """[C, sensors]: adds the channels of a sensor, each times a factor."""
        return np.kron(np.eye(self.n_sensors), np.array(axes)[:, None])

    def _turned(self, samples: str, lengths: str) -> str:
        """[B, rows, 2 sensors]: the shear of the rows along u and across it."""
        graph = self.graph
        held = self.rows.index(HELD)
        mean = graph.columns(samples, held, held + 1)
        length = graph.node(
            "Slice", lengths, [held, 0], [held + 1, self.n_sensors], [1, 2]
        )
        small = SMALL_MEAN * NORMAL_FLOOR[self.spec.unit]
        more = graph.node("Add", length, small)
        divisor = graph.node("MatMul", more, self._sensors(1.0, 1.0, 1.0).T)
        along = graph.node("Div", mean, divisor)
        right_angle = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
        turned = np.kron(np.eye(self.n_sensors), right_angle)
        across = graph.node("MatMul", along, turned)

        products = [graph.node("Mul", samples, one) for one in (along, across)]
        joined = graph.node("Concat", *products, axis=2)
        return graph.node(
            "MatMul", joined, np.kron(np.eye(2), self._sensors(1.0, 1.0, 0.0))
        )

    def _sizes(self, lengths: str, n_rows: int) -> str:
        """[B, rows, 3 sensors]: every row of the sizes that each sample gives."""
        graph = self.graph
        width = 2 * self.n_sensors
        now = width * self.rows.index(NOW)
        step = width * self.rows.index(STEP)
        # the shear now, and of the step both its shear and its normal force
        places = [*range(now, now + self.n_sensors), *range(step, step + width)]
        flat = graph.node("Flatten", lengths, axis=1)
        latest = graph.node("Gather", flat, np.array([places]), axis=1)

        # as the guard keeps samples: they move on by one row at each sample
        name = f"sizes_{self.name}"
        oldest = graph.state(f"oldest_{name}", 1)
        older = graph.state(f"older_{name}", self.spec.history_samples - 1)
        graph.keep(f"oldest_{name}", older)
        graph.keep(f"older_{name}", latest)
        history = graph.node("Concat", oldest, older, latest, axis=1)
        return graph.node(
            "MatMul", _time_matrix(self.size_rows, n_rows, self.spec), history
        )

    def _ratios(self, numbers: str) -> str:
        """[B, ..]: every ratio; one of fingers has a number for each sensor."""
        graph = self.graph
        floor = NORMAL_FLOOR[self.spec.unit]
        above: list[int] = []
        below: list[int] = []
        floors: list[float] = []
        most: list[float] = []
        for ratio in self.ratios:
            places = self._places(ratio.signal, ratio.row, ratio.pool)
            self.found[ratio] = list(range(len(above), len(above) + len(places)))
            above += places
            below += self._places(NORMAL, NOW, ratio.over)
            # without a divisor, max(0, 1) = 1
            least = floor * FLOORS[ratio.over] if ratio.over in FLOORS else 1.0
            floors += [least] * len(places)
            most += [ratio.most] * len(places)

        dividend = graph.node("Gather", numbers, above, axis=1)
        normal = graph.node("Gather", numbers, below, axis=1)
        divisor = graph.node("Max", normal, np.array(floors))
        divided = graph.node("Div", dividend, divisor)
        return graph.node("Min", divided, np.array(most))

    def _places(self, signal: str, row: Row, pool: str) -> list[int]:
        """Places of a pooled signal among all numbers: one, or one for each sensor."""
        rows = self.size_rows if signal in SIZES else self.rows
        of_signal = rows.index(row) * len(self.columns) + self.columns.index(signal)
        first = of_signal * (self.n_sensors + len(POOLS))
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


def _time_matrix(rows: list[Row], n_rows: int, spec: StepSpec) -> FloatArray:
    """[n_rows, L]: the weights of each row; rows of zeros fill it up."""
    matrix = np.zeros((n_rows, spec.history_samples + 1))
    for k, row in enumerate(rows):
        matrix[k] = row.weights(spec)
    return matrix


def add_pooled(history: History, names: list[str]) -> str:
    """Add families that follow each other; returns [B, features] float64."""
    features: list[PooledFeature] = []
    for name in names:
        features += FAMILIES[name]
    return PooledGraph(history, features, names[0]).add()


def own_scaled(history: History, lags: tuple[int, ...]) -> str:
    """[B, features]: changes of each sensor over its own level; lags: places in LAGS_S.

    In units of its own load, what a sensor tells does not depend on its place on a pad.
    """
    graph = history.graph
    n_sensors = history.spec.n_sensors

    # row 0 of the changes is x[t] itself
    rows = [1 + lag for lag in lags]
    of_lags = graph.node("Gather", history.changes, rows, axis=1)
    # behind the channels stands the sum over the sensors, which has no level
    changes = graph.columns(of_lags, 0, history.spec.n_channels, axis=2)
    scaled = graph.node("Div", changes, _own_levels(history))

    # sensor by sensor, and the lags of each, as in the other differences
    triples = graph.reshape(scaled, 0, len(rows), n_sensors, 3)
    by_sensor = graph.node("Transpose", triples, perm=[0, 2, 1, 3])
    return graph.node("Flatten", by_sensor, axis=1)


def _own_levels(history: History) -> str:
    """[B, 1, C]: what each sensor has borne in the last 0.5 s, the same in its three columns.

    It is the mean of |z|, or a floor where that is more: a sensor that bears next to nothing would
    be divided by its noise. The floor is the share of one sensor in that of the grip force.
    """
    graph = history.graph
    spec = history.spec

    # the matrix stands on the left, as that of the changes does
    mean = np.full((1, history.length), 1.0 / history.length)
    sizes = graph.node("Abs", history.samples)
    means = graph.node("MatMul", mean, sizes)

    # The normal force of a sensor takes the place of all three axes. Its weight is 1 and that of
    # the others 0, so the product is exact.
    of_normal = np.zeros((3, 3))
    of_normal[NORMAL_AXIS] = 1.0
    of_all = np.kron(np.eye(spec.n_sensors), of_normal)
    levels = graph.node("MatMul", means, of_all)

    floor = NORMAL_FLOOR[spec.unit] / USUAL_SENSORS
    return graph.node("Max", levels, floor)
