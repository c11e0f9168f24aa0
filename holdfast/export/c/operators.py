"""One emitter for each operator that stands alone; loops.py has those that go number by number."""

from __future__ import annotations

from collections.abc import Callable

from holdfast.edge_runtime.onnx_bytes import Node
from holdfast.export.c.graph import refusal
from holdfast.export.c.loops import write_loop
from holdfast.export.c.moves import (
    write_concat,
    write_gather,
    write_slice,
    write_split,
    write_transpose,
)
from holdfast.export.c.plan import Step
from holdfast.export.c.products import write_product
from holdfast.export.c.reductions import write_arg_max, write_reduction, write_softmax
from holdfast.export.c.trees import write_trees
from holdfast.export.c.writer import Function, Writer, function

EMITTERS: dict[str, Callable[[Node, Writer], list[str]]] = {
    "ArgMax": write_arg_max,
    "Concat": write_concat,
    "Gather": write_gather,
    "MatMul": write_product,
    "ReduceL2": write_reduction,
    "ReduceMax": write_reduction,
    "ReduceMin": write_reduction,
    "ReduceSum": write_reduction,
    "Slice": write_slice,
    "Softmax": write_softmax,
    "Split": write_split,
    "Transpose": write_transpose,
    "TreeEnsembleRegressor": write_trees,
}


def write_step(step: Step, number: int, writer: Writer) -> Function:
    """The C function of a step. Raises NotCompilable for an operator without a C form."""
    if step.shape is not None:
        return function(step, number, write_loop(step, writer), writer)
    (node,) = step.nodes
    if node.op_type not in EMITTERS:
        raise refusal(node, "it has no C form")
    return function(step, number, EMITTERS[node.op_type](node, writer), writer)
