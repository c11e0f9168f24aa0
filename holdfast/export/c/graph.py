"""The typed graph of a sealed file, for one sample: nodes, shapes, element types and constants."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import read_model
from holdfast.edge_runtime.model_file import SEAL_KEY, ModelCard, read_sealed
from holdfast.edge_runtime.onnx_bytes import BOOL, Node
from holdfast.export.c.shapes import Tensor, refusal, shapes_of

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


def read_graph(path: str | Path) -> Graph:
    """The graph of a sealed file, all checks passed. Raises a ModelError."""
    data = read_sealed(path)
    card, golden, model = read_model(data, path)
    model = replace(model, nodes=tuple(map(decoded, model.nodes)))
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


FLOAT_LISTS = ("nodes_values", "target_weights")
BRANCH = b"BRANCH_LEQ"
"""What a node of a tree is: this, or LEAF."""


def decoded(node: Node) -> Node:
    """The node with its lists as arrays; `nodes_modes` says which nodes are branches."""
    attributes = dict(node.attributes)
    lists = [name for name in attributes if name.startswith(("nodes_", "target_"))]
    if node.op_type == "Transpose":
        lists.append("perm")
    for name in lists:
        data = attributes[name]
        if name in FLOAT_LISTS:
            attributes[name] = _floats(data)
        elif name == "nodes_modes":
            attributes[name] = _are_branches(data)
        else:
            attributes[name] = _whole_numbers(data)
    return replace(node, attributes=attributes)


def _floats(data: bytes) -> npt.NDArray[np.float32]:
    """Four bytes each, behind a tag of one byte."""
    raw = np.frombuffer(data, np.uint8).reshape(-1, 5)
    return np.ascontiguousarray(raw[:, 1:]).view("<f4").ravel()


def _whole_numbers(data: bytes) -> npt.NDArray[np.int64]:
    """Seven bits a byte, the lowest first, each number behind a tag of one byte."""
    raw = np.frombuffer(data, np.uint8)
    # the last byte of a tag and of a number is below 128: every second one ends a number
    last = np.flatnonzero(raw < 0x80)
    tags, ends = last[::2], last[1::2]
    values = np.zeros(len(ends), dtype=np.int64)
    for k in range(int((ends - tags).max(initial=0))):
        here = tags + 1 + k <= ends
        values[here] |= (raw[tags[here] + 1 + k] & 0x7F).astype(np.int64) << (7 * k)
    return values


def _are_branches(data: bytes) -> npt.NDArray[np.bool_]:
    """Words behind a tag and a length of one byte each; the tag, J, is in neither word."""
    raw = np.frombuffer(data, np.uint8)
    lengths = raw[np.flatnonzero(raw == ord("J")) + 1]
    return np.asarray(lengths == len(BRANCH))
