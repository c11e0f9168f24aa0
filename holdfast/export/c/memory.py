"""Where each tensor lies: in the caller's arrays, in the state, or in scratch memory on the stack.

Scratch memory is one array for each C type. A tensor's place is free again after its last reader,
so the stack holds the largest moment, not the sum of all tensors. Parts of another tensor's memory
(other shapes of one row, rows of the state) are views: they need no memory and no work.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from holdfast.export.c.graph import Graph, Node, Shape, refusal
from holdfast.export.c.literals import BYTES, C_TYPES

ALIGNED = 8
"""Places are multiples of this many numbers, for vector instructions."""
SCRATCH = {"double": "d", "float": "f", "int32_t": "w", "uint8_t": "b"}
"""The names of the scratch arrays."""


@dataclass(frozen=True)
class View:
    """A tensor that begins `offset` numbers into the memory of another one.

    base: the tensor that has the memory; it is never a view itself.
    """

    base: str
    offset: int = 0


def views_of(graph: Graph) -> dict[str, View]:
    """Every tensor that needs no memory, by name. Raises NotCompilable for an output."""
    views: dict[str, View] = {}
    for node in graph.nodes:
        if node.op_type not in ("Reshape", "Flatten", "Split", "Slice"):
            continue
        whole = graph.shape(node.inputs[0])
        first = views.get(node.inputs[0], View(node.inputs[0]))
        for name, offset in parts_of(node, graph):
            is_shape = node.op_type in ("Reshape", "Flatten")
            if not is_shape and not _is_block(whole, graph.shape(name)):
                continue
            if name in graph.outputs:
                raise refusal(node, "an output is only a part of another tensor")
            views[name] = View(first.base, first.offset + offset)
    return views


def _is_block(whole: Shape, part: Shape) -> bool:
    """Whether a part lies in one piece: only the first axis longer than 1 is cut."""
    cut = [axis for axis, size in enumerate(whole) if part[axis] != size]
    return all(math.prod(part[:axis]) == 1 for axis in cut)


def parts_of(node: Node, graph: Graph) -> list[tuple[str, int]]:
    """(output, its first number in the input) of a Slice, a Split, or another shape."""
    step = strides(graph.shape(node.inputs[0]))
    if node.op_type == "Slice":
        starts, _, axes = (graph.constant(one, node) for one in node.inputs[1:])
        first = sum(
            start * step[axis] for start, axis in zip(starts, axes, strict=True)
        )
        return [(node.outputs[0], int(first))]

    parts = []
    row = 0
    for name in node.outputs:
        parts.append((name, row * step[node.axis]))
        row += graph.shape(name)[node.axis]
    return parts


def strides(shape: Shape) -> Shape:
    """How far apart neighbours along each axis are, in numbers.

    >>> strides((1, 7, 18))
    (126, 18, 1)
    """
    return tuple(math.prod(shape[axis + 1 :]) for axis in range(len(shape)))


@dataclass(frozen=True)
class Place:
    """Memory of a tensor: its C type, the array it is in, and the first number there."""

    c_type: str
    array: str
    offset: int = 0

    def address(self) -> str:
        """As a C expression."""
        return f"{self.array} + {self.offset}" if self.offset else self.array


class Memory:
    """The places of all tensors that a list of nodes reads or makes.

    outside: tensor -> array of the caller. kept: the node that joins the next state after all
    others, so that what it reads lives to the end.

    sizes: numbers in each scratch array, by C type.
    """

    def __init__(
        self,
        graph: Graph,
        views: dict[str, View],
        nodes: list[Node],
        outside: dict[str, str],
        kept: list[Node],
    ) -> None:
        self._graph = graph
        self._views = views
        self.sizes: dict[str, int] = {}
        self._places: dict[str, Place] = {}
        for name, array in outside.items():
            self._places[name] = Place(self.c_type(name), array)

        last_reader: dict[str, int] = {}
        for at, node in enumerate([*nodes, *kept]):
            for name in node.inputs:
                base = views[name].base if name in views else name
                last_reader[base] = at

        # of each C type: first number, one past the last, and the last reader of a tensor
        taken: dict[str, list[tuple[int, int, int]]] = {}
        for at, node in enumerate(nodes):
            for name in node.outputs:
                if name in self._places or name not in last_reader:
                    continue
                of_type = taken.setdefault(self.c_type(name), [])
                # C's `restrict` promises that a node's outputs do not overlap its inputs
                living = [one for one in of_type if one[2] >= at]
                first, end = self._allot(name, living)
                of_type.append((first, end, last_reader[name]))

    def _allot(self, name: str, living: list[tuple[int, int, int]]) -> tuple[int, int]:
        """Give a tensor the first gap between the living ones that is large enough."""
        n = math.prod(self._graph.shape(name))
        n += -n % ALIGNED
        first = 0
        for begin, end, _ in sorted(living):
            if begin - first >= n:
                break
            first = max(first, end)

        c_type = self.c_type(name)
        self.sizes[c_type] = max(self.sizes.get(c_type, 0), first + n)
        self._places[name] = Place(c_type, SCRATCH[c_type], first)
        return first, first + n

    def c_type(self, name: str) -> str:
        """The C type that a tensor is kept as."""
        return C_TYPES[self._graph.element(name)]

    def is_kept(self, name: str) -> bool:
        """Whether a later node, or the caller, reads a tensor."""
        return name in self._places

    def place(self, name: str) -> Place:
        """Where a tensor lies."""
        view = self._views.get(name, View(name))
        base = self._places[view.base]
        return Place(base.c_type, base.array, base.offset + view.offset)

    def scratch_bytes(self) -> int:
        """Of all scratch arrays."""
        return sum(BYTES.get(c_type, 4) * size for c_type, size in self.sizes.items())
