"""The loop of an operator that goes number by number."""

from __future__ import annotations

import math

import numpy as np

from holdfast.export.c.graph import (
    BOOL,
    DOUBLE,
    DTYPES,
    FLOAT,
    INT64,
    Node,
    Shape,
    refusal,
)
from holdfast.export.c.literals import C_TYPES, number, smallest_type
from holdfast.export.c.plan import Step, strides, without_ones
from holdfast.export.c.writer import Writer, counted, index

VARIABLES = ("i", "j", "k")
"""Counters of nested loops, from the outermost on."""
INFIX = {
    "Add": "+",
    "Sub": "-",
    "Mul": "*",
    "Div": "/",
    # a flag is 0 or 1, so the bitwise operator is their conjunction
    "And": "&",
    "Greater": ">",
    "GreaterOrEqual": ">=",
    "Less": "<",
}
CALLS = {"Abs": "fabs", "Sqrt": "sqrt", "Floor": "floor"}
"""Functions of C for double; those for float end in f."""


def write_loop(step: Step, writer: Writer) -> list[str]:
    """The body of a step that goes number by number."""
    assert step.shape is not None
    loop = _Loop(step, step.shape, writer)
    lines = loop.lines(step.node)
    for variable, size in reversed(loop.counters):
        lines = counted(variable, size, lines)

    return lines


class _Loop:
    """One loop: its counters (variable, size), and what is computed inside it."""

    def __init__(self, step: Step, shape: Shape, writer: Writer) -> None:
        self._writer = writer
        self._graph = writer.graph

        # where all inputs have the loop's shape, one counter is enough
        has_axes = len(shape) > 1
        self._flat = has_axes and self._is_flat(step.node)
        sizes = (math.prod(shape),) if self._flat else shape

        if len(sizes) > len(VARIABLES):
            raise refusal(step.node, "it has too many dimensions")
        self.counters = list(zip(VARIABLES, sizes, strict=False))

    def lines(self, node: Node) -> list[str]:
        """A number of a node's output, and where it is kept."""
        writer = self._writer
        (out,) = node.outputs
        operands = [self._operand(name, node) for name in node.inputs]

        value = self._expression(node, operands)
        return [f"{writer.name(out)}[{self._index(out, node)}] = {value};"]

    def _operand(self, tensor: str, node: Node) -> str:
        """How C reads an input: a literal, a table, or an array."""
        values = self._graph.values(tensor)
        if values is not None:
            return self._constant(tensor, values, node)

        return self._writer.read(tensor, self._index(tensor, node))

    def _constant(self, tensor: str, values: np.ndarray, node: Node) -> str:
        """A constant as one number or as a place in a table; of a Gather, the table itself."""
        writer = self._writer
        c_type = C_TYPES[self._graph.element(tensor)]
        is_table = node.op_type == "Gather" and tensor == node.inputs[0]

        if is_table:
            c_type = _table_type(values)
        elif _is_uniform(values):
            return number(values.ravel()[0], c_type)

        name = writer.tables.add(f"hf_{writer.name(tensor)}", values, c_type)
        if is_table:
            return name
        return f"{name}[{self._index(tensor, node)}]"

    def _index(self, tensor: str, node: Node) -> str:
        """Where the number of this pass is; an axis of length one is read again and again."""
        shape = self._graph.shape(tensor)
        if self._flat:
            return "i" if math.prod(shape) > 1 else "0"

        # ONNX broadcasts as numpy does: missing axes are added in front, with length one
        out = self._graph.shape(node.outputs[0])
        padded: Shape = (1,) * (len(out) - len(shape)) + shape
        step = strides(padded)

        axes = [axis for axis, size in enumerate(out) if size != 1]
        terms = []
        for variable, axis in zip(VARIABLES, axes, strict=False):
            terms.append((step[axis], variable, padded[axis]))

        return index(*terms)

    def _is_flat(self, node: Node) -> bool:
        """Whether every input is of the loop's shape, or one number."""
        whole = without_ones(self._graph.shape(node.outputs[0]))
        inputs = node.inputs[1:] if node.op_type == "Gather" else node.inputs

        for name in inputs:
            shape = without_ones(self._graph.shape(name))
            has_shape = shape in (whole, ())
            if not has_shape and not _is_uniform(self._graph.values(name)):
                return False

        return True

    def _expression(self, node: Node, operands: list[str]) -> str:
        """A node's operator as a C expression. Raises NotCompilable for one without a C form."""
        op = node.op_type
        element = self._graph.element(node.inputs[0])
        is_real = element in (FLOAT, DOUBLE)

        if op in INFIX:
            return f"{operands[0]} {INFIX[op]} {operands[1]}"
        if op in CALLS and is_real:
            # a processor with a float unit alone would compute a double in software
            suffix = "f" if element == FLOAT else ""
            return f"{CALLS[op]}{suffix}({operands[0]})"
        if op in ("Max", "Min"):
            sign = ">" if op == "Max" else "<"
            first, second = operands
            return f"{first} {sign} {second} ? {first} : {second}"
        if op == "Clip" and is_real:
            helper = "hf_clip_f" if element == FLOAT else "hf_clip"
            return f"{helper}({', '.join(operands)})"
        if op == "Where":
            condition, if_true, if_false = operands
            return f"{condition} ? {if_true} : {if_false}"
        if op == "Round" and element == FLOAT:
            return f"hf_round({operands[0]})"
        if op == "Cast":
            return _cast(node, element, operands[0])
        if op == "Gather":
            return self._looked_up(node, operands)
        raise refusal(node, "it has no C form for its type")

    def _looked_up(self, node: Node, operands: list[str]) -> str:
        """A number of a table of one row; a corrupted state must not reach beyond it."""
        shape = self._graph.shape(node.inputs[0])
        if len(shape) != 1:
            raise refusal(node, "its table has more than one row")
        table, place = operands
        return f"{table}[hf_within({place}, {shape[0] - 1})]"


def _is_uniform(values: np.ndarray | None) -> bool:
    """Whether a constant is one number, once or again and again."""
    return values is not None and bool((values == values.ravel()[0]).all())


def _table_type(values: np.ndarray) -> str:
    """Whole numbers as the smallest unsigned or signed type: they are exact in every type."""
    is_whole = (values == np.round(values)).all()
    if is_whole and np.abs(values).max() < 2**31:
        return smallest_type(values)
    return "double" if values.dtype == np.float64 else "float"


def _cast(node: Node, element: int, operand: str) -> str:
    """A Cast from an element type; places and counts of the graph have 32 bits in C."""
    to = node.attributes["to"]
    assert isinstance(to, int)
    assert to in DTYPES

    # any number but 0 is true, as in ONNX; a C cast to uint8_t would keep the lowest bits
    if to == BOOL:
        return f"{operand} != 0"
    # C leaves a cast of NaN or of a number that does not fit undefined; the helper bounds it
    if element in (FLOAT, DOUBLE) and to not in (FLOAT, DOUBLE):
        return f"hf_whole({operand})"
    if element == to == INT64:
        return operand
    return f"({C_TYPES[to]}){operand}"
