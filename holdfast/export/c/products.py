"""Products with a constant matrix: zeros are left out, sums keep onnxruntime's order.

onnxruntime adds the products of a sum one after another, in the order of the inner axis, each by a
fused multiply-add. `HF_ADD_PRODUCT` is that with HOLDFAST_FUSED, and else two roundings, which any
processor has. Products with 0, 1 and -1, and whole numbers below 2^24, are exact in any order.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.onnx_bytes import Node
from holdfast.export.c.graph import refusal
from holdfast.export.c.literals import C_TYPES, number
from holdfast.export.c.whole_products import write_whole_product
from holdfast.export.c.writer import Writer, block, counted, index

Matrix = npt.NDArray[Any]
MOST_TERMS = 12
"""Terms of one sum that are written out; longer sums with a constant on the left are loops."""
MOST_SUMS = 4
"""Sums that a loop keeps in registers."""
MOST_WRITTEN = 600
"""Terms of a whole product that are written out where the constant is on the right."""


def write_product(node: Node, writer: Writer) -> list[str]:
    """MatMul of one constant matrix with a computed tensor."""
    left, right = (writer.graph.values(name) for name in node.inputs)
    (out,) = node.outputs
    if writer.memory.c_type(out) == "int32_t":
        assert right is not None
        return write_whole_product(node, right, writer)
    if left is not None and right is None and left.ndim == 2:
        return _constant_left(node, left, writer)
    if right is not None and left is None and right.ndim <= 2:
        return _constant_right(node, right.reshape(len(right), -1), writer)
    raise refusal(node, "neither of its inputs is a constant matrix")


def _constant_left(node: Node, matrix: Matrix, writer: Writer) -> list[str]:
    """[M, K] x [K, N]: one sum over rows of the input for each row of the output."""
    columns = writer.graph.shape(node.inputs[1])[-1]
    if math.prod(writer.graph.shape(node.inputs[1])[:-2]) != 1:
        raise refusal(node, "its second input has more than two dimensions")
    return [
        line
        for row, weights in enumerate(matrix)
        for line in _row(node, row, weights, columns, writer)
    ]


def _row(
    node: Node, row: int, weights: Matrix, columns: int, writer: Writer
) -> list[str]:
    c_type = C_TYPES[writer.graph.element(node.outputs[0])]
    x, out = writer.name(node.inputs[1]), writer.name(node.outputs[0])
    places = np.flatnonzero(weights)
    if len(places) > MOST_TERMS:
        return _long_row(node, row, weights, columns, writer)
    along = (1, "j", columns)
    terms = [
        (weights[k], f"{x}[{index(along, first=k * columns)}]") for k in places.tolist()
    ]
    body = [*_sum(terms, c_type), f"{out}[{index(along, first=row * columns)}] = y;"]
    return counted("j", columns, body) if columns > 1 else block("", body)


def _long_row(
    node: Node, row: int, weights: Matrix, columns: int, writer: Writer
) -> list[str]:
    """A sum over a range of rows of the input, in a loop for each column."""
    c_type = C_TYPES[writer.graph.element(node.outputs[0])]
    x, out = writer.name(node.inputs[1]), writer.name(node.outputs[0])
    places = np.flatnonzero(weights)
    first, last = int(places[0]), int(places[-1]) + 1
    used = weights[first:last]
    if len(np.unique(used)) == 1:
        weight = number(used[0], c_type)
    else:
        table = writer.tables.add(f"hf_{out}_row_{row}", used, c_type)
        weight = f"{table}[k - {first}]" if first else f"{table}[k]"
    lines = []
    for start in range(0, columns, MOST_SUMS):
        some = range(start, min(columns, start + MOST_SUMS))
        terms = ((f"y{n}", f"{x}[{index((columns, 'k', 2), first=n)}]") for n in some)
        adds = [_add(c_type, weight, operand, total) for total, operand in terms]
        zeros = ", ".join(f"y{n} = 0" for n in some)
        kept = [f"{out}[{row * columns + n}] = y{n};" for n in some]
        body = [f"{c_type} {zeros};", *counted("k", last, adds, first=first), *kept]
        lines += block("", body)
    return lines


def _constant_right(node: Node, matrix: Matrix, writer: Writer) -> list[str]:
    """[M, K] x [K, N]: every row of the input gives N sums."""
    c_type = C_TYPES[writer.graph.element(node.outputs[0])]
    shape = writer.graph.shape(node.inputs[0])
    rows, (inner, columns) = math.prod(shape[:-1]), matrix.shape
    x, out = writer.name(node.inputs[0]), writer.name(node.outputs[0])
    if np.count_nonzero(matrix) > MOST_WRITTEN:
        return _dense_right(node, matrix, rows, writer)
    body = []
    for column in range(columns):
        places = np.flatnonzero(matrix[:, column]).tolist()
        terms = [
            (matrix[k, column], f"{x}[{index((inner, 'i', rows), first=k)}]")
            for k in places
        ]
        kept = f"{out}[{index((columns, 'i', rows), first=column)}] = y;"
        body += block("", [*_sum(terms, c_type), kept])
    return counted("i", rows, body)


def _dense_right(node: Node, matrix: Matrix, rows: int, writer: Writer) -> list[str]:
    """All of a large matrix as a table."""
    c_type = C_TYPES[writer.graph.element(node.outputs[0])]
    inner, columns = matrix.shape
    x, out = writer.name(node.inputs[0]), writer.name(node.outputs[0])
    table = writer.tables.add(f"hf_{out}_weights", matrix, c_type)
    at = index((inner, "i", rows), (1, "k", inner))
    add = _add(c_type, f"{table}[{columns} * k + j]", f"{x}[{at}]", "y[j]")
    return counted(
        "i",
        rows,
        [
            f"{c_type} y[{columns}] = {{0}};",
            *counted("k", inner, counted("j", columns, [add])),
            *counted(
                "j",
                columns,
                [f"{out}[{index((columns, 'i', rows), (1, 'j', columns))}] = y[j];"],
            ),
        ],
    )


def _sum(terms: list[tuple[Any, str]], c_type: str) -> list[str]:
    """`y` as the sum of weight x operand, one term after another."""
    if not terms:
        return [f"const {c_type} y = 0;"]
    lines: list[str] = []
    for weight, operand in terms:
        if not lines:
            plain = {1.0: operand, -1.0: f"-{operand}"}
            first = plain.get(float(weight), f"{number(weight, c_type)} * {operand}")
            lines.append(f"{c_type} y = {first};")
        elif abs(weight) == 1.0:
            lines.append(f"y {'+' if weight > 0 else '-'}= {operand};")
        else:
            lines.append(_add(c_type, number(weight, c_type), operand, "y"))
    return lines


def _add(c_type: str, weight: str, operand: str, total: str) -> str:
    macro = "HF_ADD_PRODUCT" if c_type == "double" else "HF_ADD_PRODUCT_F"
    return f"{total} = {macro}({weight}, {operand}, {total});"
