"""What the templates name: the words and numbers of one model."""

from __future__ import annotations

import math

from holdfast.edge_runtime.decision import period_us
from holdfast.edge_runtime.grip_control import SAMPLES
from holdfast.edge_runtime.preparation import Preparation
from holdfast.export.c.compiled import Compiled
from holdfast.export.c.graph import Graph
from holdfast.export.c.hand import own_options, own_rules
from holdfast.export.c.literals import C_TYPES, number


def words_of(graph: Graph, compiled: Compiled) -> dict[str, object]:
    """What the templates name."""
    card, n = graph.card, graph.card.n_channels
    reduced = (
        ""
        if card.unit == "N"
        else "; forces are not in N, so there is no ceiling and no target"
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
        "BIAS_MEDIAN": int(
            preparation.statistic == "median" and preparation.bias_rows > 0
        ),
        "TURNED_AXES": turned if preparation.flip_negative_normal else 0,
        "TURN_BEYOND": number(preparation.flip_beyond, "double"),
    }


def _bias(preparation: Preparation) -> str:
    """The preparation in words."""
    if not preparation.bias_rows:
        return "if its samples are not without bias already"
    words = f"the {preparation.statistic} of its first {preparation.bias_rows} samples"
    what = "x, y and z of a sensor" if preparation.turns == "sensor" else "z"
    below = f"-{preparation.flip_beyond:g}"
    turned = f".\n   Before that, turn {what} round where z begins below {below}"
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
        field = (
            f"{C_TYPES[graph.element(name)]} {name}{f'[{size}]' if size > 1 else ''};"
        )
        lines.append(f"    {field:<28}{f'/* {about} */' if about else ''}".rstrip())
    return "\n".join(lines)
