"""What shared control should reach, beside what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from studies.shared_control.plan import OURS, STYLES, UNSEEN

Row = dict[str, Any]
AUTHOR = ("author",)
NOT_TOLD = ("intent", "never")


@dataclass(frozen=True)
class Target:
    """A figure of rows with its bound; of several sets, or tremors, the worst counts.

    of: part and controller of its rows. tremors: only rows with a tremor of that and more, m/s2.
    """

    words: str
    key: str
    sets: tuple[str, ...]
    bound: float
    at_least: bool = False
    unit: str = ""
    ci: bool = False
    of: tuple[str, str] = ("table", OURS)
    tremors: float = 0.0


SAVED = Target("", "saved_share", AUTHOR, 0.90, at_least=True, ci=True)
BLOCKED = Target("", "blocked_share", STYLES, 0.05, ci=True)
FORCE = Target("", "extra_force_n_p95", STYLES, 3.0, unit="N")
DELAY = Target("", "extra_delay_ms_p95", STYLES, 60.0, unit="ms")
TREMOR = ("tremor", OURS)
_PUT = "disturbed_share"
_NEVER = "no signal reaches the board"
TARGETS = (
    replace(SAVED, words="drops saved, author's style"),
    replace(SAVED, words="drops saved, slow", sets=("slow",), bound=0.75),
    replace(SAVED, words="drops saved, worst unseen style", sets=UNSEEN, bound=0.75),
    replace(SAVED, words="drops saved, trembling, worst", bound=0.85, of=TREMOR),
    replace(
        BLOCKED, words="hand-overs blocked, author's style", sets=AUTHOR, bound=0.03
    ),
    replace(BLOCKED, words="hand-overs blocked, worst style"),
    replace(BLOCKED, words=f"hand-overs blocked, worst style, {_NEVER}", of=NOT_TOLD),
    replace(
        BLOCKED,
        words="put-downs disturbed, author's style",
        sets=AUTHOR,
        bound=0.03,
        key=_PUT,
    ),
    replace(BLOCKED, words="put-downs disturbed, worst style", key=_PUT),
    replace(FORCE, words="receiver's extra force, 95 %, worst style"),
    replace(
        FORCE,
        words=f"receiver's extra force, 95 %, worst style, {_NEVER}",
        bound=4.0,
        of=NOT_TOLD,
    ),
    replace(DELAY, words="extra delay, 95 %, worst style"),
    replace(
        DELAY,
        words=f"extra delay, 95 %, worst style, {_NEVER}",
        bound=100.0,
        of=NOT_TOLD,
    ),
    Target("fragile objects crushed", "crushed_share", ("fragile",), 0.01, ci=True),
    Target(
        "grip over need, median of the worst kind of event",
        "over_need_n",
        (*STYLES, "tugs", "everyday", "wide"),
        10.0,
        unit="N",
    ),
    Target(
        "pick-ups that tighten the hand",
        "pick_ups_share",
        ("everyday", "wide"),
        0.30,
        ci=True,
    ),
    Target(
        "tightenings a minute, trembling with 1 m/s2 and more, worst",
        "tightenings_per_min",
        AUTHOR,
        3.0,
        of=TREMOR,
        tremors=1.0,
    ),
)


def target_rows(rows: Sequence[Row]) -> list[dict[str, str]]:
    """The targets whose sets were run, each with what was measured and whether it is reached."""
    made = [_against(target, [_with_more(row) for row in rows]) for target in TARGETS]
    return [row for row in made if row]


def _with_more(row: Row) -> Row:
    """A row with the figures that stand deeper in it."""
    kinds = [n for n in row["over_need_n_by_action"].values() if n is not None]
    picked = row["pick_ups_called"]
    more = {
        "over_need_n": max(kinds, default=None),
        "pick_ups_share": picked["share"],
        "pick_ups_share_ci": picked["share_ci"],
    }
    return {**row, **more}


def _against(target: Target, rows: Sequence[Row]) -> dict[str, str]:
    found = []
    for row in rows:
        fits = (row["part"], row["controller"]) == target.of
        fits = fits and row["set"] in target.sets
        fits = fits and row["tremor_m_s2"] >= target.tremors
        if fits and row[target.key] is not None:
            found.append(row)
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
    at = f"{worst['tremor_m_s2']:g} m/s2" if target.of == TREMOR else worst["set"]
    return {
        "target": target.words,
        "aim": f"{bound} {target.bound:g} {target.unit}".strip(),
        "measured": f"{value:.3g}{within} {target.unit}".strip() + f", {at}",
        "reached": "yes" if reached else "no",
    }
