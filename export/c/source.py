"""holdfast.c, holdfast.h and holdfast_selftest.c of a graph, as text."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edge_runtime.decision import period_us
from edge_runtime.friction import SAMPLES
from edge_runtime.onnx_bytes import Node
from edge_runtime.preparation import Preparation
from export.c.graph import FEATURES, INPUTS, Graph, refusal
from export.c.hand import constants, own_options, own_rules
from export.c.literals import C_TYPES, Tables, number
from export.c.memory import SCRATCH, Memory
from export.c.operators import write_step
from export.c.plan import Plan, Step, plan_of
from export.c.selftest import selftest_source
from export.c.templates import snippets, template
from export.c.views import View, views_of
from export.c.whole import Whole
from export.c.whole_products import whole_types
from export.c.writer import Names, Writer

HAND_FILES = ("friction.c", "controller.c", "supervisor.c", "grip.c")
CALL_BYTES = 256
"""Stack of calls and registers beside the scratch arrays."""


@dataclass(frozen=True)
class CSource:
    """The text of every file by its name, and the memory of one hand, in bytes."""

    files: dict[str, str]
    state_bytes: int
    table_bytes: int
    stack_bytes: int


def c_source(graph: Graph) -> CSource:
    """Compile a graph. Raises NotCompilable."""
    compiled = _Compiled(graph)
    words = _words(graph, compiled)
    files = {
        "holdfast.c": _source(graph, compiled, words),
        "holdfast.h": template("header.h", words),
        "holdfast_selftest.c": selftest_source(graph, words),
    }
    return CSource(files, compiled.state_bytes, compiled.tables.n_bytes, compiled.stack_bytes)


class _Compiled:
    """All functions of the step, the tables that they read, and how much memory they take."""

    def __init__(self, graph: Graph) -> None:
        self.tables = Tables()
        self._graph, self._names, self._number = graph, Names(), 0
        self._whole = Whole(graph)
        views = views_of(graph)
        plan = plan_of(graph, views)
        types = whole_types(graph, plan, self._whole)
        outside = {name: name for name in (*INPUTS, FEATURES)}
        made_early = {name for step in plan.sense for name in step.outputs}
        early = {name: at for name, at in _fields(graph).items() if name in made_early}
        late = {name: at for name, at in _fields(graph).items() if name not in made_early}
        sense = Memory(graph, views, plan.sense, types, outside | early, plan.keep)
        answer = Memory(graph, views, plan.answer, types, {FEATURES: FEATURES, **late})
        _require_apart(graph, plan, views)
        self.sense = self._part(plan.sense, sense, _kept_state(graph, plan.keep, sense))
        self.answer = self._part(plan.answer, answer, [])
        self.state_bytes = 8 + 8 * math.prod(graph.shape("state"))
        scratch = max(sense.scratch_bytes(), answer.scratch_bytes())
        self.stack_bytes = scratch + 4 * graph.n_features + CALL_BYTES

    def _part(self, steps: list[Step], memory: Memory, end: list[str]) -> tuple[str, str]:
        """(definitions, body of the function that calls them in order)."""
        writer = Writer(self._graph, memory, self.tables, self._names, self._whole)
        functions = []
        for step in steps:
            functions.append(write_step(step, self._number, writer))
            self._number += 1
        scratch = [
            f"{c_type} {SCRATCH[c_type]}[{size}];" for c_type, size in memory.sizes.items() if size
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
        lines.append(f"{call}(state + {at}, {place.address()}, {size} * sizeof *state);")
        at += size
    return lines


def _source(graph: Graph, compiled: _Compiled, words: dict[str, object]) -> str:
    parameters = "double *state, const double *sample, const uint8_t *valid, float *features"
    steps, body = compiled.sense
    answers, answer_body = compiled.answer
    generated = [
        compiled.tables.text(),
        steps,
        f"static void hf_sense({parameters}, holdfast_out *out) {{\n{body}\n}}\n",
        answers,
        f"void holdfast_answer(const float *features, holdfast_out *out) {{\n{answer_body}\n}}\n",
    ]
    hand = [constants(), *(template(name, words) for name in HAND_FILES)]
    parts = [*generated, template("step.c", words), template("decision.c", words), *hand]
    return "\n".join([template("begin.c", words), snippets(f"{steps}\n{answers}"), *parts])


def _words(graph: Graph, compiled: _Compiled) -> dict[str, object]:
    """What the templates name."""
    card, n = graph.card, graph.card.n_channels
    reduced = (
        "" if card.unit == "N" else "; forces are not in N, so there is no ceiling and no target"
    )
    return {
        "MODEL_ID": card.model_id,
        "DIGEST": graph.digest,
        "TAG": f"0x{graph.digest[:8]}u",
        "SENSORS": n // 3,
        "CHANNELS": n,
        "FEATURES": graph.n_features,
        "CLASSES": len(card.classes),
        "RATE": f"{card.rate_hz:g}",
        "RATE_HZ": number(card.rate_hz, "double"),
        "PERIOD_US": period_us(card.rate_hz),
        "UNIT": card.unit,
        "UNIT_IS_N": int(card.unit == "N"),
        "LIMIT": f"{card.range_limit:g} {card.unit}",
        **_preparation(card.preparation),
        "GAP": card.gap_samples,
        "GAP_MS": f"{1000.0 * card.gap_samples / card.rate_hz:.0f}",
        "LEAST": card.min_valid_sensors,
        "SETTLE": card.settle_samples,
        "STATE_NUMBERS": math.prod(graph.shape("state")),
        "STATE_BYTES": compiled.state_bytes,
        "TABLE_BYTES": compiled.tables.n_bytes,
        "STACK_BYTES": compiled.stack_bytes,
        "ONES": ", ".join(["1"] * (n // 3)),
        "OUTPUTS": _struct(graph),
        "RULES": own_rules(card),
        "OPTIONS": own_options(card),
        "REDUCED": reduced,
        "RATIOS": SAMPLES - 1,
    }


def _preparation(preparation: Preparation) -> dict[str, object]:
    """How a stream is prepared: words and numbers for the header."""
    turned = 3 if preparation.turns == "sensor" else 1
    return {
        "BIAS": _bias(preparation),
        "BIAS_ROWS": preparation.bias_rows,
        "BIAS_MEDIAN": int(preparation.statistic == "median" and preparation.bias_rows > 0),
        "TURNED_AXES": turned if preparation.flip_negative_normal else 0,
        "TURN_BEYOND": number(preparation.flip_beyond, "double"),
    }


def _bias(preparation: Preparation) -> str:
    """The preparation in words."""
    if not preparation.bias_rows:
        return "if its samples are not without bias already"
    words = f"the {preparation.statistic} of its first {preparation.bias_rows} samples"
    what = "x, y and z of a sensor" if preparation.turns == "sensor" else "z"
    turned = (
        f".\n   Before that, turn {what} round where z begins below -{preparation.flip_beyond:g}"
    )
    return words + (turned if preparation.flip_negative_normal else "")


ABOUT = {
    "settled": "every sensor needed has a whole history",
    "unknown": "the samples cannot be trusted now: use none of the answers below",
    "usable_sensors": "sensors that are settled and good now",
    "votes": "whole numbers; a class's share of their sum is how sure the model is",
    "situation": "HOLDFAST_NOTHING to HOLDFAST_RISKY_SLIP; of equal votes the riskier one",
    "p_situation": "calibrated probabilities of the four situations",
    "p_class": "of the eight classes: each situation with a light, then a heavy object",
    "weight": "1: the object is heavy (150 g or more); no meaning where nothing is held",
}


def _struct(graph: Graph) -> str:
    """The fields of holdfast_out, each with what it means."""
    lines = []
    for name in graph.outputs:
        size = math.prod(graph.shape(name))
        about = ABOUT.get(name, "")
        if name == "detectors":
            about = f"1 where it fires: {', '.join(graph.card.detectors)}"
        elif name in graph.card.heads:
            about = "probability of yes"
        field = f"{C_TYPES[graph.element(name)]} {name}{f'[{size}]' if size > 1 else ''};"
        lines.append(f"    {field:<28}{f'/* {about} */' if about else ''}".rstrip())
    return "\n".join(lines)
