"""Operators that move numbers (join, cut, choose, turn round) and those that reduce an axis."""

from __future__ import annotations

import math

from holdfast.export.c.graph import Node, Shape, refusal
from holdfast.export.c.literals import C_TYPES
from holdfast.export.c.memory import parts_of, strides
from holdfast.export.c.writer import Writer, axes_of, counted, index, nested

TAKES = {
    "ReduceMax": "{x} > {y} ? {x} : {y}",
    "ReduceMin": "{x} < {y} ? {x} : {y}",
    "ReduceSum": "{y} + {x}",
    "ReduceL2": "{y} + {x} * {x}",
}
"""Reduction -> how a number x changes the result y so far."""
SUMS = ("ReduceSum", "ReduceL2")
"""Reductions that begin with 0; the others begin with the first number."""


def write_concat(node: Node, writer: Writer) -> list[str]:
    """All inputs one after another along one axis, block by block."""
    out = writer.name(node.outputs[0])
    shape = writer.graph.shape(node.outputs[0])

    # Before the axis, the inputs lie in as many blocks as the output; behind it, each is one copy.
    blocks = math.prod(shape[: node.axis])
    row = math.prod(shape[node.axis :])
    lines = []
    at = 0
    for name in node.inputs:
        size = math.prod(writer.graph.shape(name)[node.axis :])
        target = f"{out} + {index((row, 'i', blocks), first=at)}"
        source = f"{writer.name(name)} + {index((size, 'i', blocks))}"
        lines.append(f"memcpy({target}, {source}, {size} * sizeof *{out});")
        at += size

    return counted("i", blocks, lines)


def write_gather(node: Node, writer: Writer) -> list[str]:
    """Constant rows along one axis, by a table of places."""
    x = writer.name(node.inputs[0])
    out = writer.name(node.outputs[0])
    shape = writer.graph.shape(node.inputs[0])
    blocks = math.prod(shape[: node.axis])
    size = math.prod(shape[node.axis + 1 :])

    places = writer.graph.constant(node.inputs[1], node)
    n = places.size
    # places are read at every sample: short ones leave more of the cache to the trees
    c_type = "uint16_t" if shape[node.axis] < 2**16 else "int32_t"
    table = writer.tables.add(f"hf_{out}_places", places, c_type)
    chosen = f"{table}[{index((1, 'j', n))}]"

    along = (1, "k", size)
    # the 2 stands for a loop of more than one pass: a chosen row is read even where n is 1
    source = index((shape[node.axis] * size, "i", blocks), (size, chosen, 2), along)
    target = index((n * size, "i", blocks), (size, "j", n), along)
    row = counted("k", size, [f"{out}[{target}] = {x}[{source}];"])
    return counted("i", blocks, counted("j", n, row))


def write_parts(node: Node, writer: Writer) -> list[str]:
    """Parts (Slice, Split) that are not one block of memory each."""
    step = strides(writer.graph.shape(node.inputs[0]))
    lines = []
    for name, first in parts_of(node, writer.graph):
        # a part that no step reads is not copied
        if writer.memory.is_kept(name):
            lines += _strided(node, name, step, first, writer)
    return lines


def write_transpose(node: Node, writer: Writer) -> list[str]:
    """The axes in another order."""
    step = strides(writer.graph.shape(node.inputs[0]))
    # axis k of the output is axis order[k] of the input
    turned = tuple(step[axis] for axis in node.attributes["perm"])
    return _strided(node, node.outputs[0], turned, 0, writer)


def _strided(
    node: Node, output: str, step: Shape, first: int, writer: Writer
) -> list[str]:
    """A copy whose source moves on by `step` along each axis of the output."""
    shape = writer.graph.shape(output)
    out_step = strides(shape)
    to = []
    source = []
    for counter, axis in axes_of(shape, node):
        to.append((out_step[axis], counter, shape[axis]))
        source.append((step[axis], counter, shape[axis]))
    given = writer.read(node.inputs[0], index(*source, first=first))
    return nested(shape, node, [f"{writer.read(output, index(*to))} = {given};"])


def write_reduction(node: Node, writer: Writer) -> list[str]:
    """Over neighbouring axes: `outer` blocks of `n` rows of `inner` numbers become one row each."""
    graph = writer.graph
    (out,) = node.outputs
    shape = graph.shape(node.inputs[0])
    axes = sorted(graph.constant(node.inputs[1], node).tolist())
    first, end = axes[0], axes[-1] + 1
    if axes != list(range(first, end)):
        raise refusal(node, "its axes are not neighbours")

    outer = math.prod(shape[:first])
    n = math.prod(shape[first:end])
    inner = math.prod(shape[end:])
    # the terms of a place in memory: the block, the row in it, the number in the row
    block = (n * inner, "i", outer)
    along = (1, "j", inner)
    x = writer.read(node.inputs[0], index(block, (inner, "k", n), along))
    target = writer.read(out, index((inner, "i", outer), along))

    # an extreme begins with the first row, and its loop with the second
    is_sum = node.op_type in SUMS
    begin = "0" if is_sum else writer.read(node.inputs[0], index(block, along))
    lines = counted("j", inner, [f"{target} = {begin};"])

    # row after row, so that a sum adds its terms in the order of memory
    if n > 1 or is_sum:
        taken = TAKES[node.op_type].format(x=x, y=target)
        # C computes with small integers as int: the cast states the type that is kept
        take = f"{target} = ({C_TYPES[graph.element(out)]})({taken});"
        row = counted("j", inner, [take])
        lines += counted("k", n, row, first=0 if is_sum else 1)

    # The loop above has added up squares: the root of each sum is taken once, at the end.
    if node.op_type == "ReduceL2":
        lines += counted("j", inner, [f"{target} = sqrt({target});"])

    return counted("i", outer, lines)


def write_arg_max(node: Node, writer: Writer) -> list[str]:
    """The place of the largest; of equal ones the last, where the graph asks for it."""
    n = writer.graph.shape(node.inputs[0])[-1]
    # classes are ordered by risk: the last of equal ones is the riskier
    takes_last = node.attributes.get("select_last_index", 0)
    beats = ">=" if takes_last else ">"
    other = writer.read(node.inputs[0], "k")
    best = writer.read(node.inputs[0], "best")
    body = counted("k", n, [f"best = {other} {beats} {best} ? k : best;"], first=1)
    return ["int best = 0;", *body, f"{writer.name(node.outputs[0])}[0] = best;"]


def write_softmax(node: Node, writer: Writer) -> list[str]:
    """Probabilities of one row."""
    x = writer.name(node.inputs[0])
    out = writer.name(node.outputs[0])
    n = writer.graph.shape(node.inputs[0])[-1]
    # The helper uses the C form's own exponential, because libm's differs between systems.
    return [f"hf_softmax({x}, {out}, {n});"]
