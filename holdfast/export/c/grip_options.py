"""The options of the grip in C: fields, defaults and check, from AnswerRules and Limits."""

from __future__ import annotations

import math
from dataclasses import replace

from msgspec import Meta

from holdfast.core.schema import ranges
from holdfast.edge_runtime.grip import LARGEST, AnswerRules, Holdfast
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.edge_runtime.supervisor import Limits
from holdfast.export.c.literals import number

LEAD = Meta(ge=0.0, description="most that an answer is ahead of the grip")
SHEAR_GAIN = Meta(
    ge=0.0,
    le=LARGEST,
    description="shear over normal force as read, over the true ratio; 0: not measured",
)
"""A file knows no sensors, and who links it sets that of the calibration."""
RANGES = {
    "lead_n": LEAD,
    **ranges(AnswerRules),
    **ranges(Limits),
    "shear_gain": SHEAR_GAIN,
}
"""Option -> its range and what it is, in the order of holdfast_grip_options."""


def option_fields() -> str:
    """The fields of holdfast_grip_options, each with what it means."""
    lines = []
    for name, one in RANGES.items():
        field = f"double {name};"
        lines.append(f"    {field:<22}/* {one.description} */")
    return "\n".join(lines)


def options_of(card: ModelCard) -> str:
    """The defaults, as an initialiser; forces that are not in N have no ceiling."""
    rules, limits = AnswerRules.of(card.decision), Limits()
    if card.unit != "N":
        rules, limits = rules.without_newtons(), replace(limits, ceiling_n=math.inf)
    values = {"lead_n": Holdfast.SETTING, **vars(rules), **vars(limits)}
    return ", ".join(number(values.get(name, 0.0), "double") for name in RANGES)


def options_possible() -> str:
    """Whether every option is within its range, as an expression of C."""
    checks = []
    for name, one in RANGES.items():
        checks.append(f"options->{name} >= {number(one.ge, 'double')}")
        if one.le is not None:
            checks.append(f"options->{name} <= {number(one.le, 'double')}")
    # the evidence is divided by their difference
    checks.append("options->from_p < options->full_p")
    return " &&\n           ".join(checks)
