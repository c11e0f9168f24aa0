"""Float tensors that hold whole numbers, and their products in integers.

A network's sums are whole numbers below 2^24: float32 holds them exactly, and so do the integers of
a processor, which are faster and take half the memory. `Whole` proves where that may be used, for
any sample. Such a product has 16-bit inputs, weights of the smallest type and 32-bit sums. A row of
the table holds one unit's weights. Units that read the same inputs share a loop; inputs that no
unit of a loop reads are left out. Ranges are multiples of PACKED, as vector units need.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.export.c.graph import FLOAT, Graph, Node
from holdfast.export.c.literals import smallest_type
from holdfast.export.c.plan import BY_NUMBER, Plan
from holdfast.export.c.writer import Writer, block, counted, index

Bounds = tuple[float, float]
ANYTHING: Bounds = (-math.inf, math.inf)
EXACT_FLOAT32 = 2**24
"""Whole numbers below it are exact in float32."""
PACKED = 8
"""Numbers of 16 bits in a vector of 128 bits."""
TOGETHER = 4
"""Units whose sums are made at once: they share each input that is read."""
INPUT_TYPE = "int16_t"
SUM_TYPE = "int32_t"
"""Holds every sum of such a product: all are proved to be below 2^24."""
MOST_INPUT = 2**15 - 1
"""The largest magnitude that INPUT_TYPE holds with either sign."""


class Whole:
    """Bounds of the float tensors of a graph, followed backwards."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._made_by = {name: node for node in graph.nodes for name in node.outputs}

        # many tensors are asked about, and each answer follows the graph back to its inputs
        self._bounds = cache(self._find_bounds)

    def largest(self, name: str) -> float | None:
        """The largest magnitude of a float tensor that holds whole numbers, else None."""
        if self._graph.element(name) != FLOAT or not self._is_whole(name):
            return None

        # A limit is needed too: a whole number without a bound fits no integer.
        least, most = self._bounds(name)
        if not math.isfinite(most - least):
            return None
        return max(-least, most)

    def sums_are_exact(self, node: Node) -> bool:
        """Whether a product of whole numbers with a constant matrix stays below 2^24."""
        weights = self._graph.values(node.inputs[1])
        largest = self.largest(node.inputs[0])
        if weights is None or largest is None:
            return False
        if (weights != np.round(weights)).any():
            return False

        # The magnitudes bound every partial sum too, so the order of the terms does not matter.
        largest_sums = largest * np.abs(weights).sum(axis=0)
        return bool((largest_sums < EXACT_FLOAT32).all())

    def _is_whole(self, name: str) -> bool:
        """Whether a tensor holds whole numbers alone: by its constants, or by its operator."""
        values = self._graph.values(name)
        node = self._made_by.get(name)

        if values is not None:
            return bool((values == np.round(values)).all())
        if node is None:
            return False

        # a limit that is not whole would make numbers that are not
        if node.op_type == "Clip":
            return all(self._is_whole(one) for one in node.inputs)
        return node.op_type == "Round"

    def _find_bounds(self, name: str) -> Bounds:
        """(least, most) of a tensor's numbers, from those of what it is made of."""
        values = self._graph.values(name)
        node = self._made_by.get(name)

        if values is not None:
            return float(values.min()), float(values.max())
        if node is None or node.op_type not in _RULES:
            return ANYTHING
        return _RULES[node.op_type](self, node)

    def of_round(self, node: Node) -> Bounds:
        """To the nearest whole number."""
        least, most = self._bounds(node.inputs[0])
        return float(np.floor(least)), float(np.ceil(most))

    def of_clip(self, node: Node) -> Bounds:
        """Within two constants."""
        least, most = node.inputs[1:]
        return self._bounds(least)[0], self._bounds(most)[1]

    def with_constant(self, node: Node) -> Bounds:
        """A sum or a product with a constant, number by number."""
        least, most = self._each(node)
        return float(least.min()), float(most.max())

    def _each(self, node: Node) -> tuple[np.ndarray, np.ndarray]:
        """(least, most) of every number: each feature has its gain and its offset."""
        first, second = node.inputs
        values = self._graph.values(second)
        inner = self._made_by.get(first)
        if values is None:
            return np.array(-math.inf), np.array(math.inf)

        # Gain and offset of one feature belong together: the bounds of all features at once
        # would add the largest gain to the largest offset.
        is_sum = node.op_type == "Add"
        if is_sum and inner is not None and inner.op_type == "Mul":
            low, high = self._each(inner)
        else:
            bounds = self._bounds(first)
            low = np.array(bounds[0])
            high = np.array(bounds[1])

        if is_sum:
            return low + values, high + values
        # infinity times a gain of 0 is NaN, which bounds nothing
        if not np.isfinite(high - low).all():
            return np.array(-math.inf), np.array(math.inf)

        # a negative factor swaps the ends
        ends = np.stack([low * values, high * values])
        least = ends.min(axis=0)
        most = ends.max(axis=0)
        return least, most

    def of_product(self, node: Node) -> Bounds:
        """A sum of inputs times constant weights."""
        weights = self._graph.values(node.inputs[1])
        least, most = self._bounds(node.inputs[0])
        if weights is None or not math.isfinite(most - least):
            return ANYTHING

        # One bound serves all units: that of the unit with the largest weights.
        magnitudes = np.abs(weights).sum(axis=0)
        largest = float(max(-least, most) * magnitudes.max())
        return -largest, largest

    def of_quotient(self, node: Node) -> Bounds:
        """x / (|x| + k) with k > 0 is within 1."""
        above, below = node.inputs
        total = self._made_by.get(below)
        if total is None or total.op_type != "Add":
            return ANYTHING

        size = self._made_by.get(total.inputs[0])
        knee = total.inputs[1]
        if size is None or size.op_type != "Abs" or size.inputs[0] != above:
            return ANYTHING

        values = self._graph.values(knee)
        if values is None or not (values > 0).all():
            return ANYTHING

        # |x| / (|x| + k) is below 1 for every finite x, and rounding can only bring it to 1
        return -1.0, 1.0


_RULES: dict[str, Callable[[Whole, Node], Bounds]] = {
    "Round": Whole.of_round,
    "Clip": Whole.of_clip,
    "Add": Whole.with_constant,
    "Mul": Whole.with_constant,
    "Div": Whole.of_quotient,
    "MatMul": Whole.of_product,
}


def whole_types(graph: Graph, plan: Plan, whole: Whole) -> dict[str, str]:
    """C types of the tensors of products that are computed in integers: inputs and sums."""
    types: dict[str, str] = {}
    # Networks stand behind the features, so only loops of the second half matter.
    in_loops: set[str] = set()
    for step in plan.answer:
        if step.shape is not None:
            in_loops.update(step.outputs)

    readers = _readers(graph)
    for node in graph.nodes:
        if node.op_type != "MatMul" or graph.element(node.outputs[0]) != FLOAT:
            continue

        values = node.inputs[0]
        (total,) = node.outputs
        largest = whole.largest(values)
        fits = largest is not None and largest <= MOST_INPUT

        # Only products read 16-bit inputs, and only loops convert 32-bit sums: any other reader
        # needs the tensor in its own type.
        alone = all(reader.op_type == "MatMul" for reader in readers[values])
        into_loops = True
        for reader in readers[total]:
            is_in_loop = reader.outputs[0] in in_loops and reader.op_type in BY_NUMBER
            into_loops = into_loops and is_in_loop

        if fits and alone and into_loops and whole.sums_are_exact(node):
            types[values] = INPUT_TYPE
            types[total] = SUM_TYPE

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
    """Units that read the same inputs: C names of input, output and table, and places there.

    first_input, width: the range of inputs. first_unit, count: the units, as in the output.
    """

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
    x = writer.name(node.inputs[0])
    out = writer.name(node.outputs[0])
    ranges = [_range(column) for column in matrix.T]

    # units that follow each other and read the same range share one loop over their inputs
    lines: list[str] = []
    unit = 0
    for number, ((first, last), same) in enumerate(groupby(ranges)):
        count = len(list(same))

        # The matrix is [inputs, units]; its transpose lets each sum read the table in order.
        weights = np.zeros((count, last - first))
        within = matrix[first:last, unit : unit + count].T
        # the last range may end behind the last input: its weights there are 0
        weights[:, : within.shape[1]] = within

        c_type = smallest_type(weights)
        table = writer.tables.add(f"hf_{out}_weights_{number}", weights, c_type)

        units = _Units(
            x=x,
            out=out,
            table=table,
            c_type=c_type,
            first_input=first,
            width=last - first,
            first_unit=unit,
            count=count,
        )

        # as many as possible by fours, the rest one by one
        lines += _sums(units, 0, TOGETHER)
        lines += _sums(units, count - count % TOGETHER, 1)
        unit += count

    return lines


def _sums(units: _Units, begin: int, together: int) -> list[str]:
    """A loop over units from `begin` on, some at once."""
    passes = (units.count - begin) // together
    if not passes:
        return []

    # A table has one row a unit, row behind row: unit n of a pass begins n widths further on.
    width = units.width
    along = (1, "k", width)
    value = f"{units.x}[{index(along, first=units.first_input)}]"
    zeros = []
    adds = []
    kept = []
    for n in range(together):
        zeros.append(f"y{n} = 0")
        row = index(along, first=n * width)
        adds.append(f"y{n} += {value} * row[{row}];")
        first_unit = units.first_unit + begin + n
        target = index((together, "i", passes), first=first_unit)
        kept.append(f"{units.out}[{target}] = y{n};")

    start = index((together * width, "i", passes), first=begin * width)
    loop = counted("k", width, adds)
    body = [
        f"const {units.c_type} *row = {units.table} + {start};",
        f"int32_t {', '.join(zeros)};",
        *loop,
        *kept,
    ]
    if passes > 1:
        return counted("i", passes, body)
    return block("", body)


def _range(column: npt.NDArray[Any]) -> tuple[int, int]:
    """The inputs that a unit reads: first, and one past the last, in multiples of PACKED."""
    places = np.flatnonzero(column)
    if not len(places):
        return 0, PACKED

    first_group = int(places[0]) // PACKED
    last_group = int(places[-1]) // PACKED
    return first_group * PACKED, (last_group + 1) * PACKED
