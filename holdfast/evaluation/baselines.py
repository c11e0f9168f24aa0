"""Baselines beside a model on streams: classical detectors, the thesis' forest, an oracle.

Each goes through the same decision as the model (a request holds until the load falls), acts on its
first sample, and only while something is held: a ratio of noises fires in the air all day. Each has
one setting, listed from the most to the least sensitive. It is matched to the model's own rate of
false alarms: the first setting with no more of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from holdfast.core.contract import (
    GRASP,
    NORMAL_AXIS,
    NOTHING,
    RISKY_SLIP,
    BoolArray,
)
from holdfast.core.trial_layout import NORMAL_FLOOR
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules
from holdfast.edge_runtime.graph import open_session, steps_of
from holdfast.evaluation.alarms import Answers, act_requests
from holdfast.evaluation.detector_baselines import (
    band_pass_fires,
    cone_fires,
    detector_signals,
    is_narrow,
)
from holdfast.evaluation.event_scores import CONFIDENCES, match_alarms
from holdfast.evaluation.method_names import BAND, CONE, ORACLE, RAW, SHEAR_RATE
from holdfast.evaluation.model_outputs import everywhere, risky_permille
from holdfast.evaluation.simple_baselines import shear_change
from holdfast.export.builder import GraphBuilder
from holdfast.export.detectors import detector_names
from holdfast.export.features import add_features_alone
from holdfast.export.heads import Head, add_heads
from holdfast.export.spec import StepSpec
from holdfast.training.crossval import fit_learner, main_task, uncalibrated
from holdfast.training.featurise import features_of, spec_for
from holdfast.training.plan import RAW_BASELINE
from holdfast.training.recording import DataSet, Recording

Requests = Callable[[float], list[BoolArray]]
"""Setting -> [T] a recording, whether an act is requested."""

BAND_RATIOS = tuple(np.geomspace(1.05, 100.0, 32).tolist())
FRICTIONS = tuple(np.geomspace(0.1, 5.0, 32).tolist())
RAW_OUTPUTS = ("situation", "votes", "unknown")
JUMPS_N = tuple(np.geomspace(0.05, 20.0, 64).tolist())


@dataclass(frozen=True)
class Baseline:
    """One baseline, by its stored name. on: recordings -> requests at a setting."""

    name: str
    settings: tuple[float, ...]
    on: Callable[[Sequence[Recording]], Requests]


def baselines(
    spec: StepSpec, rules: DecisionRules, forest: bytes | None = None
) -> list[Baseline]:
    """The baselines of a model of this step. forest: None without a set to train it on."""
    found = _detectors(spec, rules)
    if spec.unit == "N":
        on = partial(_shear_rate, rules=rules)
        found.append(Baseline(SHEAR_RATE, JUMPS_N, on))
    oracle = Baseline(
        ORACLE, (0.0,), lambda of: lambda _: [oracle_requests(one) for one in of]
    )
    return [*found, *([_raw(forest, rules)] if forest else []), oracle]


Computed = TypeVar("Computed")


def _kept(
    compute: Callable[[Sequence[Recording]], Computed],
) -> Callable[[Sequence[Recording]], Computed]:
    """The same function, which keeps its last result: a set is matched on, then scored."""
    last: list[tuple[Sequence[Recording], Computed]] = []

    def on(recordings: Sequence[Recording]) -> Computed:
        if not last or last[0][0] is not recordings:
            last[:] = [(recordings, compute(recordings))]
        return last[0][1]

    return on


def raw_forest(data: DataSet, spec: StepSpec, seed: int) -> bytes:
    """The thesis' forest, trained on a set, as a step graph of its own."""
    narrow, task = spec_for(data, RAW_BASELINE.groups), main_task(data)
    narrow = replace(narrow, rate_hz=spec.rate_hz)
    features = features_of(replace(data, tasks={task: data.tasks[task]}), narrow)[task]
    fitted = fit_learner(
        data, features, RAW_BASELINE, task, np.arange(len(features)), seed
    )
    classes = data.tasks[task].classes
    head = Head("situation", classes, fitted, uncalibrated(len(classes)))
    return _forest_graph(narrow, head)


def _raw(forest: bytes, rules: DecisionRules) -> Baseline:
    steps = steps_of(open_session(forest), RAW_OUTPUTS)

    def on(recordings: Sequence[Recording]) -> Requests:
        answers, outputs = [], everywhere(steps, recordings)
        for one, out in zip(recordings, outputs, strict=True):
            situation = np.where(out["unknown"], UNKNOWN, out["situation"])
            answers.append(
                Answers(one, situation, risky_permille(out["votes"].astype(np.int64)))
            )
        return lambda permille: [
            requested[:, 0]
            for requested in act_requests(answers, rules, [int(permille)])
        ]

    return Baseline(RAW, tuple(float(one) for one in CONFIDENCES), _kept(on))


def _forest_graph(spec: StepSpec, head: Head) -> bytes:
    graph = GraphBuilder(spec.n_sensors)
    add_heads(graph, add_features_alone(graph, spec), [head])
    return bytes(graph.model().SerializeToString())


def _detectors(spec: StepSpec, rules: DecisionRules) -> list[Baseline]:
    """The bank and, in N, the cone; both read the same pass of guard and bank over a set."""
    signals = _kept(lambda recordings: detector_signals(spec, recordings))

    def band(recordings: Sequence[Recording]) -> Requests:
        found, fires = signals(recordings), dict[float, list[BoolArray]]()

        def at(ratio: float) -> list[BoolArray]:
            if ratio not in fires:
                ratios = BAND_RATIOS if is_narrow(found, len(BAND_RATIOS)) else (ratio,)
                fires.update(
                    zip(ratios, band_pass_fires(found, spec, ratios), strict=True)
                )
            return held_until_let_go(recordings, fires[ratio], rules)

        return at

    def cone(recordings: Sequence[Recording]) -> Requests:
        found = signals(recordings)
        return lambda friction: held_until_let_go(
            recordings, [cone_fires(one, spec, friction) for one in found], rules
        )

    bank = Baseline(BAND, BAND_RATIOS, _kept(band))
    has_cone = "friction_cone" in detector_names(spec)
    return [bank, Baseline(CONE, FRICTIONS, cone)] if has_cone else [bank]


def _shear_rate(recordings: Sequence[Recording], rules: DecisionRules) -> Requests:
    changes = [shear_change(one.samples) for one in recordings]
    return lambda least: held_until_let_go(
        recordings, [one > least for one in changes], rules
    )


def held_until_let_go(
    recordings: Sequence[Recording], firing: Sequence[BoolArray], rules: DecisionRules
) -> list[BoolArray]:
    """[T] requests of a detector that fires [T]: while something is held, until it is let go."""
    answers = []
    for one, fires in zip(recordings, firing, strict=True):
        held = one.samples[:, NORMAL_AXIS::3].sum(axis=1) > NORMAL_FLOOR[one.unit]
        situation = np.where(held, np.where(fires, RISKY_SLIP, GRASP), NOTHING)
        answers.append(Answers(one, situation, np.full(len(situation), 1000)))
    return [
        requested[:, 0]
        for requested in act_requests(answers, replace(rules, act_samples=1), [0])
    ]


def oracle_requests(recording: Recording) -> BoolArray:
    """[T] an act is requested at the first whole sample after a load onset, and at no other."""
    requests = np.zeros(len(recording.samples), dtype=np.bool_)
    rows = [
        int(np.floor(event.onset_s * recording.rate_hz)) + 1
        for event in recording.events
    ]
    requests[[row for row in rows if row < len(requests)]] = True
    return requests


def false_per_min(
    recordings: Sequence[Recording], requests: Sequence[BoolArray]
) -> float:
    """False alarms a minute on streams."""
    matches = [
        match_alarms(one, on) for one, on in zip(recordings, requests, strict=True)
    ]
    return sum(len(one.false_s) for one in matches) / max(
        sum(one.minutes for one in matches), 1e-9
    )


@dataclass(frozen=True)
class MatchedBaseline:
    """A baseline at a setting, with its rate on the streams it was matched on.

    fits: the rate is no higher than allowed.
    """

    name: str
    setting: float
    false_per_min: float
    fits: bool


def matched(
    baseline: Baseline, recordings: Sequence[Recording], most_false_per_min: float
) -> MatchedBaseline:
    """The most sensitive setting with no more false alarms than allowed, else the least sensitive.

    Bisection: false alarms fall as a setting gets less sensitive, with small exceptions.
    """
    requests = baseline.on(recordings)
    rates: dict[int, float] = {}

    def fits(place: int) -> bool:
        rates[place] = false_per_min(recordings, requests(baseline.settings[place]))
        return rates[place] <= most_false_per_min

    low, high = 0, len(baseline.settings) - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if fits(middle) else (middle + 1, high)
    fit = fits(low)
    return MatchedBaseline(baseline.name, baseline.settings[low], rates[low], fit)
