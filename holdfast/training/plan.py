"""What is trained by default: feature groups, learner, how many folds.

The choice was made on human_slip_uskin, people held out (docs/decisions.md says how many were
tried).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Literal

import numpy as np
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier

from holdfast.core.contract import FloatArray, IntArray, Json
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.step.learner import Forest
from holdfast.step.pooled import FAMILIES

CLOCK_FREE_GROUPS = (
    "now",
    "differences",
    "scaled_differences",
    "scaled_sums",
    "activity",
)
RAW_GROUPS = ("window",)
POOLED_GROUPS = (
    "pooled_state",
    "pooled_along",
    "pooled_shear",
    "pooled_normal",
    "pooled_activity",
    "pooled_jump",
    "pooled_ratio",
)
"""For the hand: the same however it is held, turned or mirrored, and for any number of sensors."""

LearnerKind = Literal["forest", "network", "committee"]
AHEAD = "predict_250ms"
"""The task of the head that looks ahead."""
TASK_HEADS = {
    "situations": "situation",
    "classes": "situation",
    AHEAD: "p_risky_250ms",
}
"""Which head of the exported file learns which task."""


@dataclass(frozen=True)
class NetworkPlan:
    """Parameters of a network by scikit-learn's names; members: networks side by side.

    hidden: units of each hidden layer. alpha: the L2 penalty on its weights. epochs: passes over
    the training windows. batch: windows of one step. rate: learning rate at the start.
    knee: of x / (knee + |x|), in standard deviations of the feature. balance: 1 weighs all classes
    the same, 0 all windows.
    """

    hidden: tuple[int, ...] = (64, 32)
    members: int = 4
    alpha: float = 1.0
    epochs: int = 6
    batch: int = 512
    rate: float = 2e-3
    balance: float = 0.0
    knee: float = 1.0


@dataclass(frozen=True)
class ForestPlan:
    """Parameters of one forest by scikit-learn's names; extra: ExtraTrees.

    min_samples_leaf: windows that a leaf holds at least. max_depth: None for no limit.
    max_features: features that a split chooses from, a share of all or the square root of their
    number. class_weight: "balanced" weighs all classes the same, None all windows.
    """

    kind: Literal["random", "extra"] = "extra"
    n_estimators: int = 100
    min_samples_leaf: int = 1
    max_depth: int | None = None
    max_features: float | str = "sqrt"
    class_weight: str | None = "balanced"

    def build(self, seed: int, n_jobs: int = 2) -> Forest:
        """An unfitted forest; the seed makes it the same every time."""
        parameters = asdict(self)
        kind = parameters.pop("kind")
        maker = ExtraTreesClassifier if kind == "extra" else RandomForestClassifier
        return maker(random_state=seed, n_jobs=n_jobs, **parameters)


TWO_SAMPLES = DecisionRules()
"""The thesis' rule: two risky samples in a row, of any confidence."""
HIGH_CONFIDENCE: dict[LearnerKind, DecisionRules] = {
    "forest": DecisionRules(act_samples=1, min_risky_permille=600),
    "network": DecisionRules(act_samples=1, min_risky_permille=860),
    "committee": DecisionRules(act_samples=1, min_risky_permille=680),
}
"""Act on two samples in a row, or on one of which the learner is sure: as seldom wrong, and a
sample sooner. Networks are surer of themselves than forests (docs/decisions.md)."""
ANY_HAND = {
    "min_risky_permille": 740,
    "answer_permille": 650,
    "full_answer_permille": 800,
    "evidence_ms": 300,
    "follow_floor_permille": 130,
    "follow_above_permille": 1250,
    "safe_follow_mn": 500,
}
"""Of a committee on pooled features, which is trained on wider scenes. A request without evidence
is over soon, so that a false one hides no slip after it. The grip answers a slip where the model is
sure, and follows a load from little over what is usual in a hold on; where another person may take
the object by 0.5 N at most (development seeds)."""
SLOW_HZ = 100.0
SLOW_PERMILLE = 680
"""Below SLOW_HZ it asks for a little less: at 50 Hz a slip has a third of the samples that it has
at 150 Hz, so fewer of them are sure that it begins (development seeds)."""

UNTUNED = ForestPlan(kind="random", class_weight=None)
"""The thesis' forest: 100 trees, nothing chosen."""
SITUATION_NETWORK = NetworkPlan()
"""For the situations: the parameters above."""
PREDICTION_NETWORK = NetworkPlan(alpha=10.0, epochs=10, rate=1e-3, balance=0.5)
"""For the 0.25 s prediction: more regularised, trained longer, classes half balanced."""
HAND_NETWORK = NetworkPlan(hidden=(64,), balance=1.0)
"""For the hand: a second hidden layer costs time and brings no clear gain (docs/results.md)."""
POOLED_NETWORK = NetworkPlan(hidden=(96,), members=2, balance=1.0)
"""For pooled features, which are half as many."""
POOLED_DEPTH = 14
SET_SHARES = {"grip_lift_ati": 0.3}
"""Of pooled features: real lifts, in which nothing falls. More of them makes the model deaf to
slips (docs/decisions.md)."""


def class_weights(label: IntArray, counts_as: FloatArray | None = None) -> FloatArray:
    """[K] the weight of each class with which all weigh the same. label [N]: of 0 .. K - 1.

    counts_as [N]: how many windows each counts as; None for one.
    """
    counts = np.bincount(label, counts_as)
    whole: float = len(label) if counts_as is None else counts_as.sum()
    return whole / np.maximum(counts, 1) / len(counts)


@dataclass(frozen=True)
class TrainingPlan:
    """All choices of a training run except the data and the seed.

    groups: feature groups by name. situation, prediction: forests of the main head and of the
    0.25 s prediction. folds: of the cross-validation by person. decision: rules that go into the
    model's card. learner: what answers; a forest alone leaves both networks unused.
    copies: disturbed copies of each recording that are trained on as well (nuisances.py).
    even_classes: probabilities are those of classes that are all as likely, as the learner weighs
    them; otherwise as likely as they have windows.
    set_shares: by name of a set, of several that are joined: its windows of a class count in all as
    much as this share of those of the other sets.
    """

    groups: tuple[str, ...] = CLOCK_FREE_GROUPS
    situation: ForestPlan = ForestPlan(
        n_estimators=60, min_samples_leaf=8, max_features=0.12
    )
    prediction: ForestPlan = ForestPlan(
        n_estimators=100, min_samples_leaf=5, max_features=0.3
    )
    folds: int = 6
    decision: DecisionRules = TWO_SAMPLES
    learner: LearnerKind = "forest"
    network: NetworkPlan = SITUATION_NETWORK
    prediction_network: NetworkPlan = PREDICTION_NETWORK
    copies: int = 0
    even_classes: bool = False
    set_shares: Mapping[str, float] = field(default_factory=dict)

    @property
    def is_pooled(self) -> bool:
        """Whether all features are pooled, so that it fits several hands."""
        return all(name in FAMILIES for name in self.groups)

    def network_for(self, task: str) -> NetworkPlan:
        """The network of a task."""
        return self.prediction_network if task == AHEAD else self.network

    def forest_for(self, task: str) -> ForestPlan:
        """The forest of a task."""
        return self.prediction if task == AHEAD else self.situation

    def to_json(self) -> Json:
        """As a JSON object, for the model card."""
        fields = asdict(self)
        # The card of a forest is as it was before there was anything else.
        if self.learner == "forest":
            del fields["learner"], fields["network"], fields["prediction_network"]
        for name in ("copies", "even_classes", "set_shares"):
            if not fields[name]:
                del fields[name]
        return fields


RAW_BASELINE = TrainingPlan(groups=RAW_GROUPS, situation=UNTUNED, prediction=UNTUNED)
"""The raw-window forest, the reference of every other figure."""

_FOREST_SIZES = {"tiny": (8, 10), "default": (20, 16)}
"""Trees and depth."""


def hand_plan(size: str, learner: LearnerKind = "committee") -> TrainingPlan:
    """A model for the hand, trained on dense windows, by the size of its forest."""
    trees, depth = _FOREST_SIZES[size]
    return TrainingPlan(
        situation=ForestPlan(
            n_estimators=trees, min_samples_leaf=3, max_depth=depth, max_features=0.3
        ),
        decision=HIGH_CONFIDENCE[learner],
        learner=learner,
        network=HAND_NETWORK,
    )


def pooled_plan(size: str, learner: LearnerKind = "committee") -> TrainingPlan:
    """A model for any hand, of pooled features, trained on disturbed copies too.

    Larger leaves than in `hand_plan`: copies are many windows, and a file must stay small.
    """
    plan = hand_plan(size, learner)
    depth = _FOREST_SIZES[size][1]
    forest = replace(
        plan.situation, min_samples_leaf=12, max_depth=min(depth, POOLED_DEPTH)
    )
    return replace(
        plan,
        groups=POOLED_GROUPS,
        situation=forest,
        network=POOLED_NETWORK,
        decision=replace(plan.decision, **ANY_HAND),
        copies=1,
        even_classes=True,
        set_shares=SET_SHARES,
        folds=3,
    )


def at_rate(plan: TrainingPlan, rate_hz: float) -> TrainingPlan:
    """The plan for recordings of a rate; pooled features at a slow one request earlier."""
    if not plan.is_pooled or rate_hz >= SLOW_HZ:
        return plan
    decision = replace(plan.decision, min_risky_permille=SLOW_PERMILLE)
    return replace(plan, decision=decision)


PLANS = {"fixed": hand_plan, "pooled": pooled_plan}
"""By features: of sensors in fixed places, or pooled over the sensors of a side."""
