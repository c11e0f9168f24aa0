"""The loop of an operator that makes each number from one number of each input."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.export.c.graph import BOOL, DOUBLE, FLOAT, INT64, Node, refusal
from holdfast.export.c.literals import C_TYPES, number
from holdfast.export.c.memory import strides
from holdfast.export.c.writer import Writer, axes_of, index, nested

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


def write_loop(node: Node, writer: Writer) -> list[str]:
    """Number by number. Raises NotCompilable for an operator without a C form."""
    (out,) = node.outputs
    operands = [_operand(tensor, node, writer) for tensor in node.inputs]
    value = _expression(node, operands, writer)
    target = writer.read(out, _index(out, node, writer))
    return nested(writer.graph.shape(out), node, [f"{target} = {value};"])


def write_look_up(node: Node, writer: Writer) -> list[str]:
    """Numbers of a constant table of one row, at computed places."""
    table, places = node.inputs
    at = _operand(places, node, writer)
    return _looked_up(node, writer, writer.graph.constant(table, node), at)


def write_encoder(node: Node, writer: Writer) -> list[str]:
    """Numbers of a table whose keys are 0, 1, 2 ..; behind the last one, 0."""
    values = np.append(node.attributes["values_floats"], 0.0)
    at = f"hf_whole({_operand(node.inputs[0], node, writer)})"
    return _looked_up(node, writer, values, at)


def _looked_up(
    node: Node, writer: Writer, values: npt.NDArray[Any], at: str
) -> list[str]:
    """The numbers of a table at the places of a C expression."""
    (out,) = node.outputs
    c_type = C_TYPES[writer.graph.element(out)]
    name = writer.tables.add(f"hf_{out}_values", values, c_type)
    target = writer.read(out, _index(out, node, writer))
    # a corrupted state must not reach beyond the table
    value = f"{name}[hf_within({at}, {len(values) - 1})]"
    return nested(writer.graph.shape(out), node, [f"{target} = {value};"])


def _operand(tensor: str, node: Node, writer: Writer) -> str:
    """How C reads an input: a literal, a table, or an array."""
    place = _index(tensor, node, writer)
    values = writer.graph.values(tensor)
    if values is None:
        return writer.read(tensor, place)

    c_type = C_TYPES[writer.graph.element(tensor)]
    first = values.ravel()[0]
    if (values == first).all():
        return number(first, c_type)
    return f"{writer.tables.add(f'hf_{tensor}', values, c_type)}[{place}]"


def _index(tensor: str, node: Node, writer: Writer) -> str:
    """Where the number of this pass is; an axis of length one is read again and again."""
    # ONNX broadcasts as numpy does: missing axes are added in front, with length one
    out = writer.graph.shape(node.outputs[0])
    shape = writer.graph.shape(tensor)
    padded = (1,) * (len(out) - len(shape)) + shape
    step = strides(padded)
    terms = []
    for counter, axis in axes_of(out, node):
        terms.append((step[axis], counter, padded[axis]))
    return index(*terms)


def _expression(node: Node, operands: list[str], writer: Writer) -> str:
    """A node's operator as a C expression. Raises NotCompilable for one without a C form."""
    op = node.op_type
    element = writer.graph.element(node.inputs[0])
    is_real = element in (FLOAT, DOUBLE)
    # a processor with a float unit alone would compute a double in software
    end = "f" if element == FLOAT else ""

    if op in INFIX:
        return f"{operands[0]} {INFIX[op]} {operands[1]}"
    if op in CALLS and is_real:
        return f"{CALLS[op]}{end}({operands[0]})"
    if op in ("Max", "Min"):
        sign = ">" if op == "Max" else "<"
        first, second = operands
        return f"{first} {sign} {second} ? {first} : {second}"
    if op == "Clip" and is_real:
        helper = "hf_clip_f" if element == FLOAT else "hf_clip"
        return f"{helper}({', '.join(operands)})"
    if op == "Not":
        return f"!{operands[0]}"
    if op == "Where":
        return f"{operands[0]} ? {operands[1]} : {operands[2]}"
    if op == "Round" and element == FLOAT:
        return f"hf_round({operands[0]})"
    if op == "Cast":
        return _cast(node.attributes["to"], element, operands[0])
    raise refusal(node, "it has no C form")


def _cast(to: int, element: int, operand: str) -> str:
    """A Cast from an element type; places and counts of the graph have 32 bits in C."""
    # any number but 0 is true, as in ONNX; a C cast to uint8_t would keep the lowest bits
    if to == BOOL:
        return f"{operand} != 0"
    # C leaves a cast of NaN or of a number that does not fit undefined; the helper bounds it
    if element in (FLOAT, DOUBLE) and to not in (FLOAT, DOUBLE):
        return f"hf_whole({operand})"
    if element == to == INT64:
        return operand
    return f"({C_TYPES[to]}){operand}"
