"""Products with a constant matrix: zeros are left out, sums keep onnxruntime's order.

onnxruntime adds the products of a sum one after another, in the order of the inner axis, each by a
fused multiply-add. `HF_ADD_PRODUCT` is that with HOLDFAST_FUSED, and else two roundings, which any
processor has. Products with 0, 1 and -1, and whole numbers below 2^24, are exact in any order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.export.c.graph import Node, refusal
from holdfast.export.c.literals import C_TYPES, number
from holdfast.export.c.writer import Writer, block, counted, index

Matrix = npt.NDArray[Any]
MOST_TERMS = 12
"""Terms of one sum that are written out; longer sums with a constant on the left are loops."""
MOST_SUMS = 4
"""Sums that a loop keeps in registers."""
MOST_WRITTEN = 600
"""Terms of a whole product that are written out where the constant is on the right."""


@dataclass(frozen=True)
class _Product:
    """A product with a constant matrix: C names of the computed input and the output.

    matrix: [M, K] where the constant is on the left, [K, N] where it is on the right. c_type: of
    the sums, double or float.
    """

    matrix: Matrix
    x: str
    out: str
    c_type: str
    writer: Writer


def write_product(node: Node, writer: Writer) -> list[str]:
    """MatMul of one constant matrix with a computed tensor."""
    graph = writer.graph
    (out,) = node.outputs
    left = graph.values(node.inputs[0])
    right = graph.values(node.inputs[1])

    # The order of a sum is that of the inner axis, whichever side is the constant one.
    c_type = C_TYPES[graph.element(out)]

    if left is not None and right is None and left.ndim == 2:
        x = writer.name(node.inputs[1])
        shape = graph.shape(node.inputs[1])
        if math.prod(shape[:-2]) != 1:
            raise refusal(node, "its second input has more than two dimensions")

        product = _Product(left, x, writer.name(out), c_type, writer)
        return _constant_left(product, shape[-1])

    if right is not None and left is None and right.ndim <= 2:
        x = writer.name(node.inputs[0])
        shape = graph.shape(node.inputs[0])
        # a vector on the right is a matrix of one column
        matrix = right.reshape(len(right), -1)
        product = _Product(matrix, x, writer.name(out), c_type, writer)
        rows = math.prod(shape[:-1])
        return _constant_right(product, rows)

    raise refusal(node, "neither of its inputs is a constant matrix")


def _constant_left(product: _Product, columns: int) -> list[str]:
    """[M, K] x [K, N]: one sum over rows of the input for each row of the output."""
    lines: list[str] = []
    along = (1, "j", columns)

    for row, weights in enumerate(product.matrix):
        # a product with 0 adds nothing: the guard keeps every number finite
        places = np.flatnonzero(weights).tolist()
        if len(places) > MOST_TERMS:
            lines += _long_row(product, row, columns)
            continue

        terms = []
        for k in places:
            place = index(along, first=k * columns)
            terms.append((weights[k], f"{product.x}[{place}]"))

        target = index(along, first=row * columns)
        body = _sum(terms, product.c_type)
        body.append(f"{product.out}[{target}] = y;")

        # every sum is called y: one outside a loop needs a block of its own
        if columns > 1:
            lines += counted("j", columns, body)
        else:
            lines += block("", body)

    return lines


def _long_row(product: _Product, row: int, columns: int) -> list[str]:
    """A sum over a range of rows of the input, in a loop for some columns at once."""
    c_type = product.c_type
    weights = product.matrix[row]
    places = np.flatnonzero(weights)
    # Zeros at both ends are left out; those in between are terms of the loop that add nothing.
    first = int(places[0])
    end = int(places[-1]) + 1
    used = weights[first:end]

    # a mean has one weight for all its terms: no table is needed
    if len(np.unique(used)) == 1:
        weight = number(used[0], c_type)
    else:
        name = f"hf_{product.out}_row_{row}"
        table = product.writer.tables.add(name, used, c_type)
        weight = f"{table}[k - {first}]" if first else f"{table}[k]"

    # Sums of neighbouring columns do not wait for each other, and read one row of the input.
    lines = []
    for start in range(0, columns, MOST_SUMS):
        zeros = []
        adds = []
        kept = []
        stop = min(columns, start + MOST_SUMS)
        for n in range(start, stop):
            # The 2 stands for a loop of more than one pass: k is always written.
            place = index((columns, "k", 2), first=n)
            operand = f"{product.x}[{place}]"
            zeros.append(f"y{n} = 0")
            adds.append(_add(c_type, f"y{n}", weight, operand))
            kept.append(f"{product.out}[{row * columns + n}] = y{n};")

        loop = counted("k", end, adds, first=first)
        declared = f"{c_type} {', '.join(zeros)};"
        lines += block("", [declared, *loop, *kept])

    return lines


def _constant_right(product: _Product, rows: int) -> list[str]:
    """[M, K] x [K, N]: every row of the input gives N sums."""
    inner, columns = product.matrix.shape
    # Written out, a sum needs neither a table nor its zeros; a large matrix would be much code.
    if np.count_nonzero(product.matrix) > MOST_WRITTEN:
        return _dense_right(product, rows)

    lines: list[str] = []
    for column, weights in enumerate(product.matrix.T):
        terms = []
        for k in np.flatnonzero(weights).tolist():
            place = index((inner, "i", rows), first=k)
            terms.append((weights[k], f"{product.x}[{place}]"))

        target = index((columns, "i", rows), first=column)
        body = _sum(terms, product.c_type)
        body.append(f"{product.out}[{target}] = y;")
        lines += block("", body)

    return counted("i", rows, lines)


def _dense_right(product: _Product, rows: int) -> list[str]:
    """All of a large matrix as a table."""
    c_type = product.c_type
    inner, columns = product.matrix.shape
    name = f"hf_{product.out}_weights"
    table = product.writer.tables.add(name, product.matrix, c_type)

    place = index((inner, "i", rows), (1, "k", inner))
    operand = f"{product.x}[{place}]"
    weight = f"{table}[{columns} * k + j]"
    add = _add(c_type, "y[j]", weight, operand)
    target = index((columns, "i", rows), (1, "j", columns))

    # The inner axis is the outer loop: the table is read row by row, as it lies in memory, and
    # each sum still adds its terms in the order of the inner axis.
    adds = counted("k", inner, counted("j", columns, [add]))
    copies = counted("j", columns, [f"{product.out}[{target}] = y[j];"])
    body = [f"{c_type} y[{columns}] = {{0}};", *adds, *copies]
    return counted("i", rows, body)


def _sum(terms: list[tuple[Any, str]], c_type: str) -> list[str]:
    """`y` as the sum of weight x operand, one term after another."""
    if not terms:
        return [f"const {c_type} y = 0;"]

    # The first product is rounded once, as a fused multiply-add to zero would round it.
    weight, operand = terms[0]
    signs = {1.0: "", -1.0: "-"}
    factor = f"{number(weight, c_type)} * "
    sign = signs.get(float(weight), factor)
    lines = [f"{c_type} y = {sign}{operand};"]

    # a product with 1 or -1 is exact, so a plain sum rounds like the fused one
    for weight, operand in terms[1:]:
        if abs(weight) == 1.0:
            sign = "+" if weight > 0 else "-"
            lines.append(f"y {sign}= {operand};")
        else:
            lines.append(_add(c_type, "y", number(weight, c_type), operand))

    return lines


def _add(c_type: str, total: str, weight: str, operand: str) -> str:
    """A C statement that adds weight x operand to a total: fused with HOLDFAST_FUSED, else not."""
    macro = "HF_ADD_PRODUCT" if c_type == "double" else "HF_ADD_PRODUCT_F"
    return f"{total} = {macro}({weight}, {operand}, {total});"
