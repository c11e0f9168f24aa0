"""A graph as C functions: the two halves of a step, the tables that they read, their memory."""

from __future__ import annotations

import math

from holdfast.edge_runtime.onnx_bytes import Node
from holdfast.export.c.graph import FEATURES, INPUTS, Graph, refusal
from holdfast.export.c.literals import Tables
from holdfast.export.c.memory import SCRATCH, Memory
from holdfast.export.c.operators import write_step
from holdfast.export.c.plan import Plan, Step, plan_of
from holdfast.export.c.views import View, views_of
from holdfast.export.c.whole import Whole
from holdfast.export.c.whole_products import whole_types
from holdfast.export.c.writer import Names, Writer

CALL_BYTES = 256
"""Stack of calls and registers beside the scratch arrays."""


class Compiled:
    """All functions of the step, the tables that they read, and how much memory they take."""

    def __init__(self, graph: Graph) -> None:
        """Raises NotCompilable."""
        self.tables = Tables()
        self._graph, self._names, self._number = graph, Names(), 0
        self._whole = Whole(graph)
        views = views_of(graph)
        plan = plan_of(graph, views)
        types = whole_types(graph, plan, self._whole)
        outside = {name: name for name in (*INPUTS, FEATURES)}
        made_early = {name for step in plan.sense for name in step.outputs}
        early = {name: at for name, at in _fields(graph).items() if name in made_early}
        late = {
            name: at for name, at in _fields(graph).items() if name not in made_early
        }
        sense = Memory(graph, views, plan.sense, types, outside | early, plan.keep)
        answer = Memory(graph, views, plan.answer, types, {FEATURES: FEATURES, **late})
        _require_apart(graph, plan, views)
        _require_outputs(graph, plan)
        self.sense = self._part(plan.sense, sense, _kept_state(graph, plan.keep, sense))
        self.answer = self._part(plan.answer, answer, [])
        self.state_bytes = 8 + 8 * math.prod(graph.shape("state"))
        scratch = max(sense.scratch_bytes(), answer.scratch_bytes())
        self.stack_bytes = scratch + 4 * graph.n_features + CALL_BYTES

    def _part(
        self, steps: list[Step], memory: Memory, end: list[str]
    ) -> tuple[str, str]:
        """(definitions, body of the function that calls them in order)."""
        writer = Writer(self._graph, memory, self.tables, self._names, self._whole)
        functions = []
        for step in steps:
            if any(memory.is_kept(name) for name in step.outputs):
                functions.append(write_step(step, self._number, writer))
                self._number += 1
        scratch = [
            f"{c_type} {SCRATCH[c_type]}[{size}];"
            for c_type, size in memory.sizes.items()
            if size
        ]
        lines = [*scratch, *(one.call for one in functions), *end]
        definitions = "\n".join(one.definition for one in functions)
        return definitions, "\n".join(f"    {line}" for line in lines)


def _fields(graph: Graph) -> dict[str, str]:
    """Output -> where the caller's struct has it."""
    return {
        name: f"out->{name}" if math.prod(graph.shape(name)) > 1 else f"&out->{name}"
        for name in graph.outputs
    }


def _require_apart(graph: Graph, plan: Plan, views: dict[str, View]) -> None:
    """Raise NotCompilable where an answer depends on more than the features."""
    own = {FEATURES, *(name for step in plan.answer for name in step.outputs)}
    for node in (node for step in plan.answer for node in step.nodes):
        for name in node.inputs:
            base = views[name].base if name in views else name
            if base not in own and graph.values(base) is None:
                raise refusal(node, "an answer depends on more than the features")


def _require_outputs(graph: Graph, plan: Plan) -> None:
    """Raise NotCompilable where an output only names a part of another tensor."""
    made = {name for step in (*plan.sense, *plan.answer) for name in step.outputs}
    for name in (*graph.outputs, FEATURES):
        if name not in made:
            (node,) = [node for node in graph.nodes if name in node.outputs]
            raise refusal(node, "an output is only a part of another tensor")


def _kept_state(graph: Graph, node: Node, memory: Memory) -> list[str]:
    """The next state, in place: each part moves towards the front, or comes from elsewhere."""
    if node.op_type != "Concat":
        raise refusal(node, "the next state is not joined from parts")
    lines, at = [], 0
    for name in node.inputs:
        place, size = memory.place(name), math.prod(graph.shape(name))
        inside = place.array == "state"
        if (inside and place.offset < at) or graph.values(name) is not None:
            raise refusal(node, "a part of the state moves backwards, or is constant")
        call = "memmove" if inside else "memcpy"
        lines.append(
            f"{call}(state + {at}, {place.address()}, {size} * sizeof *state);"
        )
        at += size
    return lines
