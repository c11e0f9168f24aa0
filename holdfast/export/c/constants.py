"""Constants of the hand-written C: decision, friction margin, controller and supervisor.

They are read from the Python that the C must equal, so that neither can change alone.
"""

from __future__ import annotations

import math

from holdfast.edge_runtime import grip_control as friction
from holdfast.edge_runtime.grip import (
    ASSUMED_GAIN,
    LARGEST,
    FrictionInUse,
    Holdfast,
    LoadFollower,
    SlipAnswer,
    WearersGrip,
)
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.export.c.literals import number

REALS = {
    "HF_MEAN_S": FrictionInUse.MEAN_S,
    "HF_TIMES_APART": FrictionInUse.TIMES,
    "HF_LEARNS_S": FrictionInUse.LEARNS_S,
    "HF_QUICK_S": FrictionInUse.QUICK_S,
    "HF_LOAD_S": FrictionInUse.LOAD_S,
    "HF_LONG_S": FrictionInUse.LONG_S,
    "HF_LOAD_RISES": FrictionInUse.RISES,
    "HF_LEAST_GRIP_N": FrictionInUse.LEAST_N,
    "HF_FADES_S": SlipAnswer.FADES_S,
    "HF_BRAKE_S": SlipAnswer.BRAKE_S,
    "HF_YOUNG_S": SlipAnswer.YOUNG_S,
    "HF_FULL_OVER": SlipAnswer.FULL_TIMES - 1.0,
    "HF_LEAST_USUAL": SlipAnswer.LEAST_USUAL,
    "HF_EARLY_S": Holdfast.EARLY_S,
    "HF_OWN_S": WearersGrip.TIME_S,
    "HF_BACK_S": WearersGrip.BACK_S,
    "HF_OURS_N": WearersGrip.OURS_N,
    "HF_RISES_SHARE": WearersGrip.RISES_SHARE,
    "HF_STILL_S": WearersGrip.STILL_S,
    "HF_CLOSES_S": WearersGrip.CLOSES_S,
    "HF_AGAIN_SHARE": WearersGrip.AGAIN_SHARE,
    "HF_SLIP_P": WearersGrip.SLIP_P,
    "HF_FOLLOW_STARTS": LoadFollower.STARTS,
    "HF_AHEAD_TIMES": LoadFollower.AHEAD_S / LoadFollower.RATE_S,
    "HF_RATE_S": LoadFollower.RATE_S,
    "HF_MOST_TIMES": LoadFollower.MOST_TIMES,
    "HF_MOST_S": WearersGrip.MOST_S,
    "HF_FIRM_N": friction.FIRM_N,
    "HF_STEADY": friction.STEADY,
    "HF_SURE_P": friction.SURE_P,
    "HF_QUIET_P": friction.QUIET_P,
    "HF_SPARE": friction.SPARE,
    "HF_LEAST_MU": friction.LEAST_MU,
    "HF_QUIET_S": friction.QUIET_S,
    "HF_LARGEST": LARGEST,
    "HF_ASSUMED_GAIN": ASSUMED_GAIN,
}
"""Name in C -> a number that C keeps as double."""
RULE_ORDER = (
    "arm_samples",
    "act_samples",
    "release_samples",
    "min_risky_permille",
    "override_ms",
    "evidence_ms",
)
"""In the order of the fields of holdfast_rules (templates/header.h), as an initialiser needs."""


def constants(card: ModelCard) -> str:
    """`#define` lines for the controller and what it needs, but for its options."""
    reals = dict(REALS)
    rises_n = {
        "HF_RISES_N": WearersGrip.RISES_N,
        "HF_AGAIN_N": WearersGrip.AGAIN_N,
        "HF_OURS_TIMES": WearersGrip.OURS_TIMES,
        "HF_MOST_FOLLOW_N": LoadFollower.MOST_N,
        "HF_EARLY_N": Holdfast.EARLY_N,
    }
    for name, rise_n in rises_n.items():
        # a rise in N says nothing about forces in another unit
        reals[name] = rise_n if card.unit == "N" else math.inf
    lines = []
    for name, value in reals.items():
        lines.append(f"#define {name} {number(value, 'double')}\n")
    lines.append(f"#define HF_RATIOS {friction.SAMPLES}\n")
    lines.append(f"#define HF_KNOWS_SIDES {int(card.thumb is not None)}\n")
    return "".join(lines)


def thumb_of(card: ModelCard) -> str:
    """1 for each sensor on the thumb's side, as an initialiser; zeros where no side is known."""
    sides = card.thumb or (False,) * (card.n_channels // 3)
    return ", ".join(str(int(side)) for side in sides)


def rules_of(card: ModelCard) -> str:
    """The decision's rules, as an initialiser."""
    rules = card.decision.to_json()
    return ", ".join(str(rules[name]) for name in RULE_ORDER)
