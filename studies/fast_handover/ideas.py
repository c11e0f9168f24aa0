"""The ideas: one change of the default model at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from holdfast.training.plan import SIZES, UNTUNED
from holdfast.training.windows import Choice
from studies.fast_handover.learners import Boosting, Forest, Learner, TwoStages

PLAN = SIZES["default"].situation
ALONE = ("thesis",)
VARIED = ("thesis", "broad")
HARD = (*VARIED, "daily", "holds")
"""Sets to train on, by their names in sets.py."""
Features = Literal["default", "raw window", "with context"]
Decision = Literal["plain", "veto", "personal"]


def _forest() -> Learner:
    return Forest(PLAN)


@dataclass(frozen=True)
class Idea:
    """An idea: what differs from the default model.

    decision: plain; veto (no alarm once the hand's own opening is commanded);
    personal (every style has a threshold of its own, from its first few hand-overs).
    """

    name: str
    trained_on: tuple[str, ...] = VARIED
    windows: Choice = "balanced"
    features: Features = "default"
    learner: Callable[[], Learner] = field(default=_forest)
    decision: Decision = "plain"
    objects_left_out: bool = False


IDEAS = (
    Idea("default", objects_left_out=True),
    Idea("without domain randomisation (no `broad`)", trained_on=ALONE),
    Idea("balanced windows at critical points", windows="thesis"),
    Idea(
        "hard negatives in natural proportion", trained_on=HARD, objects_left_out=True
    ),
    Idea(
        "raw window, no invariant feature", features="raw window", objects_left_out=True
    ),
    Idea(
        "the thesis: raw window, untuned, balanced, `thesis` alone",
        ALONE,
        "thesis",
        "raw window",
        learner=lambda: Forest(UNTUNED),
    ),
    Idea("grip force before the event, 2 s", features="with context"),
    Idea(
        "weight as its own head, four situations",
        learner=lambda: Forest(PLAN, classes=4),
    ),
    Idea("two stages: contact, situation", learner=lambda: TwoStages(PLAN)),
    Idea(
        "a missed slip costs three times",
        learner=lambda: Forest(PLAN, risky_weight=3.0),
    ),
    Idea(
        "a false alarm costs three times",
        learner=lambda: Forest(PLAN, risky_weight=1.0 / 3.0),
    ),
    Idea("gradient boosting", learner=Boosting),
    Idea(
        "100 trees, full depth, hard negatives",
        trained_on=HARD,
        learner=lambda: Forest(SIZES["best"].situation),
    ),
    Idea("veto by the hand's own opening command", decision="veto"),
    Idea("a threshold per person, from eight hand-overs", decision="personal"),
)
"""Names are those of recorded figures. "Balanced" in a name is the thesis' undersampled set."""
