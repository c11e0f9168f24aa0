"""Which controllers run on which trials, with which settings, wearers, lags and halves left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from holdfast.edge_runtime.grip import Holdfast
from holdfast.simulation.loop.drive import Opening
from holdfast.simulation.loop.people import Habits
from studies.shared_control.closed_loop import (
    ORACLE,
    VIBRATION,
    LoopRequest,
    LoopSet,
    Run,
)
from studies.shared_control.published import CONTROLLERS

CARDS = Path(__file__).parent / "cards"
SHORTER = (("close_at_s", 0.8), ("hold_s", 1.8), ("tail_s", 0.5))
"""Values of shipped cards for this study: the quiet seconds before an action are simulated less."""
SEED = 7103
"""Of the report: locked (holdfast/core/locked.toml). To choose anything take --seed 100 to 199."""
UNSEEN = ("p1", "p2", "quick", "slow")
"""Styles of no card that the model was trained on. No choice may see them, at any seed."""
STYLES = ("author", *UNSEEN)
OURS = "holdfast"
OUR_REQUEST = LoopRequest(OURS, Holdfast.SETTING)
LATE_S = 0.02
"""No hand knows at load onset: about what sensors and model need at the least."""
LATE = f"oracle after {1e3 * LATE_S:g} ms"
KNOWING_S = (0.0, 0.007, 0.013, 0.027, 0.04)
"""In the part `knowing` an oracle knows so long after load onset: 0, 1, 2, 4 and 6 samples."""
KNOWING_SETS = ("author", "tugs")
FRONT_SETS = ("author", "tugs", "everyday", "wide", "sinking", "sudden")
"""On these the settings are chosen; what becomes of their objects is counted together. The last two
are styles for choices alone, a slow one and a quick one: they are no rows of the table."""
FRONT: dict[str, dict[str, object]] = {
    "both": {},
    "detection alone": {"follows": False},
    "following alone": {"detects": False},
    "floor 0.2": {"floor": 0.2},
    "from 1.4 times the usual": {"above": 1.4},
    "followed by 15 N": {"follow_n": 15.0},
    "hand-overs by 2 N": {"safe_follow_n": 2.0},
    "answers from 0.6": {"from_p": 0.6, "full_p": 0.75},
    "slips raise 12 N": {"rise_n": 12.0},
}
"""Points of the front: rules of the controller that differ from the usual ones."""
LAGS_MS = (20.0, 100.0)
TREMORS_M_S2 = (0.0, 0.3, 1.0, 2.0, 3.0)
"""How strongly the wearer's hand trembles."""
TREMBLING = ("fall", "pass")
"""Actions of these sets: nearly all preventable drops are falls, and hand-overs may be blocked."""
OPENS_AFTER_S = {"opens late": (0.3, 1.0), "never opens": 4.0}
"""From the first pull of a receiver until the giver opens the hand. A receiver gives up after 3 s,
so for this receiver a hand that opens after 4 s never opens."""
LATE_SETS = ("author", "p1", "quick")
MISSED = {"always": 0.0, "nine in ten": Habits.missed_share, "never": 1.0}
"""In the part `intent`: how many opening signals reach the board -> share that it misses."""
MISTAKES_S = (0.05, 0.15, 0.3)
"""In the part `mistake` the wearer opens the hand by mistake, for so long."""
CANNOT_TELL = "a hand that cannot tell"
"""It grips for the larger of the target and its wearer's grip, also when the wearer opens it."""
PARTS = (
    *("table", "knowing", "front", "lag", *OPENS_AFTER_S),
    *("intent", "cannot tell", "mistake", "tremor"),
)
"""Parts of the study; each row belongs to one."""


@dataclass(frozen=True)
class Row:
    """One row of the study: a set, a request, and what it is part of."""

    part: str
    set_name: str
    label: str
    one: LoopSet
    request: LoopRequest

    @property
    def run(self) -> Run:
        """What is run for it."""
        return self.one, self.request

    def with_opening(self, opening: Opening) -> Row:
        """The row in hands in which this decides when the wearer opens."""
        return replace(self, request=replace(self.request, opening=opening))


def sets(trials: int, seed: int = SEED) -> dict[str, LoopSet]:
    """Every set, by its name; trials: of each (fragile objects and holds: two thirds)."""
    fewer = max(1, 2 * trials // 3)
    return {
        "author": LoopSet("thesis", 2 * trials, seed, SHORTER),
        "p1": LoopSet("p1", trials, seed, SHORTER),
        "p2": LoopSet("p2", trials, seed, SHORTER),
        "quick": LoopSet(str(CARDS / "quick.toml"), trials, seed),
        "slow": LoopSet(str(CARDS / "slow.toml"), trials, seed),
        "tugs": LoopSet(str(CARDS / "tugs.toml"), fewer, seed),
        "disturbed holds": LoopSet("perturbed-hold", fewer, seed, SHORTER[:2]),
        "daily": LoopSet("daily", fewer, seed, SHORTER[:2]),
        "fragile": LoopSet(str(CARDS / "fragile.toml"), fewer, seed),
        "everyday": LoopSet("everyday", 3 * trials, seed, SHORTER),
        "wide": LoopSet("wide", 6 * trials, seed),
    }


def development_sets(trials: int, seed: int) -> dict[str, LoopSet]:
    """Styles on which rules are chosen, and nothing is reported."""
    return {
        name: LoopSet(str(CARDS / f"{name}.toml"), 2 * trials, seed)
        for name in ("sinking", "sudden")
    }


def rows(trials: int, seed: int = SEED) -> list[Row]:
    """Everything that the study runs."""
    by_name = sets(trials, seed)
    every = (*CONTROLLERS, VIBRATION, ORACLE)
    made = []
    for name, one in by_name.items():
        for which in every if name in STYLES else (OURS, ORACLE):
            request = OUR_REQUEST if which == OURS else LoopRequest(which)
            made.append(Row("table", name, which, one, request))
        late = LoopRequest(ORACLE, knows_after_s=LATE_S)
        made.append(Row("table", name, LATE, one, late))
    for name in KNOWING_SETS:
        made.append(Row("knowing", name, OURS, by_name[name], OUR_REQUEST))
        for after_s in KNOWING_S:
            label = f"oracle after {1e3 * after_s:g} ms"
            late = LoopRequest(ORACLE, knows_after_s=after_s)
            made.append(Row("knowing", name, label, by_name[name], late))
    chosen_on = by_name | development_sets(trials, seed)
    for name in FRONT_SETS:
        for label, rules in FRONT.items():
            request = replace(OUR_REQUEST, rules=tuple(rules.items()))
            made.append(Row("front", name, label, chosen_on[name], request))
    for name in LATE_SETS:
        made += _opening_late(name, by_name[name])
    for name in STYLES:
        made += _by_signal(name, by_name[name])
    for lag_ms in LAGS_MS:
        lagged = replace(OUR_REQUEST, lag_ms=lag_ms)
        made.append(Row("lag", "author", OURS, by_name["author"], lagged))
    made += _mistaken(by_name["disturbed holds"])
    return [*made, *_trembling(by_name["author"])]


def _by_signal(name: str, one: LoopSet) -> list[Row]:
    """How many opening signals reach the board, and a hand that cannot tell."""
    made = []
    for label, share in MISSED.items():
        habits = replace(Habits(), missed_share=share)
        made.append(
            Row("intent", name, label, one, replace(OUR_REQUEST, habits=habits))
        )
    larger = replace(OUR_REQUEST, opening="larger")
    return [*made, Row("cannot tell", name, CANNOT_TELL, one, larger)]


def _opening_late(name: str, one: LoopSet) -> list[Row]:
    """Hand-overs whose giver opens late, or not at all while the receiver is there."""
    made = []
    for part, after_s in OPENS_AFTER_S.items():
        changes = (*one.changes, ("open_after_s", after_s))
        late = replace(one, changes=changes, actions=("pass",))
        for which in ("none", OURS):
            made.append(Row(part, name, which, late, LoopRequest(which)))
    return made


def _mistaken(one: LoopSet) -> list[Row]:
    """Holds in which the wearer opens the hand by mistake."""
    made = []
    for mistake_s in MISTAKES_S:
        habits = replace(Habits(), mistake_s=mistake_s)
        for which in ("none", OURS):
            request = LoopRequest(which, habits=habits)
            label = f"{which}, {1e3 * mistake_s:g} ms"
            made.append(Row("mistake", "disturbed holds", label, one, request))
    return made


def _trembling(one: LoopSet) -> list[Row]:
    """Falls and hand-overs of a hand that trembles more and more."""
    made = []
    for tremor_m_s2 in TREMORS_M_S2:
        shaken = replace(one, tremor_m_s2=tremor_m_s2, actions=TREMBLING)
        made.append(Row("tremor", "author", OURS, shaken, OUR_REQUEST))
    return made
