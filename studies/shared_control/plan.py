"""Which controllers run on which trials, with which settings, lags, delays and parts left out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from holdfast.edge_runtime.grip import CONTROLLERS, AnswerRules
from holdfast.evaluation.closed_loop import ORACLE, VIBRATION, LoopRequest, LoopSet
from holdfast.simulation.loop_people import Habits

CARDS = Path(__file__).parent / "cards"
SHORTER = (("close_at_s", 0.8), ("hold_s", 1.8), ("tail_s", 0.5))
"""Values of shipped cards for this study: the quiet seconds before an action are simulated less."""
SEED = 2000
UNSEEN = ("p1", "p2", "quick", "slow")
"""Styles of no card that the model was trained on."""
OURS = "holdfast"
OUR_LEAD_N = CONTROLLERS[OURS].SETTING
LAG_MS = 50.0
"""Of the drive, unless a row says otherwise; as LoopRequest has it."""
SETTINGS: dict[str, tuple[float, ...]] = {
    OURS: (4.0, 8.0, 14.0, 22.0, 32.0),
    "pd-shear": (0.5, 2.0, 6.0),
    "smsp": (3.0, 8.0, 20.0),
    "ismsp": (60.0, 200.0, 600.0),
}
"""The curve of each controller: its one setting."""
CURVE_SETS = ("p1", "quick")
"""The unseen styles of the curves: what becomes of their objects is counted together."""
STYLES = ("author", *UNSEEN)
LAGS_MS = (20.0, 100.0)
DELAYS = (1, 3, 8)
"""Samples by which targets act later: 7, 20 and 53 ms at 150 Hz."""
NOISES = (1.0, 2.0, 4.0)
"""Times the noise of the cards' chips: averages of 32, 8 and 2 conversions."""
WITHOUT = {
    "graded": AnswerRules(graded=False),
    "revocable": AnswerRules(revocable=False),
    "friction margin": AnswerRules(margin=False),
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


def sets(trials: int) -> dict[str, LoopSet]:
    """Every set, by its name; trials: of each (fragile objects and holds: two thirds)."""
    fewer = max(1, 2 * trials // 3)
    return {
        "author": LoopSet("thesis", 2 * trials, SEED, SHORTER),
        "p1": LoopSet("p1", trials, SEED, SHORTER),
        "p2": LoopSet("p2", trials, SEED, SHORTER),
        "quick": LoopSet(str(CARDS / "quick.toml"), trials, SEED),
        "slow": LoopSet(str(CARDS / "slow.toml"), trials, SEED),
        "tugs": LoopSet(str(CARDS / "tugs.toml"), fewer, SEED),
        "disturbed holds": LoopSet("perturbed-hold", fewer, SEED, SHORTER[:2]),
        "daily": LoopSet("daily", fewer, SEED, SHORTER[:2]),
        "fragile": LoopSet(str(CARDS / "fragile.toml"), fewer, SEED),
    }


def usual_setting(controller: str) -> float | None:
    """A controller's own setting, so that its row in a table is a point of its curve."""
    return CONTROLLERS[controller].SETTING if controller in SETTINGS else None


def rows(trials: int) -> list[Row]:
    """Everything that the study runs."""
    by_name = sets(trials)
    every = (*CONTROLLERS, VIBRATION, ORACLE)
    made = [
        Row("table", name, which, one, LoopRequest(which, usual_setting(which)))
        for name, one in by_name.items()
        for which in (every if name in STYLES else SETTINGS)
    ]
    for name in CURVE_SETS:
        made += _of_curve_set(name, by_name[name])
    return made


def _of_curve_set(name: str, one: LoopSet) -> list[Row]:
    """Everything but the table: settings, lags, delays, noise, and parts left out."""
    ours = LoopRequest(OURS, OUR_LEAD_N)
    deaf = replace(Habits(), missed_share=1.0)
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
    without_command = replace(ours, habits=deaf)
    return [*made, Row("without", name, "own command", one, without_command)]
