"""Tensors that lie in another one's memory: parts of the state, and other shapes of one row."""

from __future__ import annotations

import math
from dataclasses import dataclass

from holdfast.edge_runtime.onnx_bytes import Node
from holdfast.export.c.graph import Graph, Shape


@dataclass(frozen=True)
class View:
    """A tensor that begins `offset` numbers into the memory of another one."""

    base: str
    offset: int = 0


def views_of(graph: Graph) -> dict[str, View]:
    """Every tensor that needs no memory of its own, by name; bases are never views."""
    views: dict[str, View] = {}
    for node in graph.nodes:
        for name, offset in _contiguous(node, graph):
            first = views.get(node.inputs[0], View(node.inputs[0]))
            views[name] = View(first.base, first.offset + offset)
    return views


def _contiguous(node: Node, graph: Graph) -> list[tuple[str, int]]:
    """(output, where it begins) of a node that only names a part of its first input."""
    if node.op_type in ("Reshape", "Flatten"):
        return [(node.outputs[0], 0)]
    if node.op_type == "Split":
        return _parts(node, graph)
    if node.op_type == "Slice":
        offset = _slice_offset(node, graph)
        return [] if offset is None else [(node.outputs[0], offset)]
    return []


def _parts(node: Node, graph: Graph) -> list[tuple[str, int]]:
    shape, axis = graph.shape(node.inputs[0]), split_axis(node)
    if math.prod(shape[:axis]) != 1:
        return []
    sizes = [math.prod(graph.shape(name)) for name in node.outputs]
    return [(name, sum(sizes[:k])) for k, name in enumerate(node.outputs)]


def split_axis(node: Node) -> int:
    """The attribute `axis`."""
    axis = node.attributes.get("axis", 0)
    assert isinstance(axis, int)
    return axis


def _slice_offset(node: Node, graph: Graph) -> int | None:
    """Where a Slice begins, if it is one block: only its first axis longer than 1 is cut."""
    whole, part = graph.shape(node.inputs[0]), graph.shape(node.outputs[0])
    cut = [axis for axis, size in enumerate(whole) if part[axis] != size]
    if any(math.prod(part[:axis]) != 1 for axis in cut):
        return None
    return sum(
        start * strides(whole)[axis]
        for axis, start in slice_starts(node, graph).items()
    )


def slice_starts(node: Node, graph: Graph) -> dict[int, int]:
    """Axis -> first index."""
    starts, _, axes = (graph.constant(name, node).tolist() for name in node.inputs[1:])
    return dict(zip(axes, starts, strict=True))


def strides(shape: Shape) -> tuple[int, ...]:
    """How far apart neighbours along each axis are, in numbers.

    >>> strides((1, 7, 18))
    (126, 18, 1)
    """
    return tuple(math.prod(shape[axis + 1 :]) for axis in range(len(shape)))
