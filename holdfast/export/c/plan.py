"""The work in the order of the graph, and the tensors that are only views of another's memory.

Parts of the state, and other shapes of one row, need no memory and no work.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from holdfast.export.c.graph import FEATURES, NEXT_STATE, Graph, Node, Shape

BY_NUMBER = frozenset(
    [
        "Abs",
        "Add",
        "And",
        "Cast",
        "Clip",
        "Div",
        "Floor",
        "Greater",
        "GreaterOrEqual",
        "Less",
        "Max",
        "Min",
        "Mul",
        "Round",
        "Sqrt",
        "Sub",
        "Where",
    ]
)
"""Operators that make each number of their output from one number of each input."""


@dataclass(frozen=True)
class View:
    """A tensor that begins `offset` numbers into the memory of another one.

    base: the tensor that has the memory; it is never a view itself.
    """

    base: str
    offset: int = 0


def views_of(graph: Graph) -> dict[str, View]:
    """Every tensor that needs no memory, by name; bases are never views."""
    views: dict[str, View] = {}

    for node in graph.nodes:
        source = node.inputs[0]
        # a view of a view begins in the memory of the last one's base
        first = views.get(source, View(source))
        for name, offset in _contiguous(node, graph):
            views[name] = View(first.base, first.offset + offset)

    return views


def _contiguous(node: Node, graph: Graph) -> list[tuple[str, int]]:
    """(output, where it begins) of a node that only names a part of its first input."""
    if node.op_type in ("Reshape", "Flatten"):
        return [(node.outputs[0], 0)]
    if node.op_type == "Split":
        return _parts(node, graph)
    if node.op_type == "Slice":
        return _block(node, graph)
    return []


def _parts(node: Node, graph: Graph) -> list[tuple[str, int]]:
    """The outputs of a Split along the first axis that is longer than 1."""
    shape = graph.shape(node.inputs[0])
    parts: list[tuple[str, int]] = []
    before_axis = shape[: split_axis(node)]
    # with several rows before the axis, a part is a piece of every row
    if math.prod(before_axis) != 1:
        return parts

    at = 0
    for name in node.outputs:
        parts.append((name, at))
        at += math.prod(graph.shape(name))
    return parts


def split_axis(node: Node) -> int:
    """The attribute `axis`."""
    axis = node.attributes.get("axis", 0)
    assert isinstance(axis, int)
    return axis


def _block(node: Node, graph: Graph) -> list[tuple[str, int]]:
    """The output of a Slice, if it is one block: only its first axis longer than 1 is cut."""
    whole = graph.shape(node.inputs[0])
    part = graph.shape(node.outputs[0])
    for axis, size in enumerate(whole):
        if part[axis] != size and math.prod(part[:axis]) != 1:
            return []
    return [(node.outputs[0], slice_offset(node, graph))]


def slice_offset(node: Node, graph: Graph) -> int:
    """Where a Slice begins in its input, in numbers."""
    starts, _, axes = (graph.constant(name, node).tolist() for name in node.inputs[1:])
    step = strides(graph.shape(node.inputs[0]))

    offset = 0
    for start, axis in zip(starts, axes, strict=True):
        offset += start * step[axis]
    return offset


def strides(shape: Shape) -> tuple[int, ...]:
    """How far apart neighbours along each axis are, in numbers.

    >>> strides((1, 7, 18))
    (126, 18, 1)
    """
    return tuple(math.prod(shape[axis + 1 :]) for axis in range(len(shape)))


@dataclass(frozen=True)
class Step:
    """A node that one C function computes.

    shape: of the loop that computes it number by number, without ones. None: no such loop.
    """

    node: Node
    shape: Shape | None = None


@dataclass(frozen=True)
class Plan:
    """Steps up to the features, the node that joins the next state, steps from the features on."""

    sense: list[Step]
    keep: Node
    answer: list[Step]


def plan_of(graph: Graph, views: dict[str, View]) -> Plan:
    """Cut the graph at its features; what follows them is a function of them alone."""
    # Nodes stand in the order in which they can run, so one pass over them is enough.
    behind = {FEATURES}
    sense: list[Step] = []
    answer: list[Step] = []
    (keep,) = [node for node in graph.nodes if NEXT_STATE in node.outputs]

    for node in graph.nodes:
        is_view = any(name in views for name in node.outputs)
        if is_view or node is keep:
            # the other inputs of a view are constants: where it begins, and its shape
            is_behind = node.inputs[0] in behind
        else:
            is_behind = any(name in behind for name in node.inputs)
            order = answer if is_behind else sense
            order.append(Step(node, _loop_shape(node, graph)))
        if is_behind:
            behind.update(node.outputs)

    return Plan(sense, keep, answer)


def _loop_shape(node: Node, graph: Graph) -> Shape | None:
    """The shape of the loop that a node belongs to; None where it stands alone."""
    is_table = node.op_type == "Gather" and graph.values(node.inputs[1]) is None
    if node.op_type not in BY_NUMBER and not is_table:
        return None
    return without_ones(graph.shape(node.outputs[0]))


def without_ones(shape: Shape) -> Shape:
    """The dimensions that have more than one number."""
    return tuple(size for size in shape if size != 1)
