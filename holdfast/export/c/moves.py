"""Operators that move numbers (join, cut, choose, turn round) and those that reduce an axis."""

from __future__ import annotations

import math

import numpy as np

from holdfast.edge_runtime.onnx_bytes import DOUBLE, FLOAT, Node
from holdfast.export.c.graph import refusal
from holdfast.export.c.literals import C_TYPES
from holdfast.export.c.plan import slice_offset, split_axis, strides
from holdfast.export.c.writer import Writer, counted, index

VARIABLES = ("i", "j", "k")
TAKES = {
    "ReduceMax": "{x} > {y} ? {x} : {y}",
    "ReduceMin": "{x} < {y} ? {x} : {y}",
    "ReduceSum": "{y} + {x}",
    "ReduceL2": "{y} + {x} * {x}",
}
SUMS = ("ReduceSum", "ReduceL2")


def write_concat(node: Node, writer: Writer) -> list[str]:
    """All inputs one after another along one axis, block by block."""
    axis = split_axis(node)
    out = writer.name(node.outputs[0])
    shape = writer.graph.shape(node.outputs[0])
    blocks = math.prod(shape[:axis])
    row = math.prod(shape[axis:])
    lines = []
    at = 0
    for name in node.inputs:
        if writer.is_constant(name):
            raise refusal(node, "an input is constant")
        size = math.prod(writer.graph.shape(name)[axis:])
        target = f"{out} + {index((row, 'i', blocks), first=at)}"
        source = f"{writer.name(name)} + {index((size, 'i', blocks))}"
        lines.append(f"memcpy({target}, {source}, {size} * sizeof *{out});")
        at += size

    return counted("i", blocks, lines)


def write_gather(node: Node, writer: Writer) -> list[str]:
    """Constant rows along one axis, by a table of places."""
    if writer.is_constant(node.inputs[0]):
        raise refusal(node, "a constant is chosen from")
    x = writer.name(node.inputs[0])
    out = writer.name(node.outputs[0])
    shape = writer.graph.shape(node.inputs[0])
    axis = split_axis(node)
    blocks = math.prod(shape[:axis])
    size = math.prod(shape[axis + 1 :])
    places = writer.graph.constant(node.inputs[1], node)
    n = places.size
    chosen = str(int(places.ravel()[0]))
    if n > 1:
        # places are read at every sample: short ones leave more of the cache to the trees
        c_type = "uint16_t" if shape[axis] < 2**16 else "int32_t"
        chosen = writer.tables.add(f"hf_{out}_places", places, c_type) + "[j]"
    along = (1, "k", size)
    source = index((shape[axis] * size, "i", blocks), (size, chosen, 2), along)
    target = index((n * size, "i", blocks), (size, "j", n), along)
    copied = counted("k", size, [f"{out}[{target}] = {x}[{source}];"])
    return counted("i", blocks, counted("j", n, copied))


def write_slice(node: Node, writer: Writer) -> list[str]:
    """A part that is not one block of memory."""
    step = strides(writer.graph.shape(node.inputs[0]))
    first = slice_offset(node, writer.graph)
    return _strided(node, node.outputs[0], step, first, writer)


def write_split(node: Node, writer: Writer) -> list[str]:
    """Parts that are not one block of memory each."""
    step = strides(writer.graph.shape(node.inputs[0]))
    axis = split_axis(node)
    lines = []
    at = 0
    for name in node.outputs:
        if writer.memory.is_kept(name):
            lines += _strided(node, name, step, at * step[axis], writer)
        at += writer.graph.shape(name)[axis]
    return lines


def write_transpose(node: Node, writer: Writer) -> list[str]:
    """The axes in another order."""
    order = np.asarray(node.attributes["perm"]).tolist()
    step = strides(writer.graph.shape(node.inputs[0]))
    turned = tuple(step[axis] for axis in order)
    return _strided(node, node.outputs[0], turned, 0, writer)


def _strided(
    node: Node, output: str, step: tuple[int, ...], first: int, writer: Writer
) -> list[str]:
    """A copy whose source moves on by `step` along each axis of the output."""
    shape = writer.graph.shape(output)
    axes = [axis for axis, size in enumerate(shape) if size > 1]
    if len(axes) > len(VARIABLES):
        raise refusal(node, "it has too many dimensions")
    out_step = strides(shape)
    to = []
    source = []
    for variable, axis in zip(VARIABLES, axes, strict=False):
        to.append((out_step[axis], variable, 2))
        source.append((step[axis], variable, 2))

    x = writer.name(node.inputs[0])
    out = writer.name(output)
    lines = [f"{out}[{index(*to)}] = {x}[{index(*source, first=first)}];"]
    for k in reversed(range(len(axes))):
        lines = counted(VARIABLES[k], shape[axes[k]], lines)

    return lines


def write_reduction(node: Node, writer: Writer) -> list[str]:
    """Over neighbouring axes: `outer` blocks of `n` rows of `inner` numbers become one row each."""
    graph = writer.graph
    (out,) = node.outputs
    shape = graph.shape(node.inputs[0])
    axes = sorted(graph.constant(node.inputs[1], node).tolist())
    first = axes[0]
    end = axes[-1] + 1
    if axes != list(range(first, end)):
        raise refusal(node, "its axes are not neighbours")
    outer = math.prod(shape[:first])
    n = math.prod(shape[first:end])
    inner = math.prod(shape[end:])
    block = (n * inner, "i", outer)
    along = (1, "j", inner)
    x = writer.read(node.inputs[0], index(block, (inner, "k", n), along))
    target = f"{writer.name(out)}[{index((inner, 'i', outer), along)}]"
    sums = node.op_type in SUMS
    # an extreme begins with the first row, so the loop below starts with the second
    begin = "0" if sums else writer.read(node.inputs[0], index(block, along))
    lines = counted("j", inner, [f"{target} = {begin};"])
    if n > 1 or sums:
        taken = TAKES[node.op_type].format(x=x, y=target)
        take = f"{target} = ({C_TYPES[graph.element(out)]})({taken});"
        row = counted("j", inner, [take])
        lines += counted("k", n, row, first=0 if sums else 1)
    if node.op_type == "ReduceL2":
        if graph.element(out) != DOUBLE:
            raise refusal(node, "it has no C form for its type")
        lines += counted("j", inner, [f"{target} = sqrt({target});"])
    return counted("i", outer, lines)


def write_arg_max(node: Node, writer: Writer) -> list[str]:
    """The place of the largest; of equal ones the last, where the graph asks for it."""
    out = writer.name(node.outputs[0])
    n = writer.graph.shape(node.inputs[0])[-1]
    beats = ">=" if node.attributes.get("select_last_index", 0) else ">"
    other = writer.read(node.inputs[0], "k")
    best = writer.read(node.inputs[0], "best")
    body = counted("k", n, [f"best = {other} {beats} {best} ? k : best;"], first=1)
    return ["int best = 0;", *body, f"{out}[0] = best;"]


def write_softmax(node: Node, writer: Writer) -> list[str]:
    """Probabilities of one row."""
    if writer.graph.element(node.inputs[0]) != FLOAT:
        raise refusal(node, "it has no C form for its type")
    x = writer.name(node.inputs[0])
    out = writer.name(node.outputs[0])
    return [f"hf_softmax({x}, {out}, {writer.graph.shape(node.inputs[0])[-1]});"]
