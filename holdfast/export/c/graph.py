"""The typed graph of a sealed file, for one sample: nodes, constants, shapes and element types.

The `onnx` package decodes the file and infers the shapes, with a batch of one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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
INPUTS = ("sample", "valid", "state")
"""Tensors that the caller of a step owns."""
FEATURES = "features"
"""The tensor at which a step is cut: sensing makes it, answering reads nothing else."""
NEXT_STATE = "state_out"
"""The table of state that a step leaves to the next one."""
C_TYPES: dict[int, str] = {
    DOUBLE: "double",
    FLOAT: "float",
    INT32: "int32_t",
    INT64: "int32_t",
    BOOL: "uint8_t",
}
"""Element type -> C type. Whole numbers of a graph are places and counts: 32 bits hold them."""
Shape = tuple[int, ...]


@dataclass(frozen=True)
class Node:
    """One operator; its attributes by name."""

    op_type: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any]

    @property
    def axis(self) -> int:
        return int(self.attributes.get("axis", 0))


@dataclass(frozen=True)
class Tensor:
    """Element type (TensorProto.DataType) and shape; values only for constants.

    shape: for one sample, so its first number is 1 where the graph has a batch.
    """

    element: int
    shape: Shape
    values: npt.NDArray[Any] | None = None


@dataclass(frozen=True)
class Graph:
    """What is compiled. digest: the file's seal. nodes: in order, but for the one that resets.

    tensors: by name, with values where they are constant. golden: the stored answers. outputs: the
    fields of the output struct.
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

    def size(self, name: str) -> int:
        """How many numbers a tensor has, for one sample."""
        return math.prod(self.shape(name))

    def element(self, name: str) -> int:
        """The type of a tensor's elements, by its number in TensorProto.DataType."""
        return self.tensors[name].element

    def c_type(self, name: str) -> str:
        """The C type that a tensor is kept as."""
        return C_TYPES[self.element(name)]

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
    # the caller owns the features and the state: they are no fields of the output struct
    outputs = [one.name for one in model.graph.output]
    return Graph(
        card=read_card(metadata, path),
        digest=metadata[SEAL_KEY],
        golden=golden_of(metadata, str(path)),
        nodes=_nodes(model),
        tensors=_tensors(model),
        outputs=tuple(one for one in outputs if one not in (FEATURES, NEXT_STATE)),
    )


def _nodes(model: onnx.ModelProto) -> tuple[Node, ...]:
    """All operators but the Where that clears the state: holdfast_init makes a fresh one."""
    nodes = []
    chosen: dict[str, str] = {}
    for proto in model.graph.node:
        inputs = tuple(chosen.get(name, name) for name in proto.input)
        if inputs[0] == "reset":
            # its readers read the state itself
            chosen[proto.output[0]] = inputs[2]
            continue
        attributes = {
            one.name: helper.get_attribute_value(one) for one in proto.attribute
        }
        nodes.append(Node(proto.op_type, inputs, tuple(proto.output), attributes))
    return tuple(nodes)


def _tensors(model: onnx.ModelProto) -> dict[str, Tensor]:
    """Every tensor by its name, for a batch of one."""
    for declared in (*model.graph.input, *model.graph.output):
        for size in declared.type.tensor_type.shape.dim:
            # the batch is a word
            size.dim_value = size.dim_value or 1

    inferred = onnx.shape_inference.infer_shapes(model, data_prop=True).graph
    tensors = {}
    for one in (*inferred.input, *inferred.output, *inferred.value_info):
        kind = one.type.tensor_type
        shape = tuple(size.dim_value for size in kind.shape.dim)
        tensors[one.name] = Tensor(kind.elem_type, shape)
    for constant in inferred.initializer:
        values = np.asarray(numpy_helper.to_array(constant))
        tensors[constant.name] = Tensor(constant.data_type, values.shape, values)
    return tensors
