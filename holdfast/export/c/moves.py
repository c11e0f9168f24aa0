"""Operators that only move numbers: join, cut, choose rows, and turn axes round."""

from __future__ import annotations

import math

import numpy as np

from holdfast.edge_runtime.onnx_bytes import Node
from holdfast.export.c.graph import Shape, refusal
from holdfast.export.c.views import slice_starts, split_axis, strides
from holdfast.export.c.writer import Writer, counted, index

VARIABLES = ("i", "j", "k")


def write_concat(node: Node, writer: Writer) -> list[str]:
    """All inputs side by side along one axis, block by block."""
    axis, out = split_axis(node), writer.name(node.outputs[0])
    whole = writer.graph.shape(node.outputs[0])
    blocks, row = math.prod(whole[:axis]), math.prod(whole[axis:])
    lines, at = [], 0
    for name in node.inputs:
        if writer.is_constant(name):
            raise refusal(node, "an input is constant")
        size = math.prod(writer.graph.shape(name)[axis:])
        lines.append(_copied(writer, name, out, (blocks, row, at, size)))
        at += size
    return counted("i", blocks, lines)


def _copied(
    writer: Writer, name: str, out: str, where: tuple[int, int, int, int]
) -> str:
    """A copy of one input's part of one block. where: blocks, their size, place, size of part."""
    blocks, row, at, size = where
    source = writer.name(name)
    to, begin = index((row, "i", blocks), first=at), index((size, "i", blocks))
    return f"memcpy({out} + {to}, {source} + {begin}, {size} * sizeof *{out});"


def write_gather(node: Node, writer: Writer) -> list[str]:
    """Constant rows along one axis, by a table of places."""
    places = writer.graph.constant(node.inputs[1], node)
    shape, axis = writer.graph.shape(node.inputs[0]), split_axis(node)
    if writer.is_constant(node.inputs[0]):
        raise refusal(node, "a constant is chosen from")
    blocks, size = math.prod(shape[:axis]), math.prod(shape[axis + 1 :])
    x, out, n = writer.name(node.inputs[0]), writer.name(node.outputs[0]), places.size
    chosen = str(int(places.ravel()[0]))
    if n > 1:
        c_type = "uint16_t" if shape[axis] < 2**16 else "int32_t"
        chosen = writer.tables.add(f"hf_{out}_places", places, c_type) + "[j]"
    outer, inner = (shape[axis] * size, "i", blocks), (1, "k", size)
    source = f"{x}[{index(outer, (size, chosen, 2), inner)}]"
    target = f"{out}[{index((n * size, 'i', blocks), (size, 'j', n), inner)}]"
    body = counted("j", n, counted("k", size, [f"{target} = {source};"]))
    return counted("i", blocks, body)


def write_slice(node: Node, writer: Writer) -> list[str]:
    """A part that is not one block of memory."""
    step = strides(writer.graph.shape(node.inputs[0]))
    first = sum(
        start * step[axis] for axis, start in slice_starts(node, writer.graph).items()
    )
    return _strided(node, 0, step, first, writer)


def write_split(node: Node, writer: Writer) -> list[str]:
    """Parts that are not one block of memory each."""
    step, axis = strides(writer.graph.shape(node.inputs[0])), split_axis(node)
    lines, at = [], 0
    for number, name in enumerate(node.outputs):
        if writer.memory.is_kept(name):
            lines += _strided(node, number, step, at * step[axis], writer)
        at += writer.graph.shape(name)[axis]
    return lines


def write_transpose(node: Node, writer: Writer) -> list[str]:
    """The axes in another order."""
    order = np.asarray(node.attributes["perm"]).tolist()
    step = strides(writer.graph.shape(node.inputs[0]))
    return _strided(node, 0, tuple(step[axis] for axis in order), 0, writer)


def _strided(
    node: Node, output: int, step: tuple[int, ...], first: int, writer: Writer
) -> list[str]:
    """A copy whose source moves on by `step` along each axis of the output."""
    shape: Shape = writer.graph.shape(node.outputs[output])
    axes = [axis for axis, size in enumerate(shape) if size > 1]
    if len(axes) > len(VARIABLES):
        raise refusal(node, "it has too many dimensions")
    pairs = list(zip(VARIABLES, axes, strict=False))
    target, source = (
        index(*((by[axis], variable, 2) for variable, axis in pairs), first=begin)
        for by, begin in ((strides(shape), 0), (step, first))
    )
    x, out = writer.name(node.inputs[0]), writer.name(node.outputs[output])
    body = [f"{out}[{target}] = {x}[{source}];"]
    for variable, axis in reversed(pairs):
        body = counted(variable, shape[axis], body)
    return body
