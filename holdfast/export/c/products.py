"""Products with a constant matrix: sums keep onnxruntime's order.

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

from holdfast.export.c.elementwise import write_loop
from holdfast.export.c.graph import Node, refusal
from holdfast.export.c.literals import C_TYPES, number
from holdfast.export.c.writer import Writer, block, counted, index

Matrix = npt.NDArray[Any]
MOST_TERMS = 12
"""Terms of one sum that are written out, without its zeros; longer sums are loops over a table."""


@dataclass(frozen=True)
class _Product:
    """One product: C names of the computed input and the output, and the C type of the sums."""

    x: str
    out: str
    c_type: str
    writer: Writer


def write_product(node: Node, writer: Writer) -> list[str]:
    """MatMul of one constant matrix with a computed tensor."""
    graph = writer.graph
    (out,) = node.outputs
    left, right = (graph.values(name) for name in node.inputs[:2])
    if (left is None) == (right is None):
        raise refusal(node, "not exactly one of its inputs is constant")

    given = node.inputs[0 if left is None else 1]
    shape = graph.shape(given)
    c_type = C_TYPES[graph.element(out)]
    product = _Product(writer.name(given), writer.name(out), c_type, writer)
    if left is None:
        assert right is not None
        # a vector on the right is a matrix of one column
        matrix = right.reshape(len(right), -1)
        return _constant_right(product, matrix, math.prod(shape[:-1]))
    if math.prod(shape[:-2]) != 1:
        raise refusal(node, "its second input has more than two dimensions")
    return _constant_left(product, left, shape[-1])


def write_gemm(node: Node, writer: Writer) -> list[str]:
    """Gemm of one row: the product, and then the third input."""
    (out,) = node.outputs
    added = Node("Add", (out, node.inputs[2]), (out,), {})
    return [*write_product(node, writer), *write_loop(added, writer)]


def _constant_left(product: _Product, matrix: Matrix, columns: int) -> list[str]:
    """[M, K] x [K, N]: one sum over rows of the input for each row of the output."""
    lines: list[str] = []
    along = (1, "j", columns)
    for row, weights in enumerate(matrix):
        # a product with 0 adds nothing: the guard keeps every number finite
        places = np.flatnonzero(weights).tolist()
        target = f"{product.out}[{index(along, first=row * columns)}]"
        if len(places) <= MOST_TERMS:
            terms = []
            for k in places:
                operand = f"{product.x}[{index(along, first=k * columns)}]"
                terms.append((weights[k], operand))
            lines += _written_out(product, terms, target, "j", columns)
            continue

        # zeros at both ends are left out; those in between add nothing
        first, end = places[0], places[-1] + 1
        name = f"hf_{product.out}_row_{row}"
        table = product.writer.tables.add(name, weights[first:end], product.c_type)
        operand = f"{product.x}[{index((columns, 'k', 2), along)}]"
        weight = f"{table}[k - {first}]"
        lines += _looped(product, weight, operand, target, (first, end), columns)
    return lines


def _constant_right(product: _Product, matrix: Matrix, rows: int) -> list[str]:
    """[M, K] x [K, N]: every row of the input gives N sums."""
    inner, columns = matrix.shape
    if np.count_nonzero(matrix, axis=0).max() > MOST_TERMS:
        # the table is read row by row, as it lies in memory
        name = f"hf_{product.out}_weights"
        table = product.writer.tables.add(name, matrix, product.c_type)
        operand = f"{product.x}[{index((inner, 'i', rows), (1, 'k', inner))}]"
        place = index((columns, "i", rows), (1, "j", columns))
        weight = f"{table}[{index((columns, 'k', 2), (1, 'j', columns))}]"
        target = f"{product.out}[{place}]"
        sums = _looped(product, weight, operand, target, (0, inner), columns)
        return counted("i", rows, sums)

    lines: list[str] = []
    for column, weights in enumerate(matrix.T):
        terms = []
        for k in np.flatnonzero(weights).tolist():
            operand = f"{product.x}[{index((inner, 'i', rows), first=k)}]"
            terms.append((weights[k], operand))
        target = f"{product.out}[{index((columns, 'i', rows), first=column)}]"
        lines += _written_out(product, terms, target, "i", rows)
    return lines


def _looped(
    product: _Product,
    weight: str,
    operand: str,
    target: str,
    terms: tuple[int, int],
    n: int,
) -> list[str]:
    """`n` sums side by side (j), term after term (k, from the first of `terms` to the second)."""
    y = f"y[{index((1, 'j', n))}]"
    add = counted("j", n, [_add(product.c_type, y, weight, operand)])
    body = [f"{product.c_type} y[{n}] = {{0}};"]
    body += counted("k", terms[1], add, first=terms[0])
    body += counted("j", n, [f"{target} = {y};"])
    return block("", body)


def _written_out(
    product: _Product, terms: list[tuple[Any, str]], target: str, counter: str, n: int
) -> list[str]:
    """The sum of weight x operand, one term after another, `n` times."""
    lines = [f"{product.c_type} y = 0;"]
    for weight, operand in terms:
        if abs(weight) == 1.0:
            # a product with 1 or -1 is exact, so a plain sum rounds like the fused one
            sign = "+" if weight > 0.0 else "-"
            lines.append(f"y {sign}= {operand};")
        else:
            factor = number(weight, product.c_type)
            lines.append(_add(product.c_type, "y", factor, operand))
    lines.append(f"{target} = y;")

    # every sum is called y: one outside a loop needs a block of its own
    return counted(counter, n, lines) if n > 1 else block("", lines)


def _add(c_type: str, total: str, weight: str, operand: str) -> str:
    """A C statement that adds weight x operand to a total: fused with HOLDFAST_FUSED, else not."""
    macro = "HF_ADD_PRODUCT" if c_type == "double" else "HF_ADD_PRODUCT_F"
    return f"{total} = {macro}({weight}, {operand}, {total});"
