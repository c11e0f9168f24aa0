"""The figures of the second physics, from the trials' records; shares with exact 95 % intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from scipy.stats import chi2

from benchmarks.loop_figures import BLOCKED_N, BLOCKED_S, HELD_S
from benchmarks.paired import paired_change
from benchmarks.world.draws import FALLS, HAND_OVERS, KINDS, PULLS, RISKY
from benchmarks.world.outcomes import CEILING, CLOSURES
from holdfast.core.contract import Json
from holdfast.evaluation.formats import share

Records = Sequence[Json]
GROUPS = {
    "all drops": RISKY,
    "pulls and tugs": (*PULLS, "tug-lost"),
    "falls": FALLS,
}
OPENS: dict[str, Callable[[Json], bool]] = {
    "opens, signal reaches the run": lambda one: (
        one["kind"] == "hand-over" and one["trial"]["signal"]
    ),
    "opens, no signal": lambda one: (
        one["kind"] == "hand-over" and not one["trial"]["signal"]
    ),
    "opens late": lambda one: (
        one["kind"] == "hand-over-late" and one["trial"]["opens_s"] is not None
    ),
    "never opens": lambda one: (
        one["kind"] == "hand-over-late" and one["trial"]["opens_s"] is None
    ),
    "put-down": lambda one: one["kind"] == "put-down",
}
"""Rows of the table of hand-overs."""
QUIET_KINDS = ("quiet-hold", "trembling-hold")
TREMBLING_M_S2 = (0.0, 1.0, 2.0, 3.0)
SPARE = 2.5
"""A command above this many times the needed grip, and above the wearer's, is more than needed."""


def dropped(run: Json) -> bool:
    """The object was lost."""
    return run["lost_s"] is not None


def preventable(one: Json) -> bool:
    """The bare hand drops it, and one of the oracle's closures keeps it."""
    return dropped(one["bare"]) and one["oracle"] is not None


def saved(one: Json) -> bool:
    """The bare hand drops it, and the answered hand keeps it."""
    return dropped(one["bare"]) and not dropped(one["answered"])


def late_saves(one: Json) -> bool:
    """A hand that knows 20 ms after load onset keeps the object."""
    return one["oracle_late"] is not None


def too_much(one: Json) -> bool:
    """The largest command exceeds the wearer's grip and SPARE times what the load needs."""
    trial = one["trial"]
    return bool(
        one["answered"]["most_n"] > max(trial["grip_n"], SPARE * trial["need_n"])
    )


def _with_share(name: str, hits: Sequence[bool]) -> Json:
    """{name, name_of, name_share, name_share_ci}."""
    found = share(hits)
    return {
        name: sum(hits),
        f"{name}_of": len(hits),
        f"{name}_share": found.share,
        f"{name}_share_ci": found.share_ci,
    }


def kind_row(name: str, records: Records) -> Json:
    """One row by kind. Drops count in kinds of RISKY only: elsewhere the object is to leave."""
    risky = [one for one in records if one["kind"] in RISKY]
    drops = [one for one in risky if dropped(one["bare"])]
    can = [one for one in drops if preventable(one)]
    fresh = [one for one in can if not one["answered"]["earlier"]]
    kept = [one for one in records if not dropped(one["bare"])]
    return {
        "kind": name,
        "trials": len(records),
        "drops": len(drops),
        "preventable": len(can),
        **_with_share("saved_all", [saved(one) for one in drops]),
        **_with_share("saved", [saved(one) for one in can]),
        **_with_share("saved_fresh", [saved(one) for one in fresh]),
        **_with_share("late_saves", [late_saves(one) for one in can]),
        "beside_late": _beside_late(can),
        "fresh_beside_late": _beside_late(fresh),
        **_with_share("called", [one["answered"]["called"] for one in records]),
        **_with_share("earlier", [one["answered"]["earlier"] for one in records]),
        **_with_share("too_much", [too_much(one) for one in records]),
        "new_drops": sum(dropped(one["answered"]) for one in kept),
    }


def _beside_late(drops: Records) -> Json:
    """Saved, less what a hand saves that knows 20 ms after load onset: drop by drop."""
    names = [one["name"] for one in drops]
    ours = dict(zip(names, [saved(one) for one in drops], strict=True))
    late = dict(zip(names, [late_saves(one) for one in drops], strict=True))
    change, interval = paired_change(ours, late)
    return {"change": change, "change_ci": interval}


def beside(controller: str, records: Records) -> Json:
    """One controller's row beside the others: drops, hand-overs, and what should be left alone."""

    def of(name: str, kinds: Sequence[str]) -> Json:
        return kind_row(name, _of(records, kinds))

    overs = _of(records, HAND_OVERS)
    opened = [one for one in overs if one["trial"]["opens_s"] is not None]
    return {
        "controller": controller,
        "drops": of("all drops", RISKY),
        "pulls": of("pulls and tugs", GROUPS["pulls and tugs"]),
        "over": hand_over_row(
            "both hand-overs", [one for one in overs if dropped(one["bare"])]
        ),
        "opened": hand_over_row("the wearer opens", opened),
        "put": hand_over_row("put-down", _of(records, ("put-down",))),
        "given": of("both hand-overs", HAND_OVERS),
        "held": of("tug-held", ("tug-held",)),
        "picked": of("pick-up", ("pick-up",)),
        "every": kind_row("all trials", records),
    }


def oracle_rows(records: Records) -> list[Json]:
    """Preventable drops that the oracle keeps with commands of no more than so many times the need.

    It begins at the load onset, with the same drive: what no controller under this cap can exceed.
    """
    can = [one for one in _of(records, RISKY) if preventable(one)]
    rows = []
    for most in (*CLOSURES, np.inf):
        kept = [_closure(one) <= most for one in can]
        rows.append(
            {"times": most if np.isfinite(most) else None} | _with_share("kept", kept)
        )
    return rows


def _closure(one: Json) -> float:
    """The gentlest closure that kept a preventable object, in times of the need."""
    return np.inf if one["oracle"] == CEILING else float(one["oracle"])


def blocked(one: Json) -> bool:
    """The other person needs more force, or more time, than with the bare hand, or never gets it.

    Only where the bare hand lets the object go.
    """
    bare = one["bare"]
    held = one["answered"]
    if not dropped(held):
        return True
    return bool(
        held["peak_n"] - bare["peak_n"] > BLOCKED_N
        or held["lost_s"] - bare["lost_s"] > BLOCKED_S
    )


def held_after(one: Json) -> bool:
    """The hand grips on for HELD_S longer than its wearer, who has opened it."""
    return bool(one["answered"]["held_on_s"] > HELD_S)


def _before_ms(one: Json) -> float:
    """By how much longer than with the bare hand the other person waits before the opening, ms."""
    opens_s = one["trial"]["opens_s"]
    waits_s = []
    for hand in ("answered", "bare"):
        times_s = [t_s for t_s in (one[hand]["lost_s"], opens_s) if t_s is not None]
        waits_s.append(min(times_s, default=np.inf))
    return float(1e3 * (waits_s[0] - waits_s[1]))


def hand_over_row(name: str, records: Records) -> Json:
    """One row of the hand-overs: what the other person feels."""
    gone = [one for one in records if dropped(one["bare"])]
    freed = [one for one in gone if dropped(one["answered"])]
    delays = [one["answered"]["lost_s"] - one["bare"]["lost_s"] for one in freed]
    extra = [one["answered"]["peak_n"] - one["bare"]["peak_n"] for one in gone]
    opened = [one for one in gone if one["trial"]["opens_s"] is not None]
    before_n = []
    for one in gone:
        before_n.append(one["answered"]["peak_before_n"] - one["bare"]["peak_before_n"])
    # One that never gets it from a hand that never opens waits for ever: it is in never_let_go.
    before_ms = [ms for ms in map(_before_ms, gone) if np.isfinite(ms)]
    return {
        "opens": name,
        "trials": len(records),
        "let_go": len(gone),
        **_with_share("held_after", [held_after(one) for one in opened]),
        "before_n": _percentiles(before_n),
        "before_ms": _percentiles(before_ms),
        **_with_share("blocked", [blocked(one) for one in gone]),
        "never_let_go": len(gone) - len(freed),
        "bare_peak_n": _percentiles([one["bare"]["peak_n"] for one in gone]),
        "peak_n": _percentiles([one["answered"]["peak_n"] for one in gone]),
        "extra_n": _percentiles(extra),
        "extra_ms": _percentiles([1e3 * delay for delay in delays]),
    }


def _percentiles(values: Sequence[float]) -> Json | None:
    """{p50, p95}, or None without a value."""
    if not values:
        return None
    p50, p95 = np.percentile(values, (50, 95)).tolist()
    return {"p50": p50, "p95": p95}


def quiet_row(name: str, records: Records) -> Json:
    """Tightenings a minute in quiet holds, with their exact Poisson interval."""
    count = sum(one["answered"]["tightenings"] for one in records)
    minutes = sum(one["answered"]["quiet_s"] for one in records) / 60.0
    low = 0.5 * float(chi2.ppf(0.025, 2 * count)) if count else 0.0
    high = 0.5 * float(chi2.ppf(0.975, 2 * count + 2))
    per_min = count / minutes if minutes else None
    interval = (low / minutes, high / minutes) if minutes else None
    return {
        "hold": name,
        "trials": len(records),
        "minutes": minutes,
        "tightenings": count,
        "per_min": per_min,
        "per_min_ci": interval,
        **_with_share("any", [one["answered"]["tightenings"] > 0 for one in records]),
    }


def quiet_rows(records: Records) -> list[Json]:
    """Quiet holds, trembling ones by tremor, and the quiet before every other event."""
    rows = [quiet_row("quiet", _of(records, ("quiet-hold",)))]
    trembling = _of(records, ("trembling-hold",))
    for low, high in pairwise(TREMBLING_M_S2):
        some = [one for one in trembling if low <= one["trial"]["tremor_m_s2"] < high]
        rows.append(quiet_row(f"trembling, {low:g} to {high:g} m/s2", some))
    others = tuple(kind for kind in KINDS if kind not in QUIET_KINDS)
    return [*rows, quiet_row("before other events", _of(records, others))]


def _of(records: Records, kinds: Sequence[str]) -> list[Json]:
    return [one for one in records if one["kind"] in kinds]


def drawn_rows(records: Records) -> list[Json]:
    """What was drawn in the end: 5, 50 and 95 % of the trials that count."""
    rows = []
    for name in ("mass_g", "friction", "friction_used", "grip_n", "need_n"):
        values = [one["trial"][name] for one in records]
        p5, p50, p95 = np.percentile(values, (5, 50, 95)).tolist()
        rows.append({"name": name, "p5": p5, "p50": p50, "p95": p95})
    return rows


def table_of(records: Records) -> Json:
    """All figures of one set: one kind of pads and one of sensors."""
    kinds = [kind_row(kind, _of(records, (kind,))) for kind in KINDS]
    groups = [kind_row(name, _of(records, which)) for name, which in GROUPS.items()]
    both = kind_row("both hand-overs", _of(records, HAND_OVERS))
    everything = kind_row("all trials", records)
    overs = [
        hand_over_row(name, [one for one in records if chosen(one)])
        for name, chosen in OPENS.items()
    ]
    refused: dict[str, int] = {}
    for one in records:
        for why, count in one["refused"].items():
            refused[why] = refused.get(why, 0) + count
    return {
        "pads": records[0]["pads"],
        "sensors": records[0]["sensors"],
        "trials": len(records),
        "kinds": [row for row in kinds if row["trials"]],
        "groups": [*groups, both, everything],
        "hand_overs": overs,
        "quiet": quiet_rows(records),
        "oracle": oracle_rows(records),
        "drawn": drawn_rows(records),
        "refused": refused,
    }


def tables(records: Records) -> list[Json]:
    """A table for each kind of pads and sensors that the records have."""
    sets = dict.fromkeys((one["pads"], one["sensors"]) for one in records)
    made = []
    for pads, sensors in sets:
        some = [
            one for one in records if (one["pads"], one["sensors"]) == (pads, sensors)
        ]
        made.append(table_of(some))
    return made
