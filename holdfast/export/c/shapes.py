"""Shape and element type of every tensor of a graph, by a dry run of its operators in numpy.

One sample of ones goes through the graph. The numbers that come out mean nothing; their shapes and
types are those that onnxruntime makes (https://onnx.ai/onnx/operators/).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import NotCompilable
from holdfast.edge_runtime.onnx_bytes import DTYPES, Node, OnnxModel

Array = npt.NDArray[Any]
ELEMENTS = {np.dtype(dtype): element for element, dtype in DTYPES.items()}


@dataclass(frozen=True)
class Tensor:
    """Element type (TensorProto.DataType) and shape; values only for constants."""

    element: int
    shape: tuple[int, ...]
    values: Array | None = None


def shapes_of(model: OnnxModel) -> dict[str, Tensor]:
    """Every tensor by its name, for a batch of one. Raises NotCompilable."""
    arrays: dict[str, Array] = dict(model.constants)
    for name, declared in model.inputs.items():
        shape = [1 if isinstance(size, str) else size for size in declared.shape]
        arrays[name] = np.ones(shape, DTYPES[declared.element])
    for node in model.nodes:
        try:
            inputs = [arrays[name] for name in node.inputs]
            made = _RULES.get(node.op_type, _arithmetic)(node, *inputs)
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            raise refusal(node, f"its inputs do not fit ({error!s:.80})") from None
        outputs = made if isinstance(made, list) else [made]
        arrays.update(zip(node.outputs, outputs, strict=True))
    tensors = {}
    for name, array in arrays.items():
        values = model.constants.get(name)
        tensors[name] = Tensor(ELEMENTS[array.dtype], array.shape, values)
    return tensors


def refusal(node: Node, what: str) -> NotCompilable:
    """The error for an operator that has no C form."""
    return NotCompilable(
        f"operator {node.op_type} for {node.outputs[0][:40]}: {what}",
        cause="a model made by another version of Holdfast",
        next_step="export the model again with this version, or run the ONNX file",
    )


def _like_first(node: Node, first: Array, *others: Array) -> Array:
    return first


def _arithmetic(node: Node, *inputs: Array) -> Array:
    """Numbers by numbers, element by element: of the first input's type."""
    shape = np.broadcast_shapes(*(one.shape for one in inputs))
    return np.ones(shape, inputs[0].dtype)


def _flags(node: Node, *inputs: Array) -> Array:
    return _arithmetic(node, *inputs).astype(np.bool_)


def _where(node: Node, condition: Array, *chosen: Array) -> Array:
    return _arithmetic(node, *chosen, condition)


def _cast(node: Node, values: Array) -> Array:
    return values.astype(DTYPES[node.attributes["to"]])


def _concat(node: Node, *inputs: Array) -> Array:
    return np.concatenate(inputs, axis=node.attributes["axis"])


def _split(node: Node, values: Array, sizes: Array) -> list[Array]:
    axis = node.attributes.get("axis", 0)
    return np.split(values, np.cumsum(sizes)[:-1].tolist(), axis=axis)


def _slice(
    node: Node, values: Array, starts: Array, stops: Array, axes: Array
) -> Array:
    parts = [slice(None)] * values.ndim
    for start, stop, axis in zip(starts, stops, axes, strict=True):
        parts[axis] = slice(start, stop)
    return values[tuple(parts)]


def _gather(node: Node, table: Array, indices: Array) -> Array:
    return np.take(table, indices, axis=node.attributes.get("axis", 0), mode="clip")


def _reshape(node: Node, values: Array, target: Array) -> Array:
    # a 0 in the target keeps the dimension that the input has there
    shape = [size or values.shape[k] for k, size in enumerate(target.tolist())]
    return values.reshape(shape)


def _flatten(node: Node, values: Array) -> Array:
    axis = node.attributes.get("axis", 1)
    return values.reshape(int(np.prod(values.shape[:axis])), -1)


def _transpose(node: Node, values: Array) -> Array:
    return values.transpose(node.attributes["perm"].tolist())


def _reduce(node: Node, values: Array, axes: Array) -> Array:
    keep = bool(node.attributes.get("keepdims", 1))
    # max, unlike sum, keeps the type of small integers
    return np.asarray(values.max(axis=tuple(axes.tolist()), keepdims=keep))


def _arg_max(node: Node, values: Array) -> Array:
    keep = bool(node.attributes.get("keepdims", 1))
    axis = node.attributes.get("axis", 0)
    return np.asarray(values.argmax(axis=axis, keepdims=keep), dtype=np.int64)


def _matrix_product(node: Node, left: Array, right: Array) -> Array:
    return np.asarray(left @ right)


def _trees(node: Node, features: Array) -> Array:
    return np.ones((len(features), node.attributes["n_targets"]), np.float32)


_RULES: dict[str, Callable[..., Array | list[Array]]] = {
    "And": _flags,
    "ArgMax": _arg_max,
    "Cast": _cast,
    "Clip": _like_first,
    "Concat": _concat,
    "Flatten": _flatten,
    "Gather": _gather,
    "Greater": _flags,
    "GreaterOrEqual": _flags,
    "Less": _flags,
    "MatMul": _matrix_product,
    "ReduceL2": _reduce,
    "ReduceMax": _reduce,
    "ReduceMin": _reduce,
    "ReduceSum": _reduce,
    "Reshape": _reshape,
    "Slice": _slice,
    "Split": _split,
    "Transpose": _transpose,
    "TreeEnsembleRegressor": _trees,
    "Where": _where,
}
"""Operator -> its outputs; all others are arithmetic."""
