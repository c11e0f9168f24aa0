"""holdfast_selftest.c: the golden answers of the file as tables, the input by its formula."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.edge_runtime.model import AMPLITUDE, golden_length
from holdfast.export.c.graph import Graph
from holdfast.export.c.literals import C_TYPES, number, smallest_type, table
from holdfast.export.c.templates import template


def selftest_source(graph: Graph, words: Mapping[str, object]) -> str:
    """The text of holdfast_selftest.c."""
    tables, checks = [], []
    for name in graph.outputs:
        answers = graph.golden[name]
        size = int(np.prod(answers.shape[1:]))
        labels = answers.dtype != np.float32 or "votes" in name
        c_type = smallest_type(answers) if labels else C_TYPES[graph.element(name)]
        tables.append(table(f"golden_{name}", answers, c_type))
        checks += _check(name, size, labels)
    more = {
        "ROWS": golden_length(graph.card.settle_samples),
        "AMPLITUDE": number(AMPLITUDE[graph.card.unit], "double"),
        "TABLES": "\n".join(tables),
        "CHECKS": "\n".join(f"        {line}" for line in checks),
    }
    return template("selftest.c", {**words, **more})


def _check(name: str, size: int, labels: bool) -> list[str]:
    """Lines that count where a row's answer differs."""
    field = f"out.{name}" if size > 1 else f"&out.{name}"
    if not labels:
        return [f"floats += far({field}, golden_{name} + {size} * row, {size});"]
    one = f"({field})[k]" if size == 1 else f"{field}[k]"
    return [
        f"for (int k = 0; k < {size}; ++k) labels += {one} != golden_{name}[{size} * row + k];"
    ]
