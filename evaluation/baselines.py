"""What stands beside a model on streams: the classical detectors, one line of code, the thesis'
forest, perfect intent.

Each is asked through the same decision as the model (it holds until the load falls), at its first
sample and only while something is held (a ratio of noises fires in the air all day). Each has one
setting to vary, from the most to the least sensitive, so that it can be had at the model's own rate
of false alarms: the first of its settings that is no worse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from edge_runtime.contact import NORMAL_FLOOR
from edge_runtime.contract import GRASP, NORMAL_AXIS, NOTHING, RISKY_SLIP, BoolArray
from edge_runtime.decision import UNKNOWN, DecisionRules
from edge_runtime.graph import open_session
from evaluation.alarms import Answers, act_requests
from evaluation.detector_baselines import (
    band_pass_fires,
    cone_fires,
    detector_signals,
    is_narrow,
)
from evaluation.event_scores import CONFIDENCES, match_alarms
from evaluation.model_outputs import everywhere, risky_permille
from evaluation.simple_baselines import shear_jump
from export.detectors import detector_names
from export.exporting import whole_graph
from export.heads import Head
from export.spec import StepSpec
from training.crossval import fit_forest, main_task, uncalibrated
from training.featurise import features_of, spec_for
from training.plan import RAW_BASELINE
from training.recording import DataSet, Recording

Asked = Callable[[float], list[BoolArray]]
"""Setting -> [T] a recording, whether the hand is asked to act."""

BAND, CONE, LINE = "band-pass bank", "friction cone", "one line of code"
RAW, INTENT = "raw-window forest", "perfect intent"
BAND_RATIOS = tuple(np.geomspace(1.05, 100.0, 32).tolist())
FRICTIONS = tuple(np.geomspace(0.1, 5.0, 32).tolist())
JUMPS = tuple(np.geomspace(0.05, 20.0, 64).tolist())
"""Changes of summed shear, N."""
LAWS = {
    BAND: "ten bands on every shear signal against the signal's own noise floor (varied: their ratio)",
    CONE: "shear over normal leaves the friction cone at any finger pressed hard enough (varied: the coefficient)",
    LINE: "the summed shear changed within two samples by more than so many newtons (varied: how many)",
    RAW: "100 untuned trees on the last 0.10 s, as the thesis has it (varied: the confidence)",
    INTENT: "a bound, no detector: knows what is intended, asks one sample after the load's onset, never else",
}


@dataclass(frozen=True)
class Baseline:
    """One of them. on: recordings -> what is asked at a setting."""

    name: str
    settings: tuple[float, ...]
    on: Callable[[Sequence[Recording]], Asked]


def rivals(spec: StepSpec, rules: DecisionRules, forest: Baseline | None = None) -> list[Baseline]:
    """Everything that can stand beside a model of this step; the forest only where there is
    something to train on."""
    found = _detectors(spec, rules)
    if spec.unit == "N":
        found.append(Baseline(LINE, JUMPS, lambda recordings: _one_line(recordings, rules)))
    bound = Baseline(
        INTENT, (0.0,), lambda recordings: lambda _: [intent(one) for one in recordings]
    )
    return [*found, *([forest] if forest else []), bound]


Computed = TypeVar("Computed")


def _kept(
    compute: Callable[[Sequence[Recording]], Computed],
) -> Callable[[Sequence[Recording]], Computed]:
    """The same function, which keeps its last result: a set is matched on and then scored."""
    last: list[tuple[Sequence[Recording], Computed]] = []

    def on(recordings: Sequence[Recording]) -> Computed:
        if not last or last[0][0] is not recordings:
            last[:] = [(recordings, compute(recordings))]
        return last[0][1]

    return on


def raw_forest(data: DataSet, spec: StepSpec, rules: DecisionRules, seed: int) -> Baseline:
    """The thesis' forest, trained on a set and run as a step graph of its own."""
    narrow, task = spec_for(data, RAW_BASELINE.groups), main_task(data)
    narrow = replace(narrow, rate_hz=spec.rate_hz)
    features = features_of(replace(data, tasks={task: data.tasks[task]}), narrow)[task]
    fitted = fit_forest(data, features, RAW_BASELINE, task, np.arange(len(features)), seed)
    classes = data.tasks[task].classes
    head = Head("situation", classes, fitted, uncalibrated(len(classes)))
    session = open_session(whole_graph(narrow, [head]).SerializeToString())

    def on(recordings: Sequence[Recording]) -> Asked:
        answers, outputs = [], everywhere(session, recordings, ["situation", "votes", "unknown"])
        for one, out in zip(recordings, outputs, strict=True):
            situation = np.where(out["unknown"], UNKNOWN, out["situation"])
            answers.append(Answers(one, situation, risky_permille(out["votes"].astype(np.int64))))
        return lambda permille: [
            asked[:, 0] for asked in act_requests(answers, rules, [int(permille)])
        ]

    return Baseline(RAW, tuple(float(one) for one in CONFIDENCES), _kept(on))


def _detectors(spec: StepSpec, rules: DecisionRules) -> list[Baseline]:
    """The bank and, in N, the cone; both read the same pass of guard and bank over a set."""
    signals = _kept(lambda recordings: detector_signals(spec, recordings))

    def band(recordings: Sequence[Recording]) -> Asked:
        found, fires = signals(recordings), dict[float, list[BoolArray]]()

        def at(ratio: float) -> list[BoolArray]:
            if ratio not in fires:
                ratios = BAND_RATIOS if is_narrow(found, len(BAND_RATIOS)) else (ratio,)
                fires.update(zip(ratios, band_pass_fires(found, spec, ratios), strict=True))
            return held_until_let_go(recordings, fires[ratio], rules)

        return at

    def cone(recordings: Sequence[Recording]) -> Asked:
        found = signals(recordings)
        return lambda friction: held_until_let_go(
            recordings, [cone_fires(one, spec, friction) for one in found], rules
        )

    bank = Baseline(BAND, BAND_RATIOS, _kept(band))
    has_cone = "friction_cone" in detector_names(spec)
    return [bank, Baseline(CONE, FRICTIONS, cone)] if has_cone else [bank]


def _one_line(recordings: Sequence[Recording], rules: DecisionRules) -> Asked:
    jumps = [shear_jump(one.samples) for one in recordings]
    return lambda least: held_until_let_go(recordings, [jump > least for jump in jumps], rules)


def held_until_let_go(
    recordings: Sequence[Recording], firing: Sequence[BoolArray], rules: DecisionRules
) -> list[BoolArray]:
    """[T] what a detector that fires [T] asks of the hand: at once, while something is held, until
    it is let go."""
    answers = []
    for one, fires in zip(recordings, firing, strict=True):
        held = one.samples[:, NORMAL_AXIS::3].sum(axis=1) > NORMAL_FLOOR[one.unit]
        situation = np.where(held, np.where(fires, RISKY_SLIP, GRASP), NOTHING)
        answers.append(Answers(one, situation, np.full(len(situation), 1000)))
    return [asked[:, 0] for asked in act_requests(answers, replace(rules, act_samples=1), [0])]


def intent(recording: Recording) -> BoolArray:
    """[T] asked at the first sample that is a whole one after a load onset, and at no other."""
    asked = np.zeros(len(recording.samples), dtype=np.bool_)
    rows = [int(np.floor(event.onset_s * recording.rate_hz)) + 1 for event in recording.events]
    asked[[row for row in rows if row < len(asked)]] = True
    return asked


def false_per_min(recordings: Sequence[Recording], asked: Sequence[BoolArray]) -> float:
    """False alarms a minute on streams."""
    told = [match_alarms(one, on) for one, on in zip(recordings, asked, strict=True)]
    return sum(len(one.false_s) for one in told) / max(sum(one.minutes for one in told), 1e-9)


@dataclass(frozen=True)
class Matched:
    """A rival at a setting; false_per_min there, on the streams it was matched on; fits: no more
    than was allowed."""

    rival: Baseline
    setting: float
    false_per_min: float
    fits: bool


def matched(rival: Baseline, recordings: Sequence[Recording], most_false_per_min: float) -> Matched:
    """The most sensitive setting with no more false alarms than allowed; the least sensitive where
    none is.

    Found by halving: false alarms fall as a setting gets less sensitive, but for a few more or
    less.
    """
    asked = rival.on(recordings)
    rates: dict[int, float] = {}

    def fits(place: int) -> bool:
        rates[place] = false_per_min(recordings, asked(rival.settings[place]))
        return rates[place] <= most_false_per_min

    low, high = 0, len(rival.settings) - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if fits(middle) else (middle + 1, high)
    fit = fits(low)
    return Matched(rival, rival.settings[low], rates[low], fit)
