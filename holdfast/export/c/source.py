"""The text of holdfast.c, holdfast.h and holdfast_selftest.c: templates, filled in for one model.

The hand-written C is in templates/: words between @ are filled in.
"""

from __future__ import annotations

import json
import math

import numpy as np

from holdfast.edge_runtime.c_engine import ABOUT as ABOUT_MODEL
from holdfast.edge_runtime.decision import period_us
from holdfast.edge_runtime.grip_control import SAMPLES
from holdfast.edge_runtime.model import AMPLITUDE, golden_length, golden_to_json
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.export.c.compiled import StepCode
from holdfast.export.c.constants import constants, rules_of, thumb_of
from holdfast.export.c.graph import Graph
from holdfast.export.c.grip_options import option_fields, options_of, options_possible
from holdfast.export.c.literals import (
    OUT_TYPES,
    Words,
    number,
    smallest_type,
    table,
    template,
)
from holdfast.export.c.loops import block

HAND_FILES = ("friction.c", "controller.c", "supervisor.c", "grip.c")
"""Hand-written C of the grip, in this order in the source: what a file uses stands before it."""
ABOUT = {
    "settled": "every sensor needed has a whole history",
    "unknown": "the samples cannot be trusted now: use none of the answers below",
    "usable_sensors": "sensors that are settled and good now",
    "empty": "1 where the hand touches nothing, by force",
    "votes": "whole numbers; a class's share of their sum is how sure the model is",
    "situation": "HOLDFAST_NOTHING to HOLDFAST_RISKY_SLIP; of equal votes the riskier one",
    "p_situation": "calibrated probabilities of the four situations",
    "p_class": "of the eight classes: each situation with a light, then a heavy object",
    "weight": "1: the object is heavy (150 g or more); no meaning where nothing is held",
}
"""Output -> what the header says of it."""


def c_source(graph: Graph) -> tuple[dict[str, str], StepCode]:
    """The text of every file by its name, and the compiled step. Raises NotCompilable."""
    compiled = StepCode(graph)
    words = _words(graph, compiled)
    files = {
        "holdfast.c": _source(compiled, words, constants(graph.card)),
        "holdfast.h": template("header.h", words),
        "holdfast_selftest.c": _selftest(graph, words),
        ABOUT_MODEL: _about(graph),
    }
    return files, compiled


def _source(compiled: StepCode, words: Words, named: str) -> str:
    """holdfast.c: the helpers, the model, then the hand-written files."""
    # Only the C file calls hf_sense; holdfast_features checks the state before it does.
    sense_head = (
        "static void hf_sense(double *state, const double *sample, "
        "const uint8_t *valid, float *features, holdfast_out *out)"
    )
    answer_head = "void holdfast_answer(const float *features, holdfast_out *out)"
    sense = "\n".join(block(sense_head, compiled.sense))
    answer = "\n".join(block(answer_head, compiled.answer))

    # a C function stands before its first use
    parts = [
        template("begin.c", words),
        template("maths.c", words),
        compiled.tables.text(),
        f"{sense}\n",
        f"{answer}\n",
        template("step.c", words),
        template("decision.c", words),
        named,
    ]
    for name in HAND_FILES:
        parts.append(template(name, words))

    return "\n".join(parts)


def _words(graph: Graph, compiled: StepCode) -> dict[str, object]:
    """The words and numbers of one model."""
    card = graph.card
    n = card.n_channels
    gap_ms = 1000.0 * card.gap_samples / card.rate_hz
    preparation = card.preparation
    turned_axes = 3 if preparation.turns == "sensor" else 1
    is_median = preparation.statistic == "median" and preparation.bias_rows > 0
    return {
        "MODEL_ID": card.model_id,
        "DIGEST": graph.digest,
        # A state carries the tag, so that a step refuses the state of another model.
        "TAG": f"0x{graph.digest[:8]}u",
        "SENSORS": n // 3,
        "CHANNELS": n,
        "FEATURES": graph.n_features,
        "CLASSES": len(card.classes),
        "RATE": f"{card.rate_hz:g}",
        "RATE_HZ": number(card.rate_hz, "double"),
        "PERIOD_US": period_us(card.rate_hz),
        "UNMEASURED": _unmeasured(card),
        "UNIT": card.unit,
        "UNIT_IS_N": int(card.unit == "N"),
        "LIMIT": f"{card.range_limit:g} {card.unit}",
        "GAP": card.gap_samples,
        "GAP_MS": f"{gap_ms:.0f}",
        "LEAST": card.min_valid_sensors,
        "SETTLE": card.settle_samples,
        "STATE_NUMBERS": graph.size("state"),
        "STATE_BYTES": compiled.state_bytes,
        "TABLE_BYTES": compiled.tables.n_bytes,
        "STACK_BYTES": compiled.stack_bytes,
        "OUTPUTS": _struct(graph),
        "RULES": rules_of(card),
        "OPTIONS": options_of(card),
        "OPTION_FIELDS": option_fields(),
        "POSSIBLE": options_possible(),
        "THUMB": thumb_of(card),
        "RATIOS": SAMPLES - 1,
        "BIAS_ROWS": preparation.bias_rows,
        "BIAS_MEDIAN": int(is_median),
        "TURNED_AXES": turned_axes if preparation.flip_negative_normal else 0,
        "TURN_BEYOND": number(preparation.flip_beyond, "double"),
    }


def _unmeasured(card: ModelCard) -> str:
    """A line of the header on the numbers that the hand does not measure; empty for most hands."""
    names = card.hand.unmeasured_names if card.hand else ()
    return (
        f"   Not measured by this hand, so write 0.0: {', '.join(names)}.\n"
        if names
        else ""
    )


def _struct(graph: Graph) -> str:
    """The fields of holdfast_out, each with what it means."""
    lines = []

    for name in graph.outputs:
        about = ABOUT.get(name, "")
        if name == "detectors":
            about = f"1 where it fires: {', '.join(graph.card.detectors)}"
        elif name in graph.card.heads:
            about = "probability of yes"

        size = graph.size(name)
        length = f"[{size}]" if size > 1 else ""
        field = f"{graph.c_type(name)} {name}{length};"
        comment = f"/* {about} */" if about else ""
        lines.append(f"    {field:<28}{comment}".rstrip())

    return "\n".join(lines)


def _about(graph: Graph) -> str:
    """model.json: card, golden answers, seal, and the fields of holdfast_out."""
    outputs = []
    for name in graph.outputs:
        kind = OUT_TYPES[graph.element(name)]
        # of one hand: without the batch
        outputs.append({"name": name, "dtype": kind, "shape": graph.shape(name)[1:]})
    about = {
        "digest": graph.digest,
        "card": graph.card.raw,
        "golden": golden_to_json(graph.golden),
        "outputs": outputs,
    }
    return json.dumps(about, indent=1) + "\n"


def _selftest(graph: Graph, words: Words) -> str:
    """holdfast_selftest.c: the golden answers of the file as tables, the input by its formula."""
    tables = []
    checks = []

    for name in graph.outputs:
        answers = graph.golden[name]
        size = math.prod(answers.shape[1:])

        # votes are whole numbers kept as float32: they must be equal, like labels
        is_exact = answers.dtype != np.float32 or "votes" in name
        c_type = smallest_type(answers) if is_exact else graph.c_type(name)
        tables.append(table(f"golden_{name}", answers, c_type))
        given = f"out.{name}" if size > 1 else f"&out.{name}"
        check = "SAME" if is_exact else "NEAR"
        checks.append(f"        {check}({name}, {given}, {size});")

    more = {
        "ROWS": golden_length(graph.card.settle_samples),
        "AMPLITUDE": number(AMPLITUDE[graph.card.unit], "double"),
        "TABLES": "\n".join(tables),
        "CHECKS": "\n".join(checks),
    }
    return template("selftest.c", {**words, **more})
