"""What shared control should reach, beside what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from studies.shared_control.plan import OURS, STYLES, UNSEEN

Row = dict[str, Any]
AUTHOR = ("author",)


@dataclass(frozen=True)
class Target:
    """A figure of the table's rows with its bound; of several sets the worst counts."""

    words: str
    key: str
    sets: tuple[str, ...]
    bound: float
    at_least: bool = False
    unit: str = ""
    ci: bool = False
    part: str = "table"


TARGETS = (
    Target(
        "drops saved, author's style",
        "saved_share",
        AUTHOR,
        0.95,
        at_least=True,
        ci=True,
    ),
    Target(
        "drops saved, trembling up to 3 m/s2, worst",
        "saved_share",
        AUTHOR,
        0.90,
        at_least=True,
        ci=True,
        part="tremor",
    ),
    Target(
        "hand-overs blocked, trembling up to 3 m/s2, worst",
        "blocked_share",
        AUTHOR,
        0.05,
        ci=True,
        part="tremor",
    ),
    Target(
        "drops saved, worst unseen style",
        "saved_share",
        UNSEEN,
        0.90,
        at_least=True,
        ci=True,
    ),
    Target(
        "hand-overs blocked, author's style", "blocked_share", AUTHOR, 0.02, ci=True
    ),
    Target(
        "hand-overs blocked, worst unseen style", "blocked_share", UNSEEN, 0.05, ci=True
    ),
    Target(
        "receiver's extra force, median, worst style",
        "extra_force_n_p50",
        STYLES,
        1.0,
        unit="N",
    ),
    Target(
        "extra delay, 95 %, worst style", "extra_delay_ms_p95", STYLES, 100.0, unit="ms"
    ),
    Target(
        "slip of what is saved, median, worst style",
        "slip_mm_p50",
        STYLES,
        2.0,
        unit="mm",
    ),
    Target("fragile objects crushed", "crushed_share", ("fragile",), 0.01, ci=True),
    Target(
        "error of the friction estimate, median, worst style",
        "mu_error_p50",
        STYLES,
        0.15,
    ),
)
RIVALS = ("smsp", "pd-shear")
"""Our grip above need is at most half of theirs, in the same run."""


def target_rows(rows: Sequence[Row]) -> list[dict[str, str]]:
    """The targets whose sets were run, each with what was measured and whether it is reached."""
    table = [row for row in rows if row["part"] == "table"]
    ours = [row for row in table if row["controller"] == OURS]
    trembling = [row for row in rows if row["part"] == "tremor"]
    made = []
    for target in TARGETS:
        of_part = trembling if target.part == "tremor" else ours
        made.append(_against(target, of_part))
    return [row for row in [*made, *(_excess(table, rival) for rival in RIVALS)] if row]


def _against(target: Target, ours: Sequence[Row]) -> dict[str, str]:
    found = [
        row for row in ours if row["set"] in target.sets and row[target.key] is not None
    ]
    if not found:
        return {}
    worst = (min if target.at_least else max)(
        found, key=lambda row: float(row[target.key])
    )
    value = worst[target.key]
    reached = value >= target.bound if target.at_least else value <= target.bound
    interval = worst[f"{target.key}_ci"] if target.ci else None
    within = f" ({interval[0]:.2f} to {interval[1]:.2f})" if interval else ""
    bound = "at least" if target.at_least else "at most"
    at = f"{worst['tremor_m_s2']:g} m/s2" if target.part == "tremor" else worst["set"]
    return {
        "target": target.words,
        "aim": f"{bound} {target.bound:g} {target.unit}".strip(),
        "measured": f"{value:.3g}{within} {target.unit}".strip() + f", {at}",
        "reached": "yes" if reached else "no",
    }


def _excess(table: Sequence[Row], rival: str) -> dict[str, str]:
    """Our grip above need over a rival's, of the styles together."""
    ours, theirs = (
        sum(
            r["grip_excess"]
            for r in table
            if r["controller"] == name and r["set"] in STYLES
        )
        for name in (OURS, rival)
    )
    if not theirs:
        return {}
    return {
        "target": f"grip above need over that of {rival}, all styles",
        "aim": "at most 0.5",
        "measured": f"{ours / theirs:.2f}",
        "reached": "yes" if ours <= 0.5 * theirs else "no",
    }
