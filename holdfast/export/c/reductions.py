"""Operators that reduce an axis: sums, extremes, the largest class, probabilities."""

from __future__ import annotations

import math

from holdfast.edge_runtime.onnx_bytes import DOUBLE, FLOAT, Node
from holdfast.export.c.graph import refusal
from holdfast.export.c.literals import C_TYPES
from holdfast.export.c.writer import Writer, counted, index

TAKES = {
    "ReduceMax": "{x} > {y} ? {x} : {y}",
    "ReduceMin": "{x} < {y} ? {x} : {y}",
    "ReduceSum": "{y} + {x}",
    "ReduceL2": "{y} + {x} * {x}",
}


def write_reduction(node: Node, writer: Writer) -> list[str]:
    """Over neighbouring axes: `outer` blocks of `n` rows of `inner` numbers become one row each."""
    graph, (out,) = writer.graph, node.outputs
    shape = graph.shape(node.inputs[0])
    axes = sorted(graph.constant(node.inputs[1], node).tolist())
    if axes != list(range(axes[0], axes[-1] + 1)):
        raise refusal(node, "its axes are not neighbours")
    outer, n = math.prod(shape[: axes[0]]), math.prod(shape[axes[0] : axes[-1] + 1])
    inner = math.prod(shape[axes[-1] + 1 :])
    c_type, sums = (
        C_TYPES[graph.element(out)],
        node.op_type in ("ReduceSum", "ReduceL2"),
    )
    around = ((n * inner, "i", outer), (1, "j", inner))
    x = writer.read(node.inputs[0], index(around[0], (inner, "k", n), around[1]))
    target = f"{writer.name(out)}[{index((inner, 'i', outer), around[1])}]"
    begin = "0" if sums else writer.read(node.inputs[0], index(*around))
    taken = TAKES[node.op_type].format(x=x, y=target)
    lines = counted("j", inner, [f"{target} = {begin};"])
    rows = counted("j", inner, [f"{target} = ({c_type})({taken});"])
    lines += counted("k", n, rows, first=0 if sums else 1) if n > 1 or sums else []
    if node.op_type == "ReduceL2":
        if graph.element(out) != DOUBLE:
            raise refusal(node, "it has no C form for its type")
        lines += counted("j", inner, [f"{target} = sqrt({target});"])
    return counted("i", outer, lines)


def write_arg_max(node: Node, writer: Writer) -> list[str]:
    """The place of the largest; of equal ones the last, where the graph says so."""
    out, n = writer.name(node.outputs[0]), writer.graph.shape(node.inputs[0])[-1]
    beats = ">=" if node.attributes.get("select_last_index", 0) else ">"
    other, best = writer.read(node.inputs[0], "k"), writer.read(node.inputs[0], "best")
    body = counted("k", n, [f"best = {other} {beats} {best} ? k : best;"], first=1)
    return ["int best = 0;", *body, f"{out}[0] = best;"]


def write_softmax(node: Node, writer: Writer) -> list[str]:
    """Probabilities of one row."""
    if writer.graph.element(node.inputs[0]) != FLOAT:
        raise refusal(node, "it has no C form for its type")
    x, out = writer.name(node.inputs[0]), writer.name(node.outputs[0])
    return [f"hf_softmax({x}, {out}, {writer.graph.shape(node.inputs[0])[-1]});"]
