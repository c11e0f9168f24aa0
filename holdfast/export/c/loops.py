"""Loops of C: one nest over a shape, in which each tensor moves on by steps of its own.

A step of 0 reads or adds to the same number again, so one nest serves an operator that goes number
by number, a sum over an axis, and a product with a matrix.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.export.c.graph import Graph, Node, Shape
from holdfast.export.c.literals import Tables, number
from holdfast.export.c.memory import Memory, first_of_run

COUNTERS = "ijklmn"
"""Counters of nested loops, one for each axis of a shape."""


def block(head: str, body: list[str]) -> list[str]:
    """A C block: its head, the indented body, and the closing brace."""
    return [f"{head} {{", *(f"    {line}" for line in body), "}"]


def nested(shape: Shape, body: list[str]) -> list[str]:
    """A loop for each axis of more than one number: neighbours in memory follow each other."""
    for counter, size in reversed(list(zip(COUNTERS, shape, strict=False))):
        if size > 1:
            head = f"for (int {counter} = 0; {counter} < {size}; ++{counter})"
            body = block(head, body)
    return body


def place(shape: Shape, steps: Shape, first: int = 0) -> str:
    """Where a tensor is read in the loops over a shape, which has no counter for a single number.

    >>> place((1, 7, 18), (126, 18, 1)), place((1,), (1,)), place((3,), (0,), 6)
    ('18 * j + k', '0', '6')
    """
    words = [f"{first}"] if first else []
    for counter, size, step in zip(COUNTERS, shape, steps, strict=False):
        if size > 1 and step:
            words.append(counter if step == 1 else f"{step} * {counter}")
    return " + ".join(words) or "0"


def strides(shape: Shape) -> Shape:
    """How far apart neighbours along each axis are, in numbers; 0 along an axis of one number.

    >>> strides((1, 7, 18)), strides((7, 1))
    ((0, 18, 1), (1, 0))
    """
    steps = []
    for axis, size in enumerate(shape):
        steps.append(math.prod(shape[axis + 1 :]) if size > 1 else 0)
    return tuple(steps)


@dataclass(frozen=True)
class Writer:
    """What emitters of one part of the graph share. tables: of the whole file."""

    graph: Graph
    memory: Memory
    tables: Tables

    def read(self, tensor: str, over: Shape) -> str:
        """A tensor at each pass of the loops over a shape: a literal, a table or an array."""
        # ONNX broadcasts as numpy does: missing axes are added in front, with length one
        shape = self.graph.shape(tensor)
        padded = (1,) * (len(over) - len(shape)) + shape
        at = place(over, strides(padded))
        values = self.graph.values(tensor)
        if values is None:
            return f"t_{tensor}[{at}]"

        c_type = self.graph.c_type(tensor)
        first = values.ravel()[0]
        if (values == first).all():
            return number(first, c_type)
        return f"{self.tables.add(f'hf_{tensor}', values, c_type)}[{at}]"

    def at_places(self, places: npt.NDArray[np.int64], name: str) -> str:
        """The place of each pass of a loop over so many: in a row, or by a table."""
        first = first_of_run(places)
        along = place((places.size,), (1,), first or 0)
        if first is not None:
            return along
        # places are read at every sample: short ones leave more of the cache to the trees
        c_type = "uint16_t" if places.max() < 2**16 else "int32_t"
        return f"{self.tables.add(f'hf_{name}_places', places, c_type)}[{along}]"

    def step(self, node: Node, body: list[str]) -> list[str]:
        """The body of a node as a block, with a pointer to each tensor that it reads or makes."""
        pointers = []
        for tensor in dict.fromkeys(node.inputs):
            if self.graph.values(tensor) is None:
                pointers.append(f"const {self._pointer(tensor)}")
        for tensor in node.outputs:
            # an output that nothing reads has no memory
            if self.memory.is_kept(tensor):
                pointers.append(self._pointer(tensor))
        return block(f"/* {node.op_type} */", [*pointers, *body])

    def _pointer(self, tensor: str) -> str:
        """A pointer that shares memory with no other, so the compiler may use vectors."""
        array, offset = self.memory.place(tensor)
        c_type = self.graph.c_type(tensor)
        return f"{c_type} *restrict t_{tensor} = {array} + {offset};"
