"""A graph as C: the two halves of a step in the order of the graph, their tables and memory."""

from __future__ import annotations

from holdfast.export.c.graph import FEATURES, INPUTS, NEXT_STATE, Graph, Node, refusal
from holdfast.export.c.literals import Tables
from holdfast.export.c.loops import Writer
from holdfast.export.c.memory import SCRATCH, Memory, views_of
from holdfast.export.c.operators import body_of

CALL_BYTES = 256
"""Stack of calls and registers, in addition to the scratch arrays."""


class StepCode:
    """Both halves of the step as C, the tables that they read, and the memory of one hand.

    state_bytes: kept from sample to sample. stack_bytes: of one step, while it runs.
    """

    def __init__(self, graph: Graph) -> None:
        """Raises NotCompilable."""
        self.tables = Tables()
        self._graph = graph
        views = views_of(graph)
        first, second = _halves(graph)

        # the caller's arrays and the fields of its struct
        outside = {name: name for name in (*INPUTS, FEATURES)}
        outside[NEXT_STATE] = "state"
        for name in graph.outputs:
            is_array = graph.size(name) > 1
            outside[name] = f"out->{name}" if is_array else f"&out->{name}"
        sense = Memory(graph, views, first, outside)
        answer = Memory(graph, views, second, outside)
        self.sense = self._half(first, sense)
        self.answer = self._half(second, answer)

        # a tag of the model in front of the numbers, so that no other model's state is read
        self.state_bytes = 8 + 8 * graph.size("state")
        # both halves run one after the other, so the larger one counts
        scratch = max(sense.scratch_bytes(), answer.scratch_bytes())
        # holdfast_step keeps the features on the stack, as floats of four bytes.
        self.stack_bytes = scratch + 4 * graph.n_features + CALL_BYTES

    def _half(self, nodes: list[Node], memory: Memory) -> list[str]:
        """The lines of a C function that computes these nodes in order."""
        writer = Writer(self._graph, memory, self.tables)
        lines = []
        for c_type, size in memory.sizes.items():
            lines.append(f"{c_type} {SCRATCH[c_type]}[{size}];")
        for node in nodes:
            if NEXT_STATE in node.outputs:
                lines += _kept_state(self._graph, node, memory)
            # what nothing reads is not computed, and a view is there already
            elif any(memory.is_kept(name) for name in node.outputs):
                lines += writer.step(node, body_of(node, writer))
        return lines


def _halves(graph: Graph) -> tuple[list[Node], list[Node]]:
    """Nodes up to the features, of which the last one joins the next state; nodes behind them."""
    behind = {FEATURES}
    sense: list[Node] = []
    answer: list[Node] = []
    last: list[Node] = []
    for node in graph.nodes:
        if NEXT_STATE in node.outputs:
            # all others read the state as it was
            last.append(node)
        elif behind.isdisjoint(node.inputs):
            sense.append(node)
        else:
            behind.update(node.outputs)
            answer.append(node)
    return sense + last, answer


def _kept_state(graph: Graph, node: Node, memory: Memory) -> list[str]:
    """The next state, in place: each part moves towards the front, or comes from elsewhere."""
    lines = []
    at = 0
    for name in node.inputs:
        array, offset = memory.place(name)
        size = graph.size(name)
        inside = array == "state"
        # a part that moves backwards would be overwritten before it is copied
        if inside and offset < at:
            raise refusal(node, "a part of the state moves backwards")

        # source and target overlap where rows of the history move up by one
        copy = "memmove" if inside else "memcpy"
        source = f"{array} + {offset}"
        lines.append(f"{copy}(state + {at}, {source}, {size} * sizeof *state);")
        at += size
    return lines
