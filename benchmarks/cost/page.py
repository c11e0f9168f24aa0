"""What is printed of the surface: the points of each set that no other beats."""

from __future__ import annotations

from holdfast.core.contract import Json
from tools.table_rows import cost_front, with_interval


def short(figures: Json) -> dict[str, list[Json]]:
    """The front of each set, cheapest first, and the peers where they were timed."""
    fronts: dict[str, list[Json]] = {}
    for of in figures["fronts"]:
        fronts[of] = [_line(row) for row in cost_front(figures, of)]
    if "peers" in figures:
        fronts["peers"] = figures["peers"]
    return fronts


def _line(row: Json) -> Json:
    delay = row["delay_ms"]
    return {
        "choice": row["what"],
        "step, us": row["step_us"],
        "recall (95 %)": with_interval(row["recall"], row["recall_ci"]),
        "acted before gross slip": row["in_time"],
        "false alarms per min": row["false_per_min"],
        "delay, ms": delay["p50"] if delay else None,
        "macro F1": row["macro_f1"],
        "unbeaten in": row["unbeaten_in"],
    }
