"""One choice of a model, and which choices are tried."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Literal

import msgspec

from holdfast.edge_runtime.decision import DecisionRules
from holdfast.export.spec import BANDS_HZ, HISTORY_S, WINDOW_S, StepSpec
from holdfast.training.featurise import spec_for
from holdfast.training.plan import (
    CLOCK_FREE_GROUPS,
    HIGH_CONFIDENCE,
    POOLED_GROUPS,
    RAW_GROUPS,
    LearnerKind,
    TrainingPlan,
    hand_plan,
)
from holdfast.training.recording import DataSet

PEOPLES_TREES = 20
BASES = {
    "scenes": hand_plan("default", "forest"),
    "human": replace(
        TrainingPlan(),
        situation=replace(TrainingPlan().situation, n_estimators=PEOPLES_TREES),
    ),
}
"""What is varied: the forest of the model for the hand, and on people the plan of `make real` with
a third of its trees."""
DEBOUNCE = HIGH_CONFIDENCE["forest"].act_samples
REFERENCE = "reference"
"""Name of the point where nothing is changed."""
POOLED = "pooled"
ANY_GROUPS = {
    "default": CLOCK_FREE_GROUPS,
    "now": ("now",),
    "now, differences": CLOCK_FREE_GROUPS[:2],
    "without activity": CLOCK_FREE_GROUPS[:-1],
    "default and bands": (*CLOCK_FREE_GROUPS, "bands"),
    "raw window": RAW_GROUPS,
    "now and bands": ("now", "bands"),
    POOLED: POOLED_GROUPS,
}
"""Tried on scenes and on people."""
EVERY_POOLED = "pooled and across"
FAMILIES = {
    f"pooled without {name.removeprefix('pooled_')}": tuple(
        other for other in POOLED_GROUPS if other != name
    )
    for name in POOLED_GROUPS
} | {EVERY_POOLED: (*POOLED_GROUPS, "pooled_across")}
"""Pooled features with a family less or more: tried on scenes."""
GROUPS = ANY_GROUPS | FAMILIES
BANDS = {
    "all": BANDS_HZ,
    "10 Hz": (10.0,),
    "10 to 25 Hz": BANDS_HZ[:4],
    "30 to 55 Hz": BANDS_HZ[4:],
}
TREES = (1, 3, 8, 20, 60, 100, 500)
DEPTHS = (4, 6, 8, 10, 16, 0)
COMMITTEES = ((None, None), (8, 10), (100, 0))
"""Trees and depth of the three models that `holdfast train --size` makes, the default first."""
RATES_HZ = (50.0, 100.0, 150.0, 300.0)
WINDOWS_S = (0.02, 0.05, 0.10, 0.20, 0.30)
LOOK_BACKS_S = (0.05, 0.10, 0.17)
DEBOUNCES = (1, 2, 3)
GOOD = {
    "recall": "recall",
    "in_time": "acted before gross slip",
    "macro_f1": "macro F1",
}
"""What a front is against the step's time of, in words."""
Set = Literal["scenes", "human"]


@dataclass(frozen=True)
class Point:
    """What is chosen; what is not named is the reference's: a forest of the default size.

    trees, depth: None for the reference's; a depth of 0 is none. window_s: of the raw window.
    look_back_s: no feature sees further. confidence: what the
    alarm's threshold is set on, the votes or the calibrated probability. degraded: pooled features
    answer although a sensor is lost.
    """

    of: Set = "scenes"
    rate_hz: float = 150.0
    trees: int | None = None
    depth: int | None = None
    groups: str = "default"
    window_s: float = WINDOW_S
    look_back_s: float = HISTORY_S
    bands: str = "all"
    debounce: int = DEBOUNCE
    confidence: Literal["votes", "calibrated"] = "votes"
    learner: LearnerKind = "forest"
    degraded: bool = True

    @property
    def name(self) -> str:
        """Of the file its figures are kept in."""
        return hashlib.sha256(
            json.dumps(asdict(self), sort_keys=True).encode()
        ).hexdigest()[:12]

    @property
    def what(self) -> str:
        """What differs from the reference, in words."""
        parts = (
            [f"{self.rate_hz:g} Hz"]
            if self.rate_hz != Point(self.of).rate_hz and self.of == "scenes"
            else []
        )
        parts += [self.learner] if self.learner != "forest" else []
        parts += (
            ["1 tree" if self.trees == 1 else f"{self.trees} trees"]
            if self.trees is not None
            else []
        )
        parts += (
            [f"depth {self.depth or 'unlimited'}"] if self.depth is not None else []
        )
        parts += [self.groups] if self.groups != "default" else []
        parts += (
            [f"window {1e3 * self.window_s:g} ms"] if self.window_s != WINDOW_S else []
        )
        parts += (
            [f"looks back {1e3 * self.look_back_s:g} ms"]
            if self.look_back_s != HISTORY_S
            else []
        )
        parts += [f"bands {self.bands}"] if self.bands != "all" else []
        parts += [f"debounce {self.debounce}"] if self.debounce != DEBOUNCE else []
        parts += ["calibrated"] if self.confidence != "votes" else []
        parts += ["no degraded answers"] if not self.degraded else []
        return ", ".join(parts) or REFERENCE

    @property
    def plan(self) -> TrainingPlan:
        """As a training plan."""
        base = BASES[self.of]
        forest = replace(
            base.situation,
            n_estimators=base.situation.n_estimators
            if self.trees is None
            else self.trees,
            max_depth=base.situation.max_depth
            if self.depth is None
            else self.depth or None,
        )
        return replace(
            base, groups=GROUPS[self.groups], situation=forest, learner=self.learner
        )

    def spec(self, data: DataSet) -> StepSpec:
        """As a step graph for a set."""
        of_set = spec_for(data, GROUPS[self.groups])
        return msgspec.structs.replace(
            of_set,
            window_s=self.window_s,
            bands_hz=BANDS[self.bands],
            min_valid_sensors=0 if self.degraded else of_set.n_sensors,
        )

    @property
    def fitted(self) -> Point:
        """The point with the same forest: the decision on its votes does not change the forest."""
        base = BASES[self.of].situation
        trees = None if self.trees == base.n_estimators else self.trees
        depth = (
            None
            if self.depth is not None and (self.depth or None) == base.max_depth
            else self.depth
        )
        return replace(
            self,
            trees=trees,
            depth=depth,
            debounce=DEBOUNCE,
            confidence="votes",
        )

    @property
    def grown(self) -> Point:
        """The point whose forest is this one's with another number of trees."""
        return replace(self.fitted, trees=None, learner="forest")

    @property
    def rules(self) -> DecisionRules:
        """As a decision."""
        return DecisionRules(act_samples=self.debounce)


SHIPPED = Point(learner="committee", groups=POOLED)
"""The model in models/."""
ON_HANDS = (
    Point(),
    *(Point(groups=name) for name in (POOLED, *FAMILIES)),
    Point(groups=POOLED, degraded=False),
    Point(learner="committee"),
    SHIPPED,
)
"""Asked on other hands too: what robustness costs and brings, family by family."""


def points() -> list[Point]:
    """One change of the reference at a time, and trees against depth; the same on both sets."""
    return list(dict.fromkeys([*_scenes(), *_human()]))


def _scenes() -> Iterator[Point]:
    yield from _anywhere("scenes")
    yield from (Point(rate_hz=rate_hz) for rate_hz in RATES_HZ)
    yield from (
        Point(depth=depth, trees=trees) for depth in (10, 0) for trees in (8, 100)
    )
    yield from (Point(groups="now and bands", bands=name) for name in BANDS)
    yield from ON_HANDS
    for trees, depth in COMMITTEES:
        yield replace(SHIPPED, trees=trees, depth=depth)


def _human() -> Iterator[Point]:
    yield from _anywhere("human")
    yield replace(SHIPPED, of="human")


def _anywhere(of: Set) -> Iterator[Point]:
    yield from (Point(of, debounce=debounce) for debounce in DEBOUNCES)
    yield from (Point(of, trees=trees) for trees in TREES)
    yield from (Point(of, depth=depth) for depth in DEPTHS)
    yield from (Point(of, groups=name) for name in ANY_GROUPS)
    yield from (
        Point(of, groups="raw window", window_s=window_s) for window_s in WINDOWS_S
    )
    yield from (Point(of, look_back_s=seconds) for seconds in LOOK_BACKS_S)
    yield Point(of, confidence="calibrated")
    yield Point(of, learner="network")
    for trees, depth in COMMITTEES:
        yield Point(of, learner="committee", trees=trees, depth=depth)


README_POINTS = (
    Point(),
    Point(debounce=2),
    Point(learner="committee"),
    SHIPPED,
    Point(rate_hz=50.0),
    Point("human", learner="committee"),
)
"""What the README shows of the surface."""
RECOMMENDED = {
    "tiny": replace(SHIPPED, trees=8, depth=10),
    "default": SHIPPED,
}
"""The models that have names."""
