"""The tables of docs/features.md, from the feature groups and from the ablation: `make docs`."""

from __future__ import annotations

import math
import sys
from pathlib import Path

from holdfast.core.contact import NORMAL_FLOOR
from holdfast.evaluation.formats import markdown
from holdfast.export.features import GROUPS, feature_count, feature_graph
from holdfast.export.guard import LAGS_S
from holdfast.export.spec import StepSpec
from studies.ablation import table
from tools.doc_tables import fill, refresh

SHOWN = (6, 58.9)
"""Sensors and rate the page's numbers are for."""


def tables() -> dict[str, str]:
    """The constants of the formulas, and a row a feature group."""
    alone = _nodes(("now",))
    constants = [
        {"constant": "lags l, s", "value": ", ".join(f"{lag:.2f}" for lag in LAGS_S)},
        {
            "constant": "floor of Zs",
            "value": ", ".join(
                f"{value:g} {unit}" for unit, value in NORMAL_FLOOR.items()
            ),
        },
    ]
    return {
        "constants": markdown(constants),
        "groups": markdown([_row(name, alone) for name in GROUPS]),
    }


def _row(name: str, alone: int) -> dict[str, object]:
    group = GROUPS[name]
    finite = math.isfinite(group.memory_s)
    return {
        "group": f"`{name}`",
        "features": feature_count(_spec((name,))),
        "memory, s": f"{group.memory_s:.2f}" if finite else "unlimited: not clock-free",
        "nodes": 0 if name == "now" else _nodes(("now", name)) - alone,
        "formula": group.formula.replace("|", "\\|"),
        "why": group.reason,
    }


def _nodes(groups: tuple[str, ...]) -> int:
    return len(feature_graph(_spec(groups)).graph.node)


def _spec(groups: tuple[str, ...]) -> StepSpec:
    return StepSpec(SHOWN[0], SHOWN[1], "N", groups)


if __name__ == "__main__":
    ablation, page = sys.argv[1:]
    fill(page, tables())
    refresh(page, {Path(ablation): lambda figures: {"gains": table(figures["rows"])}})
