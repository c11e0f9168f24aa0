"""The order of the work: nodes that go number by number share one loop, all others stand alone."""

from __future__ import annotations

from dataclasses import dataclass

from holdfast.edge_runtime.onnx_bytes import Node
from holdfast.export.c.graph import FEATURES, NEXT_STATE, Graph, Shape
from holdfast.export.c.views import View

BY_NUMBER = frozenset(
    [
        "Abs",
        "Add",
        "And",
        "Cast",
        "Clip",
        "Div",
        "Floor",
        "Greater",
        "GreaterOrEqual",
        "Less",
        "Max",
        "Min",
        "Mul",
        "Round",
        "Sqrt",
        "Sub",
        "Where",
    ]
)
"""Operators that make each number of their output from one number of each input."""


@dataclass(frozen=True)
class Step:
    """Nodes that one C function computes. shape: of its loop, without ones; None: one node."""

    nodes: list[Node]
    shape: Shape | None = None

    @property
    def outputs(self) -> list[str]:
        """The tensors that it makes."""
        return [name for node in self.nodes for name in node.outputs]


@dataclass(frozen=True)
class Plan:
    """Steps up to the features, the node that joins the next state, steps from the features on."""

    sense: list[Step]
    keep: Node
    answer: list[Step]


def plan_of(graph: Graph, views: dict[str, View]) -> Plan:
    """Cut the graph at its features; what follows them is a function of them alone."""
    after = {FEATURES}
    sense, answer = _Order(graph, views), _Order(graph, views)
    (keep,) = [node for node in graph.nodes if NEXT_STATE in node.outputs]
    for node in graph.nodes:
        if any(name in views for name in node.outputs) or node is keep:
            after |= set(node.outputs) if node.inputs[0] in after else set()
            continue
        behind = any(name in after for name in node.inputs)
        after |= set(node.outputs) if behind else set()
        (answer if behind else sense).add(node)
    return Plan(sense.steps, keep, answer.steps)


class _Order:
    """Puts each node into the first loop of its shape that comes after all that it reads."""

    def __init__(self, graph: Graph, views: dict[str, View]) -> None:
        self.steps: list[Step] = []
        self._graph, self._views = graph, views
        self._made_in: dict[str, int] = {}

    def add(self, node: Node) -> None:
        """The next node of the graph."""
        shape = _loop_shape(node, self._graph)
        at = len(self.steps) if shape is None else self._loop_for(node, shape)
        if at == len(self.steps):
            self.steps.append(Step([], shape))
        self.steps[at].nodes.append(node)
        self._made_in |= dict.fromkeys(node.outputs, at)

    def _loop_for(self, node: Node, shape: Shape) -> int:
        first = max((self._ready(name, shape) for name in node.inputs), default=0)
        fits = (
            k for k in range(first, len(self.steps)) if self.steps[k].shape == shape
        )
        return next(fits, len(self.steps))

    def _ready(self, name: str, shape: Shape) -> int:
        """The first step that may read a tensor number by number."""
        view = self._views.get(name)
        at = self._made_in.get(view.base if view else name, -1)
        if at < 0:
            return 0
        shared = view is None and self.steps[at].shape == shape
        whole = without_ones(self._graph.shape(name)) == shape
        return at if shared and whole else at + 1


def _loop_shape(node: Node, graph: Graph) -> Shape | None:
    """The shape of the loop that a node belongs to; None where it stands alone."""
    looked_up = node.op_type == "Gather" and graph.values(node.inputs[1]) is None
    if node.op_type not in BY_NUMBER and not looked_up:
        return None
    return without_ones(graph.shape(node.outputs[0]))


def without_ones(shape: Shape) -> Shape:
    """The dimensions that have more than one number."""
    return tuple(size for size in shape if size != 1)
