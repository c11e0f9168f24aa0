"""Whether a computed index can leave its table, by the bounds of what the guard graph computes.

The guard walks through a table: position + share of good channels -> next position, which is in the
state of the next sample. An index outside the table ends the step with an error, perhaps only at
the one sample that leads there. The bounds follow from the state and the flags.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from holdfast.edge_runtime.onnx_bytes import BOOL, Node, OnnxModel
from holdfast.edge_runtime.onnx_tensors import Tensor

Bounds = tuple[float, float]
ANYTHING: Bounds = (-math.inf, math.inf)
MOST_LEVELS = 16
"""Operators between an index and what bounds it; our graph has four."""


def require_indices(model: OnnxModel, tensors: dict[str, Tensor]) -> None:
    """Raise ValueError where a computed index of a Gather may be outside its table."""
    ranges = _Ranges(model, tensors)
    for node in model.nodes:
        if node.op_type == "Gather" and tensors[node.inputs[1]].values is None:
            least, most = ranges.of(node.inputs[1])
            axis = node.attributes.get("axis", 0)
            size = tensors[node.inputs[0]].shape[int(axis)]
            if not (least >= 0 and most < size):
                raise ValueError(
                    f"operator Gather for {node.outputs[0]}: an index may be outside of its table"
                )


class _Ranges:
    """Bounds of tensors by name, followed backwards; ANYTHING where no rule bounds them."""

    def __init__(self, model: OnnxModel, tensors: dict[str, Tensor]) -> None:
        self._tensors = tensors
        self._made_by = {name: node for node in model.nodes for name in node.outputs}

    def of(self, name: str, levels: int = MOST_LEVELS) -> Bounds:
        """The least and the greatest value that the tensor can have."""
        tensor, node = self._tensors[name], self._made_by.get(name)
        if tensor.values is not None:
            return float(tensor.values.min()), float(tensor.values.max())
        if tensor.element == BOOL:
            return 0.0, 1.0
        rule = _RULES.get(node.op_type) if node else None
        return (
            rule(self, node, name, levels - 1) if rule and node and levels else ANYTHING
        )

    def cast(self, node: Node, name: str, levels: int) -> Bounds:
        """Conversion to a whole number moves a value towards zero: -0.5 becomes 0."""
        least, most = self.of(node.inputs[0], levels)
        return math.trunc(least) if math.isfinite(least) else least, most

    def add(self, node: Node, name: str, levels: int) -> Bounds:
        """The sums of the ends."""
        (a, b), (c, d) = (self.of(one, levels) for one in node.inputs)
        return a + c, b + d

    def least(self, node: Node, name: str, levels: int) -> Bounds:
        """The smaller of two."""
        (a, b), (c, d) = (self.of(one, levels) for one in node.inputs)
        return min(a, c), min(b, d)

    def difference(self, node: Node, name: str, levels: int) -> Bounds:
        """How far a value is behind the largest is not below 0."""
        first = self._made_by.get(node.inputs[0])
        if (
            first is None
            or first.op_type != "ReduceMax"
            or first.inputs[0] != node.inputs[1]
        ):
            return ANYTHING
        return 0.0, math.inf

    def product(self, node: Node, name: str, levels: int) -> Bounds:
        """Of values from 0 to 1 with a constant matrix: its columns' negative and positive sums."""
        weights = self._tensors[node.inputs[1]].values
        if (
            weights is None
            or weights.ndim != 2
            or self.of(node.inputs[0], levels) != (0.0, 1.0)
        ):
            return ANYTHING
        return float(np.minimum(weights, 0).sum(0).min()), float(
            np.maximum(weights, 0).sum(0).max()
        )

    def gather(self, node: Node, name: str, levels: int) -> Bounds:
        """For any index: the range of its table."""
        return self.of(node.inputs[0], levels)

    def split(self, node: Node, name: str, levels: int) -> Bounds:
        """A field of the state.

        Zero after a reset, else the value that the last sample left there.
        """
        packed = self._made_by.get("state_out")
        if (
            not _is_state(self._made_by.get(node.inputs[0]), self._tensors)
            or packed is None
        ):
            return ANYTHING
        position = self._rows(node.outputs)[name]
        following = [
            one for one, rows in self._rows(packed.inputs).items() if rows == position
        ]
        if (
            packed.op_type != "Concat"
            or not following
            or {one.attributes.get("axis") for one in (node, packed)} != {1}
        ):
            return ANYTHING
        least, most = self.of(following[0], levels)
        return min(least, 0.0), max(most, 0.0)

    def _rows(self, names: tuple[str, ...]) -> dict[str, tuple[int, int]]:
        """The rows of the state that each part has: first, and one past the last."""
        ends = np.cumsum([self._tensors[name].shape[1] for name in names]).tolist()
        return dict(zip(names, zip([0, *ends], ends, strict=False), strict=True))


def _is_state(node: Node | None, tensors: dict[str, Tensor]) -> bool:
    """Whether it is Where(flag, 0, state): a state begins as zeros, and a flag resets it."""
    if node is None or node.op_type != "Where" or node.inputs[2] != "state":
        return False
    zero = tensors[node.inputs[1]].values
    return zero is not None and not zero.any()


_RULES: dict[str, Callable[[_Ranges, Node, str, int], Bounds]] = {
    "Cast": _Ranges.cast,
    "Add": _Ranges.add,
    "MatMul": _Ranges.product,
    "Gather": _Ranges.gather,
    "Min": _Ranges.least,
    "Sub": _Ranges.difference,
    "Split": _Ranges.split,
}
