"""What every emitter works with: names, places and types of tensors, loops and blocks of C."""

from __future__ import annotations

from dataclasses import dataclass

from holdfast.export.c.graph import Graph, Node, Shape, refusal
from holdfast.export.c.literals import Tables
from holdfast.export.c.memory import Memory

COUNTERS = ("i", "j", "k")
"""Counters of nested loops, from the outermost on."""


@dataclass(frozen=True)
class Writer:
    """What emitters of one part of the graph share. tables: of the whole file."""

    graph: Graph
    memory: Memory
    tables: Tables

    def name(self, tensor: str) -> str:
        """The C name of a tensor, which is no word of C and no counter."""
        return f"t_{tensor}"

    def read(self, tensor: str, index: str) -> str:
        """A number of a tensor, as the type in the graph."""
        return f"{self.name(tensor)}[{index}]"

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
        place = self.memory.place(tensor)
        return f"{place.c_type} *restrict {self.name(tensor)} = {place.address()};"


def block(head: str, body: list[str]) -> list[str]:
    """A C block: its head, the indented body, and the closing brace."""
    return [f"{head} {{", *(f"    {line}" for line in body), "}"]


def counted(variable: str, n: int, body: list[str], first: int = 0) -> list[str]:
    """A loop over first .. n - 1; the body alone where n is 1, for `index` leaves i out then."""
    if n == 1:
        return body
    head = f"for (int {variable} = {first}; {variable} < {n}; ++{variable})"
    return block(head, body)


def axes_of(shape: Shape, node: Node) -> list[tuple[str, int]]:
    """(counter, axis) of every axis of more than one number. Raises NotCompilable for too many."""
    axes = [axis for axis, size in enumerate(shape) if size > 1]
    if len(axes) > len(COUNTERS):
        raise refusal(node, "it has too many dimensions")
    return list(zip(COUNTERS, axes, strict=False))


def nested(shape: Shape, node: Node, body: list[str]) -> list[str]:
    """Loops over all axes of a shape: neighbours in memory follow each other."""
    for counter, axis in reversed(axes_of(shape, node)):
        body = counted(counter, shape[axis], body)
    return body


def index(*terms: tuple[int, str, int], first: int = 0) -> str:
    """A place in memory: steps times variables, each with the size of its loop.

    >>> index((18, "i", 7), (1, "j", 18)), index((18, "i", 1)), index((1, "j", 3), first=6)
    ('18 * i + j', '0', '6 + j')
    """
    words = [f"{first}"] if first else []
    for step, name, size in terms:
        if size > 1:
            words.append(name if step == 1 else f"{step} * {name}")
    return " + ".join(words) or "0"
