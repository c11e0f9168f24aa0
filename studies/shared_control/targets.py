"""What shared control should reach, beside what was measured.

The aims are of 2026-11-28, in place of earlier ones; each says why. A few are bounds on a change:
they need the rows of the code before (BEFORE) on the same trials, `studies loop --before`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from studies.shared_control.plan import OURS, STYLES

Row = dict[str, Any]
BEFORE = "87cf3b64"
"""The commit whose rows on the same trials bound a change."""
HANDS_OVER = (*STYLES, "daily", "fragile", "wide")
"""Sets with hand-overs."""
DROPS = (*STYLES, "tugs", "daily", "fragile", "everyday", "wide")
"""Sets with preventable drops."""
EVERY = (*DROPS, "disturbed holds")


@dataclass(frozen=True)
class Target:
    """A figure of our rows of the part `table` with its bound; of several sets the worst counts.

    why: the reason for the bound. change: it is on the change since BEFORE, set by set.
    """

    words: str
    key: str
    sets: tuple[str, ...]
    bound: float
    why: str = ""
    at_least: bool = False
    unit: str = ""
    ci: bool = False
    change: bool = False


FRESH = ", without an earlier tightening"
LATE = Target(
    "saved of the preventable drops, less what a hand saves that knows 20 ms after load onset",
    "saved_beside_late",
    DROPS,
    0.0,
    "no hand knows at load onset; 20 ms is what sensors and model need",
    at_least=True,
    ci=True,
)
SLOW = Target(
    "drops saved, slow",
    "saved_share",
    ("slow",),
    0.75,
    "a hand 40 ms late keeps nearly all of them; 0.9 is a later goal",
    at_least=True,
    ci=True,
)
_NOT_EARNED = "what an earlier tightening saved is no merit of the answer"
TARGETS = (
    LATE,
    replace(
        LATE,
        words=LATE.words + FRESH,
        key="fresh_beside_late",
        why=_NOT_EARNED,
    ),
    SLOW,
    replace(SLOW, words=SLOW.words + FRESH, key="fresh_share", why=_NOT_EARNED),
    Target(
        "held after its wearer's opening",
        "held_after_share",
        HANDS_OVER,
        0.0,
        "the rule: the wearer wins",
        ci=True,
    ),
    Target(
        "receiver's force before the opening, 95 %",
        "before_force_n_p95",
        HANDS_OVER,
        1.0,
        "who pulls early shall not pay for what is saved",
        unit="N",
        change=True,
    ),
    Target(
        "grip over need, median of the worst kind of event",
        "over_need_n",
        EVERY,
        1.0,
        "sooner is not harder",
        unit="N",
        change=True,
    ),
    Target(
        "fragile objects crushed",
        "crushed_share",
        ("fragile",),
        0.0,
        "an answer breaks nothing",
        ci=True,
    ),
    Target(
        "put-downs disturbed",
        "disturbed_share",
        HANDS_OVER,
        0.0,
        "what is sooner shall not cost where an object is set down",
        change=True,
    ),
    Target(
        "tightened a minute, before any action",
        "tightenings_per_min",
        EVERY,
        0.5,
        "a hold is no slip",
        change=True,
    ),
    Target(
        "tightened a minute, before any action, wide",
        "tightenings_per_min",
        ("wide",),
        4.0,
        "12.5 by 87cf3b64 (seed 7101): much that it saved was only held more firmly",
    ),
)


def target_rows(
    rows: Sequence[Row], before: Sequence[Row] = ()
) -> list[dict[str, str]]:
    """The targets whose sets were run, each with what was measured and whether it is reached.

    before: rows of BEFORE on the same trials; without them no change is reported.
    """
    now = [_with_more(row) for row in rows]
    then = [_with_more(row) for row in before]
    made = []
    for target in TARGETS:
        chosen = _of(target, now)
        if target.change:
            chosen = _changes(target, chosen, _of(target, then))
        made.append(_against(target, chosen))
    return [row for row in made if row]


def _of(target: Target, rows: Sequence[Row]) -> list[Row]:
    """The rows that count for a target."""
    found = []
    for row in rows:
        fits = (row["part"], row["controller"]) == ("table", OURS)
        fits = fits and row["set"] in target.sets
        if fits and row.get(target.key) is not None:
            found.append(row)
    return found


def _changes(target: Target, now: Sequence[Row], then: Sequence[Row]) -> list[Row]:
    """The rows whose set was measured before too, with the change in place of the figure."""
    were = {row["set"]: row[target.key] for row in then}
    found = []
    for row in now:
        if row["set"] in were:
            found.append({**row, target.key: row[target.key] - were[row["set"]]})
    return found


def _with_more(row: Row) -> Row:
    """A row with the figures that stand deeper in it."""
    kinds = [n for n in row["over_need_n_by_action"].values() if n is not None]
    more: Row = {"over_need_n": max(kinds, default=None)}
    # A figure that rows of an earlier version do not have is left out.
    for name, key in (
        ("fresh", "saved_untightened"),
        ("held_after", "held_after_opening"),
    ):
        counted = row.get(key) or {}
        more[f"{name}_share"] = counted.get("share")
        more[f"{name}_share_ci"] = counted.get("share_ci")
    return {**row, **more}


def _against(target: Target, found: Sequence[Row]) -> dict[str, str]:
    """The worst of the rows beside the bound; nothing where there is none."""
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
    more = f" more than {BEFORE}" if target.change else ""
    return {
        "target": target.words,
        "aim": f"{bound} {target.bound:g} {target.unit}".strip() + more,
        "why": target.why,
        "measured": f"{value:.3g}{within} {target.unit}".strip() + f", {worst['set']}",
        "reached": "yes" if reached else "no",
    }
