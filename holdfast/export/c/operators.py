"""The body of each operator: number by number, places of a table, sums over axes, products.

onnxruntime adds the products of a sum one after another, in the order of the inner axis, each by a
fused multiply-add. `HF_ADD_PRODUCT` is that with HOLDFAST_FUSED, and else two roundings, which any
processor has. Products with 0, 1 and -1, and whole numbers below 2^24, are exact in any order.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.export.c.graph import BOOL, C_TYPES, DOUBLE, FLOAT, INT64, Node, refusal
from holdfast.export.c.literals import number
from holdfast.export.c.loops import Writer, block, nested, place, strides
from holdfast.export.c.memory import moved_places, numbered
from holdfast.export.c.trees import write_trees

FORMS = {
    "Add": "{0} + {1}",
    "Sub": "{0} - {1}",
    "Mul": "{0} * {1}",
    "Div": "{0} / {1}",
    # a flag is 0 or 1, so the bitwise operator is their conjunction
    "And": "{0} & {1}",
    "Greater": "{0} > {1}",
    "GreaterOrEqual": "{0} >= {1}",
    "Less": "{0} < {1}",
    "Max": "{0} > {1} ? {0} : {1}",
    "Min": "{0} < {1} ? {0} : {1}",
    "Where": "{0} ? {1} : {2}",
    "Not": "!{0}",
    "Abs": "fabs{f}({0})",
    "Sqrt": "sqrt{f}({0})",
    "Floor": "floor{f}({0})",
    "Clip": "hf_clip{f}({0}, {1}, {2})",
    "Round": "hf_round{f}({0})",
}
"""Operator -> C of its operands; functions for float end in f: a processor with a float unit alone
would compute a double in software."""
TAKES = {
    "ReduceMax": "{x} > {y} ? {x} : {y}",
    "ReduceMin": "{x} < {y} ? {x} : {y}",
    "ReduceSum": "{y} + {x}",
    "ReduceL2": "{y} + {x} * {x}",
}
"""Reduction -> how a number x changes the result y so far."""
SUMS = ("ReduceSum", "ReduceL2")
"""Reductions that begin with 0; the others begin with the first number."""


def body_of(node: Node, writer: Writer) -> list[str]:
    """What computes a node. Raises NotCompilable for an operator without a C form."""
    if node.op_type == "Gather" and writer.graph.values(node.inputs[0]) is not None:
        return _look_up(node, writer)
    return _BODIES.get(node.op_type, _by_number)(node, writer)


def _by_number(node: Node, writer: Writer) -> list[str]:
    """An operator that makes each number from one number of each input."""
    (out,) = node.outputs
    shape = writer.graph.shape(out)
    operands = [writer.read(tensor, shape) for tensor in node.inputs]
    element = writer.graph.element(node.inputs[0])
    if node.op_type == "Cast":
        value = _cast(node.attributes["to"], element, operands[0])
    elif node.op_type in FORMS:
        form = FORMS[node.op_type]
        value = form.format(*operands, f="f" if element == FLOAT else "")
    else:
        raise refusal(node, "it has no C form")
    return nested(shape, [f"{writer.read(out, shape)} = {value};"])


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


def _look_up(node: Node, writer: Writer) -> list[str]:
    """Numbers of a table at computed places: a constant of one row, or the values of an encoder.

    The keys of an encoder are 0, 1, 2 ..; behind the last one, its number is 0.
    """
    (out,) = node.outputs
    shape = writer.graph.shape(out)
    if node.op_type == "LabelEncoder":
        values = np.append(node.attributes["values_floats"], 0.0)
        at = f"hf_whole({writer.read(node.inputs[0], shape)})"
    else:
        values = writer.graph.constant(node.inputs[0], node)
        at = writer.read(node.inputs[1], shape)
    name = writer.tables.add(f"hf_{out}_values", values, writer.graph.c_type(out))
    # a corrupted state must not reach beyond the table
    value = f"{name}[hf_within({at}, {len(values) - 1})]"
    return nested(shape, [f"{writer.read(out, shape)} = {value};"])


def _moved(node: Node, writer: Writer) -> list[str]:
    """Numbers of an input at other places."""
    lines = []
    for name, places in moved_places(node, writer.graph).items():
        # a part that no step reads, or that is a view, is not copied
        if writer.memory.is_kept(name):
            n = (places.size,)
            source = f"t_{node.inputs[0]}[{writer.at_places(places, name)}]"
            lines += nested(n, [f"t_{name}[{place(n, (1,))}] = {source};"])
    return lines


def _concat(node: Node, writer: Writer) -> list[str]:
    """All inputs one after another along one axis."""
    (out,) = node.outputs
    ends = np.cumsum([writer.graph.shape(name)[node.axis] for name in node.inputs])
    parts = np.split(numbered(writer.graph.shape(out)), ends[:-1], node.axis)
    lines = []
    for name, places in zip(node.inputs, parts, strict=True):
        n = (places.size,)
        target = f"t_{out}[{writer.at_places(places, f'{out}_{name}')}]"
        lines += nested(n, [f"{target} = t_{name}[{place(n, (1,))}];"])
    return lines


def _reduced(node: Node, writer: Writer) -> list[str]:
    """Over some axes, number after number: a sum adds its terms in the order of memory."""
    given, axes = node.inputs
    (out,) = node.outputs
    shape = writer.graph.shape(given)
    kept = list(shape)
    for axis in writer.graph.constant(axes, node):
        kept[axis] = 1
    step = strides(tuple(kept))
    target = f"t_{out}[{place(shape, step)}]"

    # an extreme begins with the first number
    is_sum = node.op_type in SUMS
    begin = "0" if is_sum else f"t_{given}[{place(tuple(kept), strides(shape))}]"
    lines = nested(tuple(kept), [f"{target} = {begin};"])
    taken = TAKES[node.op_type].format(x=writer.read(given, shape), y=target)
    # C computes with small integers as int: the cast states the type that is kept
    lines += nested(shape, [f"{target} = ({writer.graph.c_type(out)})({taken});"])
    # the loop above has added up squares: the root of each sum is taken once, at the end
    if node.op_type == "ReduceL2":
        lines += nested(tuple(kept), [f"{target} = sqrt({target});"])
    return lines


def _product(node: Node, writer: Writer) -> list[str]:
    """MatMul of one constant matrix with a computed tensor; Gemm adds its third input."""
    left, right = node.inputs[:2]
    (out,) = node.outputs
    matrix = writer.graph.values(left)
    if matrix is None:
        # [.., K] x [K, N]; a vector on the right is a matrix of one column
        matrix = writer.graph.constant(right, node)
        matrix = matrix.reshape(len(matrix), -1)
        n_terms, n_sums = matrix.shape
        lanes = math.prod(writer.graph.shape(left)[:-1])
        x = _Side(left, n_terms, 1)
        lines = _sums(matrix, lanes, x, _Side(out, n_sums, 1), writer)
    else:
        # [M, K] x [K, N]: each row of the matrix gives N sums, one for each column of the input
        lanes = writer.graph.shape(right)[-1]
        x = _Side(right, 1, lanes)
        lines = _sums(matrix.T, lanes, x, _Side(out, 1, lanes), writer)

    if node.op_type == "Gemm":
        added = Node("Add", (out, node.inputs[2]), (out,), {})
        lines += _by_number(added, writer)
    return lines


@dataclass(frozen=True)
class _Side:
    """A tensor of a product: its steps from lane to lane, and from term to term or sum to sum."""

    tensor: str
    lane: int
    next: int


def _sums(
    weights: npt.NDArray[Any], lanes: int, x: _Side, y: _Side, writer: Writer
) -> list[str]:
    """Sums of weights [terms, sums] times terms, the same for each lane."""
    c_type = writer.graph.c_type(y.tensor)
    if 2 * np.count_nonzero(weights) > weights.size:
        # term after term, the sums side by side: the table is read as it lies in memory
        shape = (lanes, *weights.shape)
        table = writer.tables.add(f"hf_{y.tensor}_weights", weights, c_type)
        weight = f"{table}[{place(shape, strides((1, *weights.shape)))}]"
        term = f"t_{x.tensor}[{place(shape, (x.lane, x.next, 0))}]"
        # a compiler keeps a short row of sums in registers, and sees that nothing else writes to it
        n_sums = weights.shape[1]
        total = f"y[{place(shape, (0, 0, 1))}]"
        sums = nested((1, *weights.shape), [_add(c_type, total, weight, term)])
        target = f"t_{y.tensor}[{place(shape, (y.lane, 0, y.next))}]"
        sums += nested((1, 1, n_sums), [f"{target} = {total};"])
        return nested((lanes,), block("", [f"{c_type} y[{n_sums}] = {{0}};", *sums]))

    lines = []
    for number_of, column in enumerate(weights.T):
        sums = [f"{c_type} y = 0;"]
        # a product with 0 adds nothing: the guard keeps every number finite
        for k in np.flatnonzero(column).tolist():
            term = f"t_{x.tensor}[{place((lanes,), (x.lane,), k * x.next)}]"
            sums.append(_add(c_type, "y", number(column[k], c_type), term))
        at = place((lanes,), (y.lane,), number_of * y.next)
        # every sum is called y, in a block of its own
        lines += nested((lanes,), block("", [*sums, f"t_{y.tensor}[{at}] = y;"]))
    return lines


def _add(c_type: str, total: str, weight: str, term: str) -> str:
    """A C statement that adds weight x term to a total: fused with HOLDFAST_FUSED, else not."""
    macro = "HF_ADD_PRODUCT" if c_type == "double" else "HF_ADD_PRODUCT_F"
    return f"{total} = {macro}({weight}, {term}, {total});"


def _whole_row(node: Node, writer: Writer) -> list[str]:
    """A function of one row, in templates/maths.c."""
    (given,) = node.inputs
    n = writer.graph.shape(given)[-1]
    # of equal classes, which are ordered by risk, the last one is the riskier
    name = "hf_softmax" if node.op_type == "Softmax" else "hf_last_largest"
    return [f"{name}(t_{given}, t_{node.outputs[0]}, {n});"]


_BODIES: dict[str, Callable[[Node, Writer], list[str]]] = {
    "ArgMax": _whole_row,
    "Concat": _concat,
    "Gather": _moved,
    "Gemm": _product,
    "LabelEncoder": _look_up,
    "MatMul": _product,
    "Slice": _moved,
    "Softmax": _whole_row,
    "Split": _moved,
    "Transpose": _moved,
    "TreeEnsembleRegressor": write_trees,
    **dict.fromkeys(TAKES, _reduced),
}
"""The body of each operator; all others go number by number."""
