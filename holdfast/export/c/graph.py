"""The typed graph of a sealed file, for one sample: nodes, shapes, element types and constants.

Shapes and types come from a dry run of the operators in numpy: one sample of ones goes through the
graph. The numbers that come out mean nothing; their shapes and types are those that onnxruntime
makes (https://onnx.ai/onnx/operators/).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import NotCompilable, needs_extra
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import golden_of
from holdfast.edge_runtime.model_file import SEAL_KEY, ModelCard, read_card, read_sealed

with needs_extra("train"):
    import onnx
    from onnx import TensorProto, helper, numpy_helper

BOOL, DOUBLE, FLOAT = TensorProto.BOOL, TensorProto.DOUBLE, TensorProto.FLOAT
INT32, INT64 = TensorProto.INT32, TensorProto.INT64
Array = npt.NDArray[Any]
DTYPES: dict[int, type[np.generic]] = {
    FLOAT: np.float32,
    INT32: np.int32,
    INT64: np.int64,
    BOOL: np.bool_,
    DOUBLE: np.float64,
}
"""Element type of ONNX -> numpy type."""
ELEMENTS = {np.dtype(dtype): element for element, dtype in DTYPES.items()}
"""The same the other way."""
INPUTS = ("sample", "valid", "state")
"""Tensors that the caller of a step owns."""
FEATURES = "features"
"""The tensor at which a step is cut: sensing makes it, answering reads nothing else."""
NEXT_STATE = "state_out"
"""The table of state that a step leaves to the next one."""
Shape = tuple[int, ...]


@dataclass(frozen=True)
class Node:
    """One operator; its attributes by name, lists as arrays.

    `nodes_modes` of a forest marks the nodes that are branches.
    """

    op_type: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any]


@dataclass(frozen=True)
class Tensor:
    """Element type (TensorProto.DataType) and shape; values only for constants.

    shape: for one sample, so its first number is 1 where the graph has a batch.
    """

    element: int
    shape: tuple[int, ...]
    values: Array | None = None


@dataclass(frozen=True)
class Graph:
    """What is compiled. digest: the file's seal. nodes: in order, without the folded ones.

    tensors: by name, with values where they are constant. golden: the stored answers.
    """

    card: ModelCard
    digest: str
    golden: Outputs
    nodes: tuple[Node, ...]
    tensors: dict[str, Tensor]
    outputs: tuple[str, ...]

    def shape(self, name: str) -> Shape:
        """For one sample; the first dimension is the batch of one."""
        return self.tensors[name].shape

    def element(self, name: str) -> int:
        """Of TensorProto.DataType."""
        return self.tensors[name].element

    def values(self, name: str) -> npt.NDArray[Any] | None:
        """The numbers of a constant, or None."""
        return self.tensors[name].values

    def constant(self, name: str, node: Node) -> npt.NDArray[Any]:
        """The numbers of an input that must be constant. Raises NotCompilable."""
        values = self.values(name)
        if values is None:
            raise refusal(
                node, "an input is computed that the C form needs as a constant"
            )
        return values

    @property
    def n_features(self) -> int:
        """The number of features, F."""
        return self.shape(FEATURES)[1]


def refusal(node: Node, what: str) -> NotCompilable:
    """The error for an operator that has no C form."""
    return NotCompilable(
        f"operator {node.op_type} for {node.outputs[0][:40]}: {what}",
        cause="a model made by another version of Holdfast",
        next_step="export the model again with this version, or run the ONNX file",
    )


def read_graph(path: str | Path) -> Graph:
    """The graph of a sealed file. Raises a ModelError."""
    model = onnx.load_from_string(read_sealed(path))
    metadata = {one.key: one.value for one in model.metadata_props}
    nodes = tuple(map(_node, model.graph.node))
    tensors = shapes_of(model.graph, nodes)
    # a fresh state is all zero, and holdfast_init makes it: no step has to reset
    tensors["reset"] = Tensor(BOOL, (1, 1, 1), np.zeros((1, 1, 1), dtype=np.bool_))

    # the caller owns the features and the state: they are no fields of the output struct
    outputs = [one.name for one in model.graph.output]
    names = tuple(name for name in outputs if name not in (FEATURES, NEXT_STATE))
    return Graph(
        card=read_card(metadata, path),
        digest=metadata[SEAL_KEY],
        golden=golden_of(metadata, str(path)),
        nodes=_without_resets(nodes, tensors),
        tensors=tensors,
        outputs=names,
    )


def _node(proto: onnx.NodeProto) -> Node:
    """An operator as the C form needs it."""
    attributes = {}
    for one in proto.attribute:
        value = helper.get_attribute_value(one)
        if one.name == "nodes_modes":
            value = [mode == BRANCH for mode in value]
        is_list = isinstance(value, list)
        attributes[one.name] = (
            np.array(value, _LIST_TYPES[one.type]) if is_list else value
        )
    return Node(proto.op_type, tuple(proto.input), tuple(proto.output), attributes)


def _without_resets(
    nodes: tuple[Node, ...], tensors: dict[str, Tensor]
) -> tuple[Node, ...]:
    """Nodes without each Where of a constant condition: its readers read what it chooses."""
    chosen: dict[str, str] = {}
    kept = []

    for node in nodes:
        inputs = tuple(chosen.get(name, name) for name in node.inputs)
        node = replace(node, inputs=inputs)
        if node.op_type != "Where":
            kept.append(node)
            continue

        # `reset` is a constant here: the Where that clears the state chooses the state.
        condition = tensors[inputs[0]].values
        if condition is None or condition.size != 1:
            kept.append(node)
        else:
            chosen[node.outputs[0]] = inputs[1] if condition.all() else inputs[2]

    return tuple(kept)


BRANCH = b"BRANCH_LEQ"
"""What a node of a tree is: this, or LEAF."""
_LIST_TYPES: dict[int, type[np.generic]] = {
    onnx.AttributeProto.FLOATS: np.float32,
    onnx.AttributeProto.INTS: np.int64,
    onnx.AttributeProto.STRINGS: np.bool_,
}
"""Of a list, by its type: the only texts are those of `nodes_modes`, which become flags."""


def shapes_of(graph: onnx.GraphProto, nodes: tuple[Node, ...]) -> dict[str, Tensor]:
    """Every tensor by its name, for a batch of one. Raises NotCompilable."""
    constants = {one.name: numpy_helper.to_array(one) for one in graph.initializer}
    arrays: dict[str, Array] = dict(constants)

    # ones, because a division by zeros would warn
    for declared in graph.input:
        tensor = declared.type.tensor_type
        # the batch is a word
        shape = [one.dim_value or 1 for one in tensor.shape.dim]
        arrays[declared.name] = np.ones(shape, DTYPES[tensor.elem_type])

    for node in nodes:
        try:
            inputs = [arrays[name] for name in node.inputs]
            made = _RULES.get(node.op_type, _arithmetic)(node, *inputs)
        except (ArithmeticError, LookupError, TypeError, ValueError) as error:
            raise refusal(node, f"its inputs do not fit ({error!s:.80})") from None

        outputs = made if isinstance(made, list) else [made]
        arrays.update(zip(node.outputs, outputs, strict=True))

    tensors = {}
    for name, array in arrays.items():
        values = constants.get(name)
        tensors[name] = Tensor(ELEMENTS[array.dtype], array.shape, values)

    return tensors


def _like_first(node: Node, first: Array, *others: Array) -> Array:
    """Of the first input's shape and type."""
    return first


def _arithmetic(node: Node, *inputs: Array) -> Array:
    """Numbers by numbers, element by element: of the first input's type."""
    shape = np.broadcast_shapes(*(one.shape for one in inputs))
    return np.ones(shape, inputs[0].dtype)


def _flags(node: Node, *inputs: Array) -> Array:
    """Comparisons: flags, whatever is compared."""
    return _arithmetic(node, *inputs).astype(np.bool_)


def _where(node: Node, condition: Array, *chosen: Array) -> Array:
    """Of the type of what is chosen; the condition only widens the shape."""
    return _arithmetic(node, *chosen, condition)


def _cast(node: Node, values: Array) -> Array:
    return values.astype(DTYPES[node.attributes["to"]])


def _concat(node: Node, *inputs: Array) -> Array:
    return np.concatenate(inputs, axis=node.attributes["axis"])


def _split(node: Node, values: Array, sizes: Array) -> list[Array]:
    axis = node.attributes.get("axis", 0)
    # numpy takes where parts begin, ONNX how long they are
    starts = np.cumsum(sizes)[:-1].tolist()
    return np.split(values, starts, axis=axis)


def _slice(
    node: Node, values: Array, starts: Array, stops: Array, axes: Array
) -> Array:
    """A part along some axes; an export writes no negative starts and no steps."""
    parts = [slice(None)] * values.ndim
    for start, stop, axis in zip(starts, stops, axes, strict=True):
        parts[axis] = slice(start, stop)
    return values[tuple(parts)]


def _gather(node: Node, table: Array, indices: Array) -> Array:
    axis = node.attributes.get("axis", 0)
    # the ones of the dry run are places in a table too, and may lie beyond its end
    return np.take(table, indices, axis=axis, mode="clip")


def _reshape(node: Node, values: Array, target: Array) -> Array:
    # a 0 in the target keeps the dimension that the input has there
    shape = [size or values.shape[k] for k, size in enumerate(target.tolist())]
    return values.reshape(shape)


def _flatten(node: Node, values: Array) -> Array:
    """A matrix: what stands before the axis are its rows."""
    axis = node.attributes.get("axis", 1)
    rows = int(np.prod(values.shape[:axis]))
    return values.reshape(rows, -1)


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
    """Votes of every row for every class."""
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
