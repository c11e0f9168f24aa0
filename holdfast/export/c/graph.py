"""The typed graph of a sealed file, for one sample: nodes, shapes, element types and constants."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import NotCompilable
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import read_model
from holdfast.edge_runtime.model_file import SEAL_KEY, ModelCard, read_sealed
from holdfast.edge_runtime.onnx_bytes import BOOL, Node, read_onnx
from holdfast.edge_runtime.onnx_shapes import shapes_of
from holdfast.edge_runtime.onnx_tensors import Tensor

INPUTS = ("sample", "valid", "state")
"""Tensors that the caller of a step owns."""
FEATURES, NEXT_STATE = "features", "state_out"
Shape = tuple[int, ...]


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
        """F."""
        return self.shape(FEATURES)[1]


def refusal(node: Node, what: str) -> NotCompilable:
    """The error for an operator that has no C form."""
    return NotCompilable(
        f"operator {node.op_type} for {node.outputs[0][:40]}: {what}",
        cause="a model made by another version of Holdfast",
        next_step="export the model again with this version, or run the ONNX file",
    )


def read_graph(path: str | Path) -> Graph:
    """The graph of a sealed file, all checks passed. Raises a ModelError."""
    data = read_sealed(path)
    card, golden = read_model(data, path)
    model = read_onnx(data)
    tensors = shapes_of(model)
    # a fresh state is all zero, and holdfast_init makes it: no step has to reset
    tensors["reset"] = Tensor(BOOL, (1, 1, 1), np.zeros((1, 1, 1), dtype=np.bool_))
    nodes = _without_resets(model.nodes, tensors)
    names = tuple(name for name in model.outputs if name not in (FEATURES, NEXT_STATE))
    return Graph(card, model.metadata[SEAL_KEY], golden, nodes, tensors, names)


def _without_resets(
    nodes: tuple[Node, ...], tensors: dict[str, Tensor]
) -> tuple[Node, ...]:
    """Nodes without each Where of a constant condition: its readers read what it chooses."""
    chosen: dict[str, str] = {}
    kept = []
    for node in nodes:
        node = replace(
            node, inputs=tuple(chosen.get(name, name) for name in node.inputs)
        )
        condition = tensors[node.inputs[0]].values if node.op_type == "Where" else None
        if condition is not None and condition.size == 1:
            chosen[node.outputs[0]] = node.inputs[1 if condition.all() else 2]
        else:
            kept.append(node)
    return tuple(kept)
