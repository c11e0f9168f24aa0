"""A graph as C functions: the two halves of a step, the tables that they read, their memory."""

from __future__ import annotations

import math
from collections.abc import Callable

from holdfast.edge_runtime.model_file import EMPTY
from holdfast.export.c.graph import FEATURES, INPUTS, Graph, Node, refusal
from holdfast.export.c.literals import Tables
from holdfast.export.c.loops import write_loop
from holdfast.export.c.memory import SCRATCH, Memory
from holdfast.export.c.moves import (
    write_arg_max,
    write_concat,
    write_gather,
    write_reduction,
    write_slice,
    write_softmax,
    write_split,
    write_transpose,
)
from holdfast.export.c.plan import Plan, Step, View, plan_of, views_of
from holdfast.export.c.products import write_product
from holdfast.export.c.trees import write_trees
from holdfast.export.c.writer import Function, Names, Writer, function

CALL_BYTES = 256
"""Stack of calls and registers, in addition to the scratch arrays."""
EMITTERS: dict[str, Callable[[Node, Writer], list[str]]] = {
    "ArgMax": write_arg_max,
    "Concat": write_concat,
    "Gather": write_gather,
    "MatMul": write_product,
    "ReduceL2": write_reduction,
    "ReduceMax": write_reduction,
    "ReduceMin": write_reduction,
    "ReduceSum": write_reduction,
    "Slice": write_slice,
    "Softmax": write_softmax,
    "Split": write_split,
    "Transpose": write_transpose,
    "TreeEnsembleRegressor": write_trees,
}
"""The body of each operator that stands alone; loops.py has those that go number by number."""


class StepCode:
    """All functions of the step, the tables that they read, and how much memory they take."""

    def __init__(self, graph: Graph) -> None:
        """Raises NotCompilable."""
        self.tables = Tables()
        self._graph = graph
        self._names = Names()
        self._n_functions = 0
        views = views_of(graph)
        plan = plan_of(graph, views)

        made_early = {name for step in plan.sense for name in step.node.outputs}

        # an output lies in the caller's struct: only the half that makes it knows it
        early = {name: name for name in (*INPUTS, FEATURES)}
        # what the sensing half finds out about contact, the answering half reads in the struct
        late = {FEATURES: FEATURES}
        if EMPTY in graph.outputs:
            late[EMPTY] = _fields(graph)[EMPTY]
        for name, field in _fields(graph).items():
            places = early if name in made_early else late
            places[name] = field

        sense = Memory(graph, views, plan.sense, early, plan.keep)
        answer = Memory(graph, views, plan.answer, late)
        _require_apart(graph, plan, views)
        _require_outputs(graph, plan)

        next_state = _kept_state(graph, plan.keep, sense)
        self.sense = self._part(plan.sense, sense, next_state)
        self.answer = self._part(plan.answer, answer, [])

        # a tag of the model in front of the numbers, so that no other model's state is read
        self.state_bytes = 8 + 8 * math.prod(graph.shape("state"))
        # both halves run one after the other, so the larger one counts
        scratch = max(sense.scratch_bytes(), answer.scratch_bytes())
        # holdfast_step keeps the features on the stack, as floats of four bytes.
        self.stack_bytes = scratch + 4 * graph.n_features + CALL_BYTES

    def _part(
        self, steps: list[Step], memory: Memory, end: list[str]
    ) -> tuple[str, str]:
        """(definitions, body of the function that calls them in order)."""
        writer = Writer(self._graph, memory, self.tables, self._names)
        definitions = []
        calls = []
        for step in steps:
            # a step that nothing reads is not written
            if any(memory.is_kept(name) for name in step.node.outputs):
                made = _write_step(step, self._n_functions, writer)
                definitions.append(made.definition)
                calls.append(made.call)
                self._n_functions += 1

        lines = []
        for c_type, size in memory.sizes.items():
            if size:
                lines.append(f"    {c_type} {SCRATCH[c_type]}[{size}];")

        for line in [*calls, *end]:
            lines.append(f"    {line}")

        return "\n".join(definitions), "\n".join(lines)


def _write_step(step: Step, number: int, writer: Writer) -> Function:
    """The C function of a step. Raises NotCompilable for an operator without a C form."""
    if step.shape is not None:
        return function(step, number, write_loop(step, writer), writer)

    node = step.node
    emitter = EMITTERS.get(node.op_type)
    if emitter is None:
        raise refusal(node, "it has no C form")
    return function(step, number, emitter(node, writer), writer)


def _fields(graph: Graph) -> dict[str, str]:
    """Output -> where the caller's struct has it."""
    fields = {}
    for name in graph.outputs:
        is_array = math.prod(graph.shape(name)) > 1
        fields[name] = f"out->{name}" if is_array else f"&out->{name}"
    return fields


def _require_apart(graph: Graph, plan: Plan, views: dict[str, View]) -> None:
    """Raise NotCompilable where an answer depends on more than the features and contact."""
    # holdfast_answer takes no more, so that a test can put a row on every threshold.
    known = {FEATURES, EMPTY}
    for step in plan.answer:
        known.update(step.node.outputs)

    for step in plan.answer:
        for name in step.node.inputs:
            base = views[name].base if name in views else name
            if base not in known and graph.values(base) is None:
                raise refusal(
                    step.node, "an answer depends on more than features and contact"
                )


def _require_outputs(graph: Graph, plan: Plan) -> None:
    """Raise NotCompilable where an output only names a part of another tensor."""
    # A part has no memory of its own, so no step would write the caller's field.
    made: set[str] = set()
    for step in (*plan.sense, *plan.answer):
        made.update(step.node.outputs)

    for node in graph.nodes:
        for name in node.outputs:
            if name in (*graph.outputs, FEATURES) and name not in made:
                raise refusal(node, "an output is only a part of another tensor")


def _kept_state(graph: Graph, node: Node, memory: Memory) -> list[str]:
    """The next state, in place: each part moves towards the front, or comes from elsewhere."""
    if node.op_type != "Concat":
        raise refusal(node, "the next state is not joined from parts")

    lines = []
    at = 0
    for name in node.inputs:
        place = memory.place(name)
        size = math.prod(graph.shape(name))
        inside = place.array == "state"
        # a part that moves backwards would be overwritten before it is copied
        if (inside and place.offset < at) or graph.values(name) is not None:
            raise refusal(node, "a part of the state moves backwards, or is constant")

        # source and target overlap where rows of the history move up by one
        copy = "memmove" if inside else "memcpy"
        source = place.address()
        lines.append(f"{copy}(state + {at}, {source}, {size} * sizeof *state);")
        at += size

    return lines
