"""A small builder for ONNX graphs with explicit state.

A part of the graph declares the state it needs with `state(name, rows)`, which returns the value
after the previous sample, and sets the next one with `keep(name, value)`. All state is one table
[B, rows, C]; a field is some of its rows, and a value that a sensor has once is repeated in its
three columns. Rows are contiguous in memory, so splitting and joining the table copies a few long
blocks. A set `reset` flag makes the whole table of a recording zero before anything reads it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 20
IR_VERSION = 10
"""Operator set and IR read by every onnxruntime from 1.18 on."""

Owner = TypeVar("Owner")
Part = TypeVar("Part")


def added_once(add: Callable[[Owner], Part]) -> Callable[[Owner], Part]:
    """A method that adds a part to the graph when it is first called, and is that part later."""
    key = f"_added_{add.__name__}"

    @wraps(add)
    def part(self: Owner) -> Part:
        added = vars(self)
        if key not in added:
            added[key] = add(self)
        found: Part = added[key]
        return found

    return part


class GraphBuilder:
    """Collects nodes, constants, outputs and state fields, and assembles them into one model."""

    def __init__(self, n_sensors: int, prefix: str = "") -> None:
        """prefix: begins the name of every tensor that it names."""
        self.n_sensors = n_sensors
        self._prefix = prefix
        # nodes in the order in which they are added: the file's bytes depend on it
        self._nodes: list[onnx.NodeProto] = []
        self._constants: dict[tuple[Any, ...], onnx.TensorProto] = {}
        self._outputs: list[onnx.ValueInfoProto] = []
        self._state_rows: dict[str, int] = {}
        self._state_next: dict[str, str] = {}
        self._count = 0

    def node(
        self, op: str, *inputs: str | npt.ArrayLike, out: str = "", **attributes: Any
    ) -> str:
        """Add a node with one output and return the output's name.

        An input is the name of a tensor, or numbers, which become a constant of their type:
        float64 for a float, int64 for a list of whole numbers (shapes, axes, indices).
        """
        made = out or self._fresh(op)
        self._add(op, inputs, [made], attributes)
        return made

    def split(self, tensor: str, sizes: dict[str, int]) -> dict[str, str]:
        """Parts by name, of so many rows each; they share a node, so none has a number."""
        parts = {name: f"{self._prefix}part_{name}" for name in sizes}
        rows = list(sizes.values())
        self._add("Split", (tensor, rows), list(parts.values()), {"axis": 1})
        return parts

    def _add(
        self,
        op: str,
        inputs: tuple[str | npt.ArrayLike, ...],
        outs: list[str],
        attributes: dict[str, Any],
    ) -> None:
        made = helper.make_node(op, self._named(inputs), outs, **attributes)
        self._nodes.append(made)

    def _named(self, inputs: tuple[str | npt.ArrayLike, ...]) -> list[str]:
        """Inputs as names of tensors; numbers become constants."""
        names = []
        for given in inputs:
            if isinstance(given, str):
                names.append(given)
            else:
                dtype = np.asarray(given).dtype
                names.append(self.constant(given, dtype))
        return names

    def constant(self, value: npt.ArrayLike, dtype: npt.DTypeLike = np.float64) -> str:
        """A constant tensor; equal ones are stored once."""
        array = np.array(value, dtype=dtype)
        # compared as bytes: 0.0 and -0.0 are two constants
        key = (array.dtype.str, array.shape, array.tobytes())
        if key not in self._constants:
            name = f"{self._prefix}c{len(self._constants)}"
            self._constants[key] = numpy_helper.from_array(array, name)
        return self._constants[key].name

    def copy(self, node: onnx.NodeProto) -> None:
        """Add a node of another graph as it is."""
        self._nodes.append(node)

    def copy_constant(self, tensor: onnx.TensorProto) -> None:
        """Add a constant of another graph as it is, under its own name."""
        self._constants[("copied", tensor.name)] = tensor

    def copy_output(self, value: onnx.ValueInfoProto) -> None:
        """Publish a tensor as another graph does."""
        self._outputs.append(value)

    def reshape(self, tensor: str, *shape: int) -> str:
        """Reshape; 0 copies a dimension, -1 is inferred."""
        return self.node("Reshape", tensor, list(shape))

    def columns(self, tensor: str, start: int, stop: int, axis: int = 1) -> str:
        """tensor[..., start:stop, ...] along one axis."""
        return self.node("Slice", tensor, [start], [stop], [axis])

    def state(self, name: str, rows: int) -> str:
        """Declare a state field [B, rows, C]; returns its value after the previous sample."""
        self._state_rows[name] = rows
        return f"state_{name}"

    def keep(self, name: str, value: str) -> None:
        """Set a state field's next value, [B, rows, C]."""
        self._state_next[name] = value

    def output(self, name: str, element: int, *shape: int) -> None:
        """Publish the tensor of this name, [B, *shape], as a graph output."""
        info = helper.make_tensor_value_info(name, element, ["B", *shape])
        self._outputs.append(info)

    @property
    def n_channels(self) -> int:
        """Channels C = 3 x sensors."""
        return 3 * self.n_sensors

    def part(self) -> tuple[list[onnx.NodeProto], list[onnx.TensorProto]]:
        """Nodes and constants, to be added to another graph."""
        return self._nodes, list(self._constants.values())

    def model(self) -> onnx.ModelProto:
        """Assemble and check the model: unpack state, all nodes, pack state."""
        # first, because joining the next state adds the last node
        state_out = self._pack_state()
        channels: list[str | int] = ["B", 1, self.n_channels]
        sensors: list[str | int] = ["B", 1, self.n_sensors]
        inputs = [
            helper.make_tensor_value_info("sample", TensorProto.DOUBLE, channels),
            helper.make_tensor_value_info("valid", TensorProto.BOOL, sensors),
            helper.make_tensor_value_info("reset", TensorProto.BOOL, ["B", 1, 1]),
            self._table("state"),
        ]

        nodes = self._unpack_state() + self._nodes
        outputs = [*self._outputs, state_out]
        constants = list(self._constants.values())

        graph = helper.make_graph(nodes, "holdfast", inputs, outputs, constants)

        # Trees are no operator of ONNX itself, but of its domain for machine learning.
        opsets = [helper.make_opsetid("", OPSET), helper.make_opsetid("ai.onnx.ml", 3)]
        model = helper.make_model(
            graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="holdfast"
        )

        # a graph that is wrong stops here, not in the runtime of a hand
        onnx.checker.check_model(model, full_check=True)
        return model

    def _unpack_state(self) -> list[onnx.NodeProto]:
        """Nodes in front of all others: clear the state of recordings that reset, then split it."""
        rows = self.constant(list(self._state_rows.values()), np.int64)
        fields = [f"state_{name}" for name in self._state_rows]

        # chosen, not multiplied: NaN x 0 is NaN, and would outlive a reset
        zero = self.constant(0.0)
        return [
            helper.make_node("Where", ["reset", zero, "state"], ["state_before"]),
            helper.make_node("Split", ["state_before", rows], fields, axis=1),
        ]

    def _pack_state(self) -> onnx.ValueInfoProto:
        """Join the next state. Raises ValueError for a field that no part of the graph sets."""
        missing = set(self._state_rows) - set(self._state_next)
        if missing:
            raise ValueError(f"state without a next value: {sorted(missing)}")

        # in the order of the Split, so that a field finds its rows again at the next sample
        following = [self._state_next[name] for name in self._state_rows]
        self.node("Concat", *following, out="state_out", axis=1)
        return self._table("state_out")

    def _table(self, name: str) -> onnx.ValueInfoProto:
        rows = sum(self._state_rows.values())
        shape: list[str | int] = ["B", rows, self.n_channels]
        return helper.make_tensor_value_info(name, TensorProto.DOUBLE, shape)

    def _fresh(self, op: str) -> str:
        self._count += 1
        return f"{self._prefix}{op.lower()}_{self._count}"
