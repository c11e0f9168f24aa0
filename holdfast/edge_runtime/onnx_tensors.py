"""The tensors of a model file's graph, and one operator with its inputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.onnx_bytes import IntArray, Node


@dataclass(frozen=True)
class Tensor:
    """Element type (TensorProto.DataType) and shape; values only for constants."""

    element: int
    shape: tuple[int, ...]
    values: npt.NDArray[Any] | None = None


class Call:
    """One operator with its inputs: what a rule may read."""

    def __init__(self, node: Node, tensors: list[Tensor]) -> None:
        self.node, self.tensors = node, tensors

    @property
    def first(self) -> Tensor:
        """The first input."""
        return self.tensors[0]

    def attribute(self, name: str, default: int) -> int:
        """A whole number."""
        value = self.node.attributes.get(name, default)
        require(isinstance(value, int), self.node, f"{name} is not a whole number")
        return int(value)

    def axis(self, default: int = 0) -> int:
        """The attribute `axis`, within the first input's dimensions."""
        return self.dimension(self.attribute("axis", default))

    def dimension(self, axis: int) -> int:
        """An axis, within the first input's dimensions."""
        require(
            0 <= axis < len(self.first.shape),
            self.node,
            "its axis is outside of its input",
        )
        return axis

    def ints(self, k: int) -> IntArray:
        """The k-th input, which must be a constant row of int64."""
        require(k < len(self.tensors), self.node, "an input is missing")
        values = self.tensors[k].values
        require(
            values is not None, self.node, "an input that must be constant is computed"
        )
        assert values is not None
        require(
            values.dtype == np.int64 and values.ndim == 1,
            self.node,
            "an input that must hold indices does not",
        )
        return values

    def same_element(self, *elements: int) -> int:
        """The common element type of the inputs; one of these, or any without arguments."""
        element = self.first.element
        require(
            all(one.element == element for one in self.tensors),
            self.node,
            "its inputs have different types",
        )
        require(
            not elements or element in elements,
            self.node,
            "its inputs have a type that it does not take",
        )
        return element


def require(holds: object, node: Node, what: str) -> None:
    """Raise ValueError that names the operator."""
    if not holds:
        raise ValueError(f"operator {node.op_type} for {node.outputs[0]}: {what}")
