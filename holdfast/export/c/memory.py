"""Where each tensor lies: in the caller's arrays, in the state, or in scratch memory on the stack.

Scratch memory is one array for each C type. A tensor's place is free again after its last reader,
so the stack holds the largest moment, not the sum of all tensors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from holdfast.export.c.graph import Graph, Node
from holdfast.export.c.literals import BYTES, C_TYPES
from holdfast.export.c.plan import Step, View

ALIGNED = 8
"""Places are multiples of this many numbers, for vector instructions."""
SCRATCH = {
    "double": "d",
    "float": "f",
    "int32_t": "w",
    "uint8_t": "b",
}
"""The names of the scratch arrays."""
Block = tuple[int, int]
"""First number and size of free memory, both in numbers of its C type."""


@dataclass(frozen=True)
class Place:
    """Memory of a tensor: its C type, the array it is in, and the first number there."""

    c_type: str
    array: str
    offset: int = 0

    def address(self) -> str:
        """As an argument of a C call."""
        return f"{self.array} + {self.offset}" if self.offset else self.array


class Memory:
    """The places of all tensors that a list of steps reads or makes.

    views: tensors that lie inside the memory of another one. outside: tensor -> array of the
    caller. kept: the node that joins the next state after all steps, so that what it reads lives to
    the end.

    sizes: numbers in each scratch array, by C type.
    """

    def __init__(
        self,
        graph: Graph,
        views: dict[str, View],
        steps: list[Step],
        outside: dict[str, str],
        kept: Node | None = None,
    ) -> None:
        self._graph = graph
        self._views = views
        self.sizes: dict[str, int] = {}
        self._free: dict[str, list[Block]] = {}
        self._places: dict[str, Place] = {}
        for name, array in outside.items():
            self._places[name] = Place(self.c_type(name), array)

        # A step's outputs get their places before its inputs are freed: C's `restrict` promises
        # that they do not overlap.
        last_reader = _last_readers(steps, views, kept)
        for at, step in enumerate(steps):
            for name in step.node.outputs:
                if name in last_reader and name not in self._places:
                    self._places[name] = self._allot(name)
            for name, last in last_reader.items():
                if last == at:
                    self._release(name)

    def c_type(self, name: str) -> str:
        """The C type that a tensor is kept as."""
        return C_TYPES[self._graph.element(name)]

    def is_kept(self, name: str) -> bool:
        """Whether a later step, or the caller, reads a tensor."""
        return name in self._places

    def place(self, name: str) -> Place:
        """Where a tensor lies."""
        view = self._views.get(name)
        if view is None:
            return self._places[name]
        base = self._places[view.base]
        return Place(base.c_type, base.array, base.offset + view.offset)

    def scratch_bytes(self) -> int:
        """Of all scratch arrays."""
        return sum(BYTES.get(c_type, 4) * size for c_type, size in self.sizes.items())

    def _size(self, name: str) -> int:
        """Numbers of a tensor, rounded up."""
        n = math.prod(self._graph.shape(name))
        groups = -(-n // ALIGNED)
        return groups * ALIGNED

    def _allot(self, name: str) -> Place:
        """The first free block that is large enough, or new memory at the end."""
        c_type = self.c_type(name)
        n = self._size(name)
        blocks = self._free.setdefault(c_type, [])

        for k, (start, size) in enumerate(blocks):
            if size >= n:
                # A rest of size 0 stays in the list until the next release drops it.
                blocks[k] = (start + n, size - n)
                return Place(c_type, SCRATCH[c_type], start)

        end = self.sizes.get(c_type, 0)
        self.sizes[c_type] = end + n
        return Place(c_type, SCRATCH[c_type], end)

    def _release(self, name: str) -> None:
        """Free a tensor's scratch memory, and join neighbouring blocks."""
        place = self._places.get(name)
        # the caller's arrays and the state are not scratch memory
        if place is None or place.array != SCRATCH.get(place.c_type):
            return

        freed = (place.offset, self._size(name))
        joined: list[Block] = []
        for start, size in sorted([*self._free[place.c_type], freed]):
            # what is left of a block that was allotted whole
            if not size:
                continue
            # first number and size of a block add up to where the next one begins
            if joined and sum(joined[-1]) == start:
                first, before = joined.pop()
                joined.append((first, before + size))
            else:
                joined.append((start, size))

        self._free[place.c_type] = joined


def _last_readers(
    steps: list[Step], views: dict[str, View], kept: Node | None
) -> dict[str, int]:
    """Tensor -> number of the last step that reads it, for those that another step reads."""
    made: dict[str, int] = {}
    readers: list[tuple[int, Node]] = []
    for at, step in enumerate(steps):
        made |= dict.fromkeys(step.node.outputs, at)
        readers.append((at, step.node))

    # the next state is joined after all steps
    if kept is not None:
        readers.append((len(steps), kept))

    last: dict[str, int] = {}
    for at, node in readers:
        for name in node.inputs:
            base = views[name].base if name in views else name
            if base in made:
                last[base] = at

    return last
