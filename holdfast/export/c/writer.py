"""What every emitter works with: names, places and types of tensors; and one function a step."""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass

from holdfast.export.c.graph import Graph
from holdfast.export.c.literals import C_TYPES, Tables
from holdfast.export.c.memory import Memory
from holdfast.export.c.plan import Step
from holdfast.export.c.whole import Whole

_NAME = re.compile(r"[a-z][a-z0-9]*_[a-z0-9_]{1,50}")
"""With an underscore inside, no name is a word of C or a function of its library."""
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
"""Names of the step's own interface, which are free in C too."""


class Names:
    """C names of tensors: the graph's own where C allows them."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}

    def of(self, tensor: str) -> str:
        """The same name at every call."""
        free = _NAME.fullmatch(tensor) and not tensor.startswith(
            ("hf_", "holdfast_", "tensor_")
        )
        number = len(self._names)
        return self._names.setdefault(
            tensor, tensor if free or tensor in KNOWN else f"tensor_{number}"
        )


@dataclass(frozen=True)
class Writer:
    """What emitters of one part of the graph share. tables, names: of the whole file."""

    graph: Graph
    memory: Memory
    tables: Tables
    names: Names
    whole: Whole

    def name(self, tensor: str) -> str:
        """The C name of a tensor."""
        return self.names.of(tensor)

    def is_constant(self, tensor: str) -> bool:
        """Whether a tensor is a constant of the graph."""
        return self.graph.values(tensor) is not None

    def value_type(self, tensor: str) -> str:
        """The C type of a number of a tensor while it is computed with."""
        c_type = C_TYPES[self.graph.element(tensor)]
        return "int" if c_type == "uint8_t" else c_type

    def read(self, tensor: str, index: str) -> str:
        """A number of a tensor, as the type that the graph says."""
        kept, wanted = (
            self.memory.place(tensor).c_type,
            C_TYPES[self.graph.element(tensor)],
        )
        number = f"{self.name(tensor)}[{index}]"
        return number if kept == wanted else f"({wanted}){number}"


@dataclass(frozen=True)
class Function:
    """A C function that computes one step, and the call of it."""

    definition: str
    call: str


def function(step: Step, number: int, body: list[str], writer: Writer) -> Function:
    """Wrap the body of a step; its parameters are what it reads and what it makes."""
    made = [name for name in step.outputs if writer.memory.is_kept(name)]
    inside = set(step.outputs)
    read = dict.fromkeys(
        name
        for node in step.nodes
        for name in node.inputs
        if name not in inside and not writer.is_constant(name)
    )
    used = [name for name in read if _is_used(writer.name(name), body)]
    parameters = [_parameter(name, writer, "const ") for name in used]
    parameters += [_parameter(name, writer, "") for name in made]
    name = f"hf_step_{number}"
    head = f"static void {name}({', '.join(parameters)}) {{"
    about = textwrap.fill(", ".join(node.op_type for node in step.nodes), 94)
    text = "\n".join([f"/* {about} */", head, *(f"    {line}" for line in body), "}"])
    arguments = ", ".join(writer.memory.place(one).address() for one in [*used, *made])
    return Function(f"{text}\n", f"{name}({arguments});")


def _is_used(name: str, body: list[str]) -> bool:
    return re.search(rf"\b{name}\b", "\n".join(body)) is not None


def _parameter(tensor: str, writer: Writer, const: str) -> str:
    c_type = writer.memory.place(tensor).c_type
    return f"{const}{c_type} *restrict {writer.name(tensor)}"


def block(head: str, body: list[str]) -> list[str]:
    """A C block: its head, the indented body, and the closing brace."""
    return [f"{head} {{", *(f"    {line}" for line in body), "}"]


def counted(variable: str, n: int, body: list[str], first: int = 0) -> list[str]:
    """A loop over first .. n - 1; the body alone where n is 1, for `index` leaves i out then."""
    if n == 1:
        return body
    return block(
        f"for (int {variable} = {first}; {variable} < {n}; ++{variable})", body
    )


def index(*terms: tuple[int, str, int], first: int = 0) -> str:
    """A place in memory: steps times variables, each with the size of its loop.

    >>> index((18, "i", 7), (1, "j", 18)), index((18, "i", 1)), index((1, "j", 3), first=6)
    ('18 * i + j', '0', '6 + j')
    """
    words = [f"{first}"] if first else []
    words += [
        name if step == 1 else f"{step} * {name}"
        for step, name, size in terms
        if size > 1
    ]
    return " + ".join(words) or "0"
