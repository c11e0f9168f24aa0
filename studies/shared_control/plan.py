"""Which controllers run on which trials, with which settings, lags, delays and parts left out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from holdfast.edge_runtime.grip import CONTROLLERS, AnswerRules
from holdfast.simulation.drive import Opening
from holdfast.simulation.loop_people import Habits
from studies.shared_control.closed_loop import ORACLE, VIBRATION, LoopRequest, LoopSet

CARDS = Path(__file__).parent / "cards"
SHORTER = (("close_at_s", 0.8), ("hold_s", 1.8), ("tail_s", 0.5))
"""Values of shipped cards for this study: the quiet seconds before an action are simulated less."""
SEED = 7001
"""Of the report: locked (holdfast/core/locked.toml). To choose anything take --seed 100 to 199."""
UNSEEN = ("p1", "p2", "quick", "slow")
"""Styles of no card that the model was trained on."""
OURS = "holdfast"
OUR_LEAD_N = CONTROLLERS[OURS].SETTING
LAG_MS = 50.0
"""Of the drive, unless a row says otherwise; as LoopRequest has it."""
OUR_REQUEST = LoopRequest(OURS, OUR_LEAD_N)
SETTINGS: dict[str, tuple[float, ...]] = {
    OURS: (4.0, 8.0, 14.0, 22.0, 32.0),
    "pd-shear": (0.5, 2.0, 6.0),
    "smsp": (3.0, 8.0, 20.0),
    "ismsp": (60.0, 200.0, 600.0),
}
"""The curve of each controller: its one setting."""
WIDEST = ("everyday", "wide")
"""Sets of everyday actions and of any hold; every controller runs on them."""
RISES: dict[str, tuple[tuple[str, object], ...]] = {
    f"grip raised by at most {rise_n:g} N": (("rise_n", rise_n),)
    for rise_n in (2.0, 4.0, AnswerRules.rise_n, 10.0)
}
RISES["without an end"] = (("rise_n", math.inf),)
"""In the part `cap` an answer raises the grip by less, or by more."""
ORACLE_CAPS = (2.0, 2.5, 4.0)
"""There the oracle's commands are at most so many times what the load needs. 2.5 is what the target
allows (benchmarks/loop_figures.py)."""
CAP_SETS = ("wide", "author", "tugs", "fragile")
TRUE_EVIDENCE_S = 0.02
"""In the part `truth` the controller gets the true slips, so late."""
CURVE_SETS = ("p1", "quick")
"""The unseen styles of the curves: what becomes of their objects is counted together."""
STYLES = ("author", *UNSEEN)
LAGS_MS = (20.0, 100.0)
DELAYS = (1, 3, 8)
"""Samples by which targets act later: 7, 20 and 53 ms at 150 Hz."""
NOISES = (1.0, 2.0, 4.0)
"""Times the noise of the cards' chips: averages of 32, 8 and 2 conversions."""
TREMORS_M_S2 = (0.0, 0.3, 1.0, 2.0, 3.0)
"""How strongly the wearer's hand trembles."""
TREMBLING = ("fall", "pass")
"""Actions of these sets: nearly all preventable drops are falls, and hand-overs may be blocked."""
OPENS_AFTER_S = {"opens late": (0.3, 1.0), "never opens": 4.0}
"""From the first pull of a receiver until the giver opens the hand. A receiver gives up after 3 s,
so for this receiver a hand that opens after 4 s never opens."""
MISSED = {"always": 0.0, "nine in ten": Habits.missed_share, "never": 1.0}
"""In the part `intent` the board is told of so many openings: share of those that it misses."""
MISTAKES_S = (0.05, 0.15, 0.3)
"""In the part `mistake` the wearer opens the hand by mistake, for so long."""
CANNOT_TELL = "a hand that cannot tell"
"""It grips for the larger of the target and its wearer's grip, also when the wearer opens it."""
LATE_SETS = ("author", "p1")
PARTS = (
    *("table", "curve", "lag", "delay", "noise", "without", *OPENS_AFTER_S, "tremor"),
    *("truth", "intent", "cannot tell", "mistake", "cap"),
)
"""Parts of the study; each row belongs to one."""
WITHOUT = {
    "graded": (("graded", False),),
    "revocable": (("revocable", False),),
    "friction margin": (("margin", False),),
}
"""The holdfast controller without one of its parts."""


@dataclass(frozen=True)
class Row:
    """One row of the study: a set, a request, and what it is part of."""

    part: str
    set_name: str
    label: str
    one: LoopSet
    request: LoopRequest

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


def usual_setting(controller: str) -> float | None:
    """A controller's own setting, so that its row in a table is a point of its curve."""
    return CONTROLLERS[controller].SETTING if controller in SETTINGS else None


def rows(trials: int, seed: int = SEED) -> list[Row]:
    """Everything that the study runs."""
    by_name = sets(trials, seed)
    every = (*CONTROLLERS, VIBRATION, ORACLE)
    made = [
        Row("table", name, which, one, LoopRequest(which, usual_setting(which)))
        for name, one in by_name.items()
        for which in (every if name in (*STYLES, *WIDEST) else SETTINGS)
    ]
    for name in CURVE_SETS:
        made += _of_curve_set(name, by_name[name])
    for name in LATE_SETS:
        made += _opening_late(name, by_name[name])
    for name in ("author", *WIDEST):
        truth = replace(OUR_REQUEST, evidence_s=TRUE_EVIDENCE_S)
        made.append(Row("truth", name, OURS, by_name[name], truth))
    for name in STYLES:
        made += _told(name, by_name[name])
    for name in CAP_SETS:
        made += _capped(name, by_name[name])
    made += _mistaken(by_name["disturbed holds"])
    return [*made, *_trembling(by_name["author"])]


def _told(name: str, one: LoopSet) -> list[Row]:
    """Whether the board is told that the wearer opens the hand, and a hand that cannot tell."""
    made = []
    for label, share in MISSED.items():
        habits = replace(Habits(), missed_share=share)
        made.append(
            Row("intent", name, label, one, replace(OUR_REQUEST, habits=habits))
        )
    larger = replace(OUR_REQUEST, opening="larger")
    return [*made, Row("cannot tell", name, CANNOT_TELL, one, larger)]


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


def _capped(name: str, one: LoopSet) -> list[Row]:
    """What a smaller command saves, and what the oracle saves with no larger one."""
    ours = OUR_REQUEST
    made = []
    for label, rules in RISES.items():
        made.append(Row("cap", name, label, one, replace(ours, rules=rules)))
    for times in ORACLE_CAPS:
        label = f"oracle, at most {times:g} x the need"
        known = LoopRequest(ORACLE, most_times=times)
        made.append(Row("cap", name, label, one, known))
    return [*made, Row("cap", name, ORACLE, one, LoopRequest(ORACLE))]


def _opening_late(name: str, one: LoopSet) -> list[Row]:
    """Hand-overs whose giver opens late, or not at all while the receiver is there."""
    made = []
    for part, after_s in OPENS_AFTER_S.items():
        changes = (*one.changes, ("open_after_s", after_s))
        late = replace(one, changes=changes, actions=("pass",))
        for which in ("none", OURS):
            made.append(Row(part, name, which, late, LoopRequest(which)))
    return made


def _trembling(one: LoopSet) -> list[Row]:
    """Falls and hand-overs of a hand that trembles more and more."""
    ours = OUR_REQUEST
    made = []
    for tremor_m_s2 in TREMORS_M_S2:
        shaken = replace(one, tremor_m_s2=tremor_m_s2, actions=TREMBLING)
        made.append(Row("tremor", "author", OURS, shaken, ours))
    return made


def _of_curve_set(name: str, one: LoopSet) -> list[Row]:
    """Everything but the table: settings, lags, delays, noise, and parts left out."""
    ours = OUR_REQUEST
    made = []
    for which, settings in SETTINGS.items():
        for setting in settings:
            made.append(Row("curve", name, which, one, LoopRequest(which, setting)))
    for lag_ms in LAGS_MS:
        for which, settings in SETTINGS.items():
            for setting in settings[-4::2]:
                lagged = LoopRequest(which, setting, lag_ms)
                made.append(Row("lag", name, which, one, lagged))
    for delay in DELAYS:
        delayed = replace(ours, delay_samples=delay)
        made.append(Row("delay", name, OURS, one, delayed))
    for noise in NOISES:
        made.append(Row("noise", name, OURS, replace(one, noise=noise), ours))
    for part, rules in WITHOUT.items():
        made.append(Row("without", name, part, one, replace(ours, rules=rules)))
    return made
