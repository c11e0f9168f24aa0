"""What every emitter works with: names, places and types of tensors; and one function a step."""

from __future__ import annotations

import re
from dataclasses import dataclass

from holdfast.export.c.graph import Graph
from holdfast.export.c.literals import Tables
from holdfast.export.c.memory import Memory
from holdfast.export.c.plan import Step

_NAME = re.compile(r"[a-z][a-z0-9]*_[a-z0-9_]{1,50}")
"""With an underscore inside, no name is a word of C or a function of its library."""
OURS = ("hf_", "holdfast_", "tensor_")
"""How the names begin that the C form itself defines."""
KNOWN = frozenset(
    [
        "sample",
        "valid",
        "state",
        "features",
        "settled",
        "unknown",
        "detectors",
        "votes",
        "situation",
        "weight",
    ]
)
"""Names of the step's interface, which are free in C too."""


class Names:
    """C names of tensors: those of the graph where C allows them."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}

    def of(self, tensor: str) -> str:
        """The same name at every call."""
        free = _NAME.fullmatch(tensor) and not tensor.startswith(OURS)
        # numbered by first use, so the same graph always gives the same C
        number = len(self._names)
        name = tensor if free or tensor in KNOWN else f"tensor_{number}"
        return self._names.setdefault(tensor, name)


@dataclass(frozen=True)
class Writer:
    """What emitters of one part of the graph share. tables, names: of the whole file."""

    graph: Graph
    memory: Memory
    tables: Tables
    names: Names

    def name(self, tensor: str) -> str:
        """The C name of a tensor."""
        return self.names.of(tensor)

    def is_constant(self, tensor: str) -> bool:
        """Whether a tensor is a constant of the graph."""
        return self.graph.values(tensor) is not None

    def read(self, tensor: str, index: str) -> str:
        """A number of a tensor, as the type in the graph."""
        return f"{self.name(tensor)}[{index}]"


@dataclass(frozen=True)
class Function:
    """A C function that computes one step, and the call of it."""

    definition: str
    call: str


def function(step: Step, number: int, body: list[str], writer: Writer) -> Function:
    """Wrap the body of a step; its parameters are what it reads and what it makes."""
    arguments = []
    parameters = []
    text = "\n".join(body)

    for tensor in _computed_inputs(step, writer):
        # the body of a step may leave out what it multiplies with 0
        if re.search(rf"\b{writer.name(tensor)}\b", text):
            parameters.append(_parameter(tensor, writer, "const "))
            arguments.append(writer.memory.place(tensor).address())

    # an output that nothing reads has no memory
    for tensor in step.node.outputs:
        if writer.memory.is_kept(tensor):
            parameters.append(_parameter(tensor, writer, ""))
            arguments.append(writer.memory.place(tensor).address())

    name = f"hf_step_{number}"
    about = f"/* {step.node.op_type} */"
    head = f"static void {name}({', '.join(parameters)})"
    definition = "\n".join([about, *block(head, body)])
    call = f"{name}({', '.join(arguments)});"
    return Function(f"{definition}\n", call)


def _computed_inputs(step: Step, writer: Writer) -> list[str]:
    """The tensors that a step reads and that are no constants, once each, in order."""
    names = dict.fromkeys(step.node.inputs)
    return [name for name in names if not writer.is_constant(name)]


def _parameter(tensor: str, writer: Writer, const: str) -> str:
    """A pointer that no other parameter shares memory with, so the compiler may use vectors."""
    c_type = writer.memory.place(tensor).c_type
    return f"{const}{c_type} *restrict {writer.name(tensor)}"


def block(head: str, body: list[str]) -> list[str]:
    """A C block: its head, the indented body, and the closing brace."""
    return [f"{head} {{", *(f"    {line}" for line in body), "}"]


def counted(variable: str, n: int, body: list[str], first: int = 0) -> list[str]:
    """A loop over first .. n - 1; the body alone where n is 1, for `index` leaves i out then."""
    if n == 1:
        return body
    head = f"for (int {variable} = {first}; {variable} < {n}; ++{variable})"
    return block(head, body)


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
