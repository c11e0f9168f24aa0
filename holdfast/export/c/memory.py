"""Where each tensor lies: in the caller's arrays, in the state, or in scratch memory on the stack.

Scratch memory is one array for each C type. A tensor's place is free again after its last reader,
so the stack holds the largest moment, not the sum of all tensors. Parts of another tensor's memory
(other shapes of one row, rows of the state) are views: they need no memory and no work.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.core.contract import IntArray
from holdfast.export.c.graph import Graph, Node, Shape
from holdfast.export.c.literals import BYTES

SCRATCH = {"double": "d", "float": "f", "int32_t": "w", "uint8_t": "b"}
"""The names of the scratch arrays."""


class Place(NamedTuple):
    """Where a tensor begins: in an array of C, or so many numbers into another tensor."""

    base: str
    offset: int = 0


def views_of(graph: Graph) -> dict[str, Place]:
    """Every tensor that needs no memory, by name."""
    views: dict[str, Place] = {}
    for node in graph.nodes:
        given = node.inputs[0]
        whole = views.get(given, Place(given))
        for name, places in moved_places(node, graph).items():
            first = first_of_run(places)
            # an output has memory of its own
            if first is not None and name not in graph.outputs:
                views[name] = Place(whole.base, whole.offset + first)
    return views


def numbered(shape: Shape) -> IntArray:
    """An array of a shape whose numbers are their own places in memory."""
    return np.arange(math.prod(shape)).reshape(shape)


def moved_places(node: Node, graph: Graph) -> dict[str, IntArray]:
    """Outputs of an operator that only moves numbers -> the places of their numbers in the input.

    Empty for an operator that computes, or chooses from a constant. Raises NotCompilable.
    """
    given, *more = node.inputs
    if graph.values(given) is not None:
        return {}
    places = numbered(graph.shape(given))
    parts = [places]
    if node.op_type == "Split":
        ends = np.cumsum(graph.constant(more[0], node))
        parts = np.split(places, ends[:-1], node.axis)
    elif node.op_type == "Slice":
        cut = [slice(None)] * places.ndim
        limits = (graph.constant(one, node) for one in more)
        for start, end, axis in zip(*limits, strict=True):
            cut[axis] = slice(start, end)
        parts = [places[tuple(cut)]]
    elif node.op_type == "Gather":
        parts = [places.take(graph.constant(more[0], node), node.axis)]
    elif node.op_type == "Transpose":
        parts = [places.transpose(node.attributes["perm"])]
    elif node.op_type not in ("Reshape", "Flatten"):
        return {}
    return dict(zip(node.outputs, parts, strict=True))


def first_of_run(places: IntArray) -> int | None:
    """The first of places that follow each other without a gap; None for others."""
    first = int(places.flat[0])
    in_a_row = np.arange(first, first + places.size)
    return first if np.array_equal(places.ravel(), in_a_row) else None


class Memory:
    """The places of all tensors that a list of nodes reads or makes.

    outside: tensor -> array of the caller. sizes: numbers in each scratch array, by C type.
    """

    def __init__(
        self,
        graph: Graph,
        views: dict[str, Place],
        nodes: list[Node],
        outside: dict[str, str],
    ) -> None:
        self._graph = graph
        self._views = views
        self.sizes: dict[str, int] = {}
        self._places = {name: Place(array) for name, array in outside.items()}

        last_reader: dict[str, int] = {}
        for at, node in enumerate(nodes):
            for name in node.inputs:
                last_reader[views.get(name, Place(name)).base] = at

        # of each C type: first number, one past the last, and the last reader of a tensor
        taken: dict[str, list[tuple[int, int, int]]] = {}
        for at, node in enumerate(nodes):
            for name in node.outputs:
                if name in self._places or name not in last_reader:
                    continue
                of_type = taken.setdefault(graph.c_type(name), [])
                # C's `restrict` promises that a node's outputs do not overlap its inputs
                living = [one for one in of_type if one[2] >= at]
                first, end = self._allot(name, living)
                of_type.append((first, end, last_reader[name]))

    def _allot(self, name: str, living: list[tuple[int, int, int]]) -> tuple[int, int]:
        """Give a tensor the first gap between the living ones that is large enough."""
        n = self._graph.size(name)
        first = 0
        for begin, end, _ in sorted(living):
            if begin - first >= n:
                break
            first = max(first, end)

        c_type = self._graph.c_type(name)
        self.sizes[c_type] = max(self.sizes.get(c_type, 0), first + n)
        self._places[name] = Place(SCRATCH[c_type], first)
        return first, first + n

    def is_kept(self, name: str) -> bool:
        """Whether a later node, or the caller, reads a tensor."""
        return name in self._places

    def place(self, name: str) -> Place:
        """The array that a tensor lies in, and from which element on."""
        view = self._views.get(name, Place(name))
        whole = self._places[view.base]
        return Place(whole.base, whole.offset + view.offset)

    def scratch_bytes(self) -> int:
        """What all scratch arrays take together."""
        return sum(BYTES.get(c_type, 4) * size for c_type, size in self.sizes.items())
