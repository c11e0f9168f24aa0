"""One choice of a model, and which choices are tried."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from holdfast.data.recording import DataSet
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.step.spec import HISTORY_S, StepSpec
from holdfast.training.crossval import spec_for
from holdfast.training.plan import (
    CLOCK_FREE_GROUPS,
    HIGH_CONFIDENCE,
    POOLED_GROUPS,
    RAW_GROUPS,
    LearnerKind,
    TrainingPlan,
    hand_plan,
)

PEOPLES_TREES = 20
PEOPLES_FOREST = replace(TrainingPlan().situation, n_estimators=PEOPLES_TREES)
BASES = {
    "scenes": hand_plan("default", "forest"),
    "human": replace(TrainingPlan(), situation=PEOPLES_FOREST),
}
"""What is varied: the forest of the model for the hand, and on people the plan of `make real` with
a third of its trees."""
RATE_HZ = 150.0
DEBOUNCE = HIGH_CONFIDENCE["forest"].act_samples
REFERENCE = "reference"
"""Name of the point where nothing is changed."""
SINGLE_FINGERS = "single fingers"
RAW = "raw window"
POOLED = "pooled"
GROUPS = {SINGLE_FINGERS: CLOCK_FREE_GROUPS, RAW: RAW_GROUPS, POOLED: POOLED_GROUPS}
Set = Literal["scenes", "human"]


@dataclass(frozen=True)
class Point:
    """What is chosen; what is not named is the reference's.

    trees, depth: None for the reference's. look_back_s: no feature sees further.
    """

    of: Set = "scenes"
    rate_hz: float = RATE_HZ
    learner: LearnerKind = "forest"
    trees: int | None = None
    depth: int | None = None
    groups: str = SINGLE_FINGERS
    look_back_s: float = HISTORY_S
    debounce: int = DEBOUNCE

    @property
    def what(self) -> str:
        """What differs from the reference, in words."""
        trees = "1 tree" if self.trees == 1 else f"{self.trees} trees"
        look_back_ms = 1e3 * self.look_back_s
        words = {
            f"{self.rate_hz:g} Hz": self.rate_hz != RATE_HZ,
            self.learner: self.learner != "forest",
            trees: self.trees is not None,
            f"depth {self.depth}": self.depth is not None,
            self.groups: self.groups != SINGLE_FINGERS,
            f"looks back {look_back_ms:g} ms": self.look_back_s != HISTORY_S,
            f"debounce {self.debounce}": self.debounce != DEBOUNCE,
        }
        changed = [word for word, differs in words.items() if differs]
        return ", ".join(changed) or REFERENCE

    @property
    def name(self) -> str:
        """Of the files that it is kept in."""
        return f"{self.of}, {self.what}".replace(", ", "-").replace(" ", "_")

    @property
    def plan(self) -> TrainingPlan:
        """As a training plan."""
        base = BASES[self.of]
        forest = base.situation
        if self.trees is not None:
            forest = replace(forest, n_estimators=self.trees)
        if self.depth is not None:
            forest = replace(forest, max_depth=self.depth)
        groups = GROUPS[self.groups]
        return replace(base, groups=groups, situation=forest, learner=self.learner)

    @property
    def fitted(self) -> Point:
        """The point with the same learner: a debounce does not change it."""
        return replace(self, debounce=DEBOUNCE)

    @property
    def featured(self) -> Point:
        """The point with the same features: the learner does not change them."""
        return Point(self.of, self.rate_hz, groups=self.groups)

    @property
    def rules(self) -> DecisionRules:
        """As a decision."""
        return DecisionRules(act_samples=self.debounce)

    def spec(self, data: DataSet) -> StepSpec:
        """As a step graph for a set."""
        return spec_for(data, GROUPS[self.groups])


SHIPPED = Point(learner="committee", groups=POOLED)
"""The model in models/."""
TINY = replace(SHIPPED, trees=8, depth=10)
COMMITTEE = Point(learner="committee")
ON_HANDS = (Point(), Point(groups=POOLED), COMMITTEE, SHIPPED)
"""Evaluated on other hands too: what robustness brings."""
SLOWER_DECISIONS = tuple(Point(debounce=n) for n in (2, 3))
SIZES = (Point(trees=1), Point(trees=8), Point(trees=100), Point(depth=8))
RATES = (Point(rate_hz=50.0), Point(rate_hz=100.0), Point(rate_hz=300.0))
POINTS = (
    Point(),
    *SLOWER_DECISIONS,
    *SIZES,
    Point(groups=RAW),
    Point(look_back_s=0.1),
    Point(learner="network"),
    COMMITTEE,
    replace(COMMITTEE, trees=8, depth=10),
    Point(groups=POOLED),
    SHIPPED,
    TINY,
    *RATES,
    Point("human"),
    Point("human", debounce=2),
    Point("human", trees=100),
    Point("human", groups=RAW),
    Point("human", learner="network"),
    Point("human", learner="committee"),
)
"""One change of the reference at a time, and the models that are shipped."""
README_POINTS = (
    Point(debounce=2),
    Point(),
    SHIPPED,
)
"""What the README shows of them."""
