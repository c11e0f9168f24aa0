"""Which float tensors hold whole numbers, and within which bounds, for any sample.

A network's sums are whole numbers below 2^24: float32 holds them exactly, and so do the integers of
a processor, which are faster and take half the memory. This proves where that may be used.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from holdfast.edge_runtime.onnx_bytes import FLOAT, Node
from holdfast.export.c.graph import Graph

Bounds = tuple[float, float]
ANYTHING: Bounds = (-math.inf, math.inf)
EXACT_FLOAT32 = 2**24
"""Whole numbers below it are exact in float32."""


class Whole:
    """Bounds of the float tensors of a graph, followed backwards."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._made_by = {name: node for node in graph.nodes for name in node.outputs}
        self._bounds = cache(self._find_bounds)

    def bounds(self, name: str) -> Bounds | None:
        """(least, most) of a float tensor that holds whole numbers, else None."""
        if self._graph.element(name) != FLOAT or not self._is_whole(name):
            return None
        least, most = self._bounds(name)
        return (least, most) if math.isfinite(most - least) else None

    def sums_are_exact(self, node: Node) -> bool:
        """Whether a product of whole numbers with a constant matrix stays below 2^24."""
        weights, bounds = (
            self._graph.values(node.inputs[1]),
            self.bounds(node.inputs[0]),
        )
        if weights is None or bounds is None or (weights != np.round(weights)).any():
            return False
        largest = max(-bounds[0], bounds[1])
        return bool((largest * np.abs(weights).sum(axis=0) < EXACT_FLOAT32).all())

    def _is_whole(self, name: str) -> bool:
        values, node = self._graph.values(name), self._made_by.get(name)
        if values is not None:
            return bool((values == np.round(values)).all())
        if node is None:
            return False
        if node.op_type == "Clip":
            return all(self._is_whole(one) for one in node.inputs)
        return node.op_type == "Round"

    def _find_bounds(self, name: str) -> Bounds:
        values, node = self._graph.values(name), self._made_by.get(name)
        if values is not None:
            return float(values.min()), float(values.max())
        rule = _RULES.get(node.op_type) if node else None
        return rule(self, node) if rule and node else ANYTHING

    def of_round(self, node: Node) -> Bounds:
        """To the nearest whole number."""
        least, most = self._bounds(node.inputs[0])
        return math.floor(least) if math.isfinite(least) else least, (
            math.ceil(most) if math.isfinite(most) else most
        )

    def of_clip(self, node: Node) -> Bounds:
        """Within two constants."""
        least, most = (self._bounds(name) for name in node.inputs[1:])
        return least[0], most[1]

    def with_constant(self, node: Node) -> Bounds:
        """A sum or a product with a constant, number by number."""
        ends = self._each(node)
        return float(ends[0].min()), float(ends[1].max())

    def _each(self, node: Node) -> tuple[np.ndarray, np.ndarray]:
        """(least, most) of every number: each feature has a gain and an offset of its own."""
        first, second = node.inputs
        values = self._graph.values(second)
        inner = self._made_by.get(first)
        if values is None:
            return np.array(-math.inf), np.array(math.inf)
        if node.op_type == "Add" and inner is not None and inner.op_type == "Mul":
            low, high = self._each(inner)
        else:
            low, high = (np.array(end) for end in self._bounds(first))
        if node.op_type == "Add":
            return low + values, high + values
        if not np.isfinite(high - low).all():
            return np.array(-math.inf), np.array(math.inf)
        ends = np.stack([low * values, high * values])
        return ends.min(axis=0), ends.max(axis=0)

    def of_product(self, node: Node) -> Bounds:
        """A sum of inputs times constant weights."""
        weights = self._graph.values(node.inputs[1])
        least, most = self._bounds(node.inputs[0])
        if weights is None or not math.isfinite(most - least):
            return ANYTHING
        largest = float(max(-least, most) * np.abs(weights).sum(axis=0).max())
        return -largest, largest

    def of_quotient(self, node: Node) -> Bounds:
        """x / (|x| + k) with k > 0 is within 1."""
        above, below = node.inputs
        size = self._made_by.get(below)
        if size is None or size.op_type != "Add":
            return ANYTHING
        knee, magnitude = (
            self._graph.values(size.inputs[1]),
            self._made_by.get(size.inputs[0]),
        )
        squashes = (
            knee is not None
            and (knee > 0).all()
            and magnitude is not None
            and magnitude.op_type == "Abs"
            and magnitude.inputs[0] == above
        )
        return (-1.0, 1.0) if squashes else ANYTHING


_RULES: dict[str, Callable[[Whole, Node], Bounds]] = {
    "Round": Whole.of_round,
    "Clip": Whole.of_clip,
    "Add": Whole.with_constant,
    "Mul": Whole.with_constant,
    "Div": Whole.of_quotient,
    "MatMul": Whole.of_product,
}
