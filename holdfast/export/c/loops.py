"""Loops over operators that go number by number: each number is computed once and kept if read."""

from __future__ import annotations

import math

import numpy as np

from holdfast.edge_runtime.onnx_bytes import BOOL, DOUBLE, DTYPES, FLOAT, INT64, Node
from holdfast.export.c.graph import Shape, refusal
from holdfast.export.c.literals import C_TYPES, number, smallest_type
from holdfast.export.c.plan import Step, without_ones
from holdfast.export.c.views import strides
from holdfast.export.c.whole_products import INPUT_TYPE, PACKED
from holdfast.export.c.writer import Writer, counted, index

VARIABLES = ("i", "j", "k")
INFIX = {
    "Add": "+",
    "Sub": "-",
    "Mul": "*",
    "Div": "/",
    "And": "&",
    "Greater": ">",
    "GreaterOrEqual": ">=",
    "Less": "<",
}
SMALL = 2.0**22
"""Numbers below it may be rounded by adding and taking away a large one."""
CALLS = {"Abs": "fabs", "Sqrt": "sqrt", "Floor": "floor"}


def write_loop(step: Step, writer: Writer) -> list[str]:
    """The body of a step that goes number by number."""
    assert step.shape is not None
    loop = _Loop(step, writer)
    body = [line for node in step.nodes for line in loop.lines(node)]
    for variable, size in reversed(loop.counters):
        body = counted(variable, size, body)
    return body + [line for name in step.outputs for line in _padding(name, writer)]


def _padding(name: str, writer: Writer) -> list[str]:
    """Zeros behind the inputs of a product of whole numbers, which reads whole groups of them."""
    if not writer.memory.is_kept(name) or writer.memory.c_type(name) != INPUT_TYPE:
        return []
    size = math.prod(writer.graph.shape(name))
    return [
        f"{writer.name(name)}[{k}] = 0;"
        for k in range(size, -(-size // PACKED) * PACKED)
    ]


class _Loop:
    """One loop: its counters (variable, size), and what is computed inside it."""

    def __init__(self, step: Step, writer: Writer) -> None:
        assert step.shape is not None
        self._writer, self._inside = writer, set(step.outputs)
        self._shape = step.shape
        if len(step.shape) > 1 and all(self._is_flat(node) for node in step.nodes):
            self._shape = (math.prod(step.shape),)
        if len(self._shape) > len(VARIABLES):
            raise refusal(step.nodes[0], "it has too many dimensions")
        self._flat = len(self._shape) < len(step.shape)
        self.counters = list(zip(VARIABLES, self._shape, strict=False))

    def lines(self, node: Node) -> list[str]:
        """A number of a node's output, and where it is kept."""
        writer, (out,) = self._writer, node.outputs
        operands = [self._operand(name, node) for name in node.inputs]
        name = writer.name(out)
        value = self._expression(node, operands)
        if not writer.memory.is_kept(out):
            return [f"const {writer.value_type(out)} {name} = {value};"]
        index = self._index(out, node)
        kept, wanted = writer.memory.place(out).c_type, writer.value_type(out)
        cast = "" if kept == wanted else f"({kept})"
        return [
            f"const {wanted} {name}_ = {value};",
            f"{name}[{index}] = {cast}{name}_;",
        ]

    def _operand(self, tensor: str, node: Node) -> str:
        writer = self._writer
        values = writer.graph.values(tensor)
        if values is None:
            if tensor in self._inside:
                kept = writer.memory.is_kept(tensor)
                return writer.name(tensor) + ("_" if kept else "")
            return writer.read(tensor, self._index(tensor, node))
        if _is_looked_up(node) and tensor == node.inputs[0]:
            return writer.tables.add(
                f"hf_{writer.name(tensor)}", values, _table_type(values)
            )
        if _is_uniform(values):
            return number(values.ravel()[0], C_TYPES[writer.graph.element(tensor)])
        c_type = C_TYPES[writer.graph.element(tensor)]
        table = writer.tables.add(f"hf_{writer.name(tensor)}", values, c_type)
        return f"{table}[{self._index(tensor, node)}]"

    def _index(self, tensor: str, node: Node) -> str:
        """Where the number of this pass is; an axis of length one is read again and again."""
        shape, out = (
            self._writer.graph.shape(tensor),
            self._writer.graph.shape(node.outputs[0]),
        )
        if self._flat:
            return "i" if math.prod(shape) > 1 else "0"
        padded: Shape = (1,) * (len(out) - len(shape)) + shape
        steps = [
            (step, size)
            for step, size, of in zip(strides(padded), padded, out, strict=True)
            if of != 1
        ]
        pairs = zip(VARIABLES, steps, strict=False)
        return index(*((step, variable, size) for variable, (step, size) in pairs))

    def _is_flat(self, node: Node) -> bool:
        """Whether every input is of the loop's own shape, or one number."""
        graph, whole = (
            self._writer.graph,
            without_ones(self._writer.graph.shape(node.outputs[0])),
        )
        inputs = node.inputs[1:] if _is_looked_up(node) else node.inputs
        return all(
            without_ones(graph.shape(name)) in (whole, ())
            or _is_uniform(graph.values(name))
            for name in inputs
        )

    def _expression(self, node: Node, operands: list[str]) -> str:
        op, element = node.op_type, self._writer.graph.element(node.inputs[0])
        end = "f" if element == FLOAT else ""
        if op in INFIX:
            return f"{operands[0]} {INFIX[op]} {operands[1]}"
        if op in CALLS and element in (FLOAT, DOUBLE):
            return f"{CALLS[op]}{end}({operands[0]})"
        if op in ("Max", "Min"):
            sign = ">" if op == "Max" else "<"
            return "{0} {2} {1} ? {0} : {1}".format(*operands, sign)
        if op == "Clip" and element in (FLOAT, DOUBLE):
            return f"hf_clip{'_f' if end else ''}({', '.join(operands)})"
        if op == "Where":
            return "{} ? {} : {}".format(*operands)
        if op == "Round" and element == FLOAT:
            return f"{self._round(node)}({operands[0]})"
        if op == "Cast":
            return _cast(node, element, operands[0])
        if op == "Gather":
            return self._looked_up(node, operands)
        raise refusal(node, "it has no C form for its type")

    def _round(self, node: Node) -> str:
        """The helper that rounds: a faster one where the number is proved to be small."""
        bounds = self._writer.whole.bounds(node.outputs[0])
        small = bounds is not None and max(-bounds[0], bounds[1]) < SMALL
        return "hf_round_small" if small else "hf_round"

    def _looked_up(self, node: Node, operands: list[str]) -> str:
        """A number of a table of one row; a corrupted state must not reach beyond it."""
        shape = self._writer.graph.shape(node.inputs[0])
        if len(shape) != 1:
            raise refusal(node, "its table has more than one row")
        return f"{operands[0]}[hf_within({operands[1]}, {shape[0] - 1})]"


def _is_uniform(values: np.ndarray | None) -> bool:
    """Whether a constant is one number, once or again and again."""
    return values is not None and bool((values == values.ravel()[0]).all())


def _is_looked_up(node: Node) -> bool:
    return node.op_type == "Gather"


def _table_type(values: np.ndarray) -> str:
    """Whole numbers as the smallest unsigned or signed type: they are exact in every type."""
    if (values == np.round(values)).all() and np.abs(values).max() < 2**31:
        return smallest_type(values)
    return "double" if values.dtype == np.float64 else "float"


def _cast(node: Node, element: int, operand: str) -> str:
    to = node.attributes["to"]
    assert isinstance(to, int)
    assert to in DTYPES
    if to == BOOL:
        return f"{operand} != 0"
    if element in (FLOAT, DOUBLE) and to not in (FLOAT, DOUBLE):
        return f"hf_whole({operand})"
    if {element, to} == {INT64}:
        return operand
    return f"({C_TYPES[to]}){operand}"
