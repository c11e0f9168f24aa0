"""Products of whole numbers in integers: 16-bit inputs, weights of the smallest type, 32-bit sums.

A row of the table holds one unit's weights. Units that read the same inputs share a loop; inputs
that no unit of a loop reads are left out. Ranges are multiples of PACKED, as vector units need.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.onnx_bytes import FLOAT, Node
from holdfast.export.c.graph import Graph
from holdfast.export.c.literals import smallest_type
from holdfast.export.c.plan import BY_NUMBER, Plan
from holdfast.export.c.whole import Whole
from holdfast.export.c.writer import Writer, block, counted, index

PACKED = 8
TOGETHER = 4
"""Units whose sums are made at once: they share each input that is read."""
INPUT_TYPE, SUM_TYPE = "int16_t", "int32_t"
MOST_INPUT = 2**15 - 1


def whole_types(graph: Graph, plan: Plan, whole: Whole) -> dict[str, str]:
    """C types of the tensors of products that are computed in integers: inputs and sums."""
    types: dict[str, str] = {}
    loops = {
        id(node)
        for step in plan.answer
        if step.shape is not None
        for node in step.nodes
    }
    readers = _readers(graph)
    for node in graph.nodes:
        if node.op_type != "MatMul" or graph.element(node.outputs[0]) != FLOAT:
            continue
        values, (total,) = node.inputs[0], node.outputs
        bounds = whole.bounds(values)
        fits = bounds is not None and max(-bounds[0], bounds[1]) <= MOST_INPUT
        alone = all(one.op_type == "MatMul" for one in readers[values])
        into_loops = all(
            id(one) in loops and one.op_type in BY_NUMBER for one in readers[total]
        )
        if fits and alone and into_loops and whole.sums_are_exact(node):
            types |= {values: INPUT_TYPE, total: SUM_TYPE}
    return types


def _readers(graph: Graph) -> dict[str, list[Node]]:
    """The nodes that read a tensor; a node in the loop that makes it reads it there."""
    readers: dict[str, list[Node]] = {name: [] for name in graph.tensors}
    for node in graph.nodes:
        for name in node.inputs:
            readers[name].append(node)
    return readers


@dataclass(frozen=True)
class _Units:
    """Units that read the same inputs: C names of input, output and table, and places there."""

    x: str
    out: str
    table: str
    c_type: str
    first_input: int
    width: int
    first_unit: int
    count: int


def write_whole_product(
    node: Node, matrix: npt.NDArray[Any], writer: Writer
) -> list[str]:
    """The sums of all units, loop by loop."""
    x, out = writer.name(node.inputs[0]), writer.name(node.outputs[0])
    ranges = [_range(column) for column in matrix.T]
    lines: list[str] = []
    unit = 0
    for number, ((first, last), same) in enumerate(groupby(ranges)):
        count = len(list(same))
        weights = np.zeros((count, last - first))
        within = matrix[first:last, unit : unit + count].T
        weights[:, : within.shape[1]] = within
        name = f"hf_{out}_weights_{number}"
        c_type = smallest_type(weights)
        table = writer.tables.add(name, weights, c_type)
        units = _Units(x, out, table, c_type, first, last - first, unit, count)
        lines += _sums(units, 0, TOGETHER) + _sums(units, count - count % TOGETHER, 1)
        unit += count
    return lines


def _sums(units: _Units, begin: int, together: int) -> list[str]:
    """A loop over units from `begin` on, some at once."""
    passes = (units.count - begin) // together
    if not passes:
        return []
    value = f"{units.x}[{index((1, 'k', units.width), first=units.first_input)}]"
    sums = [f"y{n}" for n in range(together)]
    adds, kept = [], []
    for n, total in enumerate(sums):
        row = index((1, "k", units.width), first=n * units.width)
        adds.append(f"{total} += {value} * row[{row}];")
        at = index((together, "i", passes), first=units.first_unit + begin + n)
        kept.append(f"{units.out}[{at}] = {total};")
    start = index((together * units.width, "i", passes), first=begin * units.width)
    body = [
        f"const {units.c_type} *row = {units.table} + {start};",
        f"int32_t {', '.join(f'{total} = 0' for total in sums)};",
        *counted("k", units.width, adds),
        *kept,
    ]
    return counted("i", passes, body) if passes > 1 else block("", body)


def _range(column: npt.NDArray[Any]) -> tuple[int, int]:
    """The inputs that a unit reads: first, and one past the last, in multiples of PACKED."""
    places = np.flatnonzero(column)
    if not len(places):
        return 0, PACKED
    return int(places[0]) // PACKED * PACKED, -(
        -(int(places[-1]) + 1) // PACKED
    ) * PACKED
