"""Baselines of a model on streams, and settings of all methods, found before a stream is scored.

The baselines are classical detectors, the thesis' forest and an oracle.

Each goes through the same decision as the model (a request holds until the load falls), acts on its
first sample, and only while something is held: a ratio of noises fires in the air all day. Each has
one setting, listed from the most to the least sensitive. It is matched to the model's own rate of
false alarms: the first setting with no more of them.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import msgspec
import numpy as np

from holdfast.core.contract import (
    GRASP,
    NORMAL_AXIS,
    NORMAL_FLOOR,
    NOTHING,
    RISKY_SLIP,
    BoolArray,
    FloatArray,
    Json,
)
from holdfast.core.progress import Part, ignored
from holdfast.data.recording import DataSet, Recording
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules
from holdfast.edge_runtime.graph import open_session, steps_of
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.evaluation.alarms import (
    CONFIDENCES,
    RecordingAnswers,
    match_alarms,
    requests_at,
)
from holdfast.evaluation.baseline_signals import (
    band_pass_fires,
    cone_fires,
    detector_signals,
    is_narrow,
    shear_change,
)
from holdfast.evaluation.formats import (
    BAND,
    CHOSEN,
    CONE,
    DEPLOYED,
    LAWS,
    ORACLE,
    RAW,
    SHEAR_RATE,
)
from holdfast.evaluation.model_outputs import ModelOutputs, everywhere, risky_permille
from holdfast.step.builder import GraphBuilder
from holdfast.step.detectors import detector_names
from holdfast.step.features import add_features_alone
from holdfast.step.heads import Head, add_heads
from holdfast.step.spec import StepSpec
from holdfast.training.crossval import (
    features_of,
    fit_learner,
    main_task,
    spec_for,
    uncalibrated,
)
from holdfast.training.plan import RAW_BASELINE

Requests = Callable[[float], list[BoolArray]]
"""Setting -> [T] a recording, whether an act is requested."""

BAND_RATIOS = tuple(np.geomspace(1.05, 100.0, 32).tolist())
FRICTIONS = tuple(np.geomspace(0.1, 5.0, 32).tolist())
"""Coefficients of friction of the cone. A low one fires at little shear."""
RAW_OUTPUTS = ("situation", "votes", "unknown")
JUMPS_N = tuple(np.geomspace(0.05, 20.0, 64).tolist())
"""With BAND_RATIOS and FRICTIONS the settings of the detectors, the most sensitive first."""


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
    # Bank and cone read the same pass of guard and bank over a set.
    signals = _remember_last(partial(detector_signals, spec))
    bank = _remember_last(_bank(spec, rules, signals))
    # The order is that of the report: detectors, forest, oracle.
    found = [Baseline(BAND, BAND_RATIOS, bank)]
    if "friction_cone" in detector_names(spec):
        cone = _detector(rules, signals, partial(cone_fires, spec))
        found.append(Baseline(CONE, FRICTIONS, cone))

    # Its threshold is in N, and means nothing in uT or counts.
    if spec.unit == "N":
        shear_rate = _detector(rules, _shear_changes, np.greater)
        found.append(Baseline(SHEAR_RATE, JUMPS_N, shear_rate))

    # Without a training set there is no forest to compare with.
    if forest:
        confidences = tuple(map(float, CONFIDENCES))
        thesis = _remember_last(_raw_forest(forest, rules))
        found.append(Baseline(RAW, confidences, thesis))

    return [*found, Baseline(ORACLE, (0.0,), _oracle)]


Computed = TypeVar("Computed")
OnRecordings = Callable[[Sequence[Recording]], Computed]
Law = Callable[[Any, float], BoolArray]
"""Signals of a recording, a setting -> [T] where a detector fires."""


def _remember_last(compute: OnRecordings[Computed]) -> OnRecordings[Computed]:
    """The same function, which keeps its last result: a set is matched on, then scored."""
    last: list[tuple[Sequence[Recording], Computed]] = []

    def on(recordings: Sequence[Recording]) -> Computed:
        # By identity: recordings hold arrays, and == of these has no single answer.
        if not last or last[0][0] is not recordings:
            last[:] = [(recordings, compute(recordings))]
        return last[0][1]

    return on


def _bank(
    spec: StepSpec, rules: DecisionRules, signals: OnRecordings
) -> OnRecordings[Requests]:
    def on(recordings: Sequence[Recording]) -> Requests:
        # Guard and filters run once; only the comparison with the threshold is repeated.
        found = signals(recordings)
        fires: dict[float, list[BoolArray]] = {}

        def at(ratio: float) -> list[BoolArray]:
            if ratio not in fires:
                # Of few recordings all settings are stepped at once, in the time of one.
                narrow = is_narrow(found, len(BAND_RATIOS))
                ratios = BAND_RATIOS if narrow else (ratio,)
                stepped = band_pass_fires(found, spec, ratios)
                fires.update(zip(ratios, stepped, strict=True))
            return held_until_let_go(recordings, fires[ratio], rules)

        return at

    return on


def _detector(
    rules: DecisionRules, signals: OnRecordings[list[Any]], law: Law
) -> OnRecordings[Requests]:
    def on(recordings: Sequence[Recording]) -> Requests:
        # Once for all settings: only the comparison depends on the threshold.
        found = signals(recordings)

        def at(setting: float) -> list[BoolArray]:
            fires = [law(one, setting) for one in found]
            return held_until_let_go(recordings, fires, rules)

        return at

    return on


def _shear_changes(recordings: Sequence[Recording]) -> list[FloatArray]:
    return [shear_change(one.samples) for one in recordings]


def _raw_forest(forest: bytes, rules: DecisionRules) -> OnRecordings[Requests]:
    # As a graph with state, like the model: its windows are streamed in the same way.
    steps = steps_of(open_session(forest), RAW_OUTPUTS)

    def on(recordings: Sequence[Recording]) -> Requests:
        computed = everywhere(steps, recordings)
        answers = []
        for one, out in zip(recordings, computed, strict=True):
            situation = np.where(out["unknown"], UNKNOWN, out["situation"])
            permille = risky_permille(out["votes"].astype(np.int64))
            answers.append(RecordingAnswers(one, situation, permille))

        return lambda permille: requests_at(answers, rules, int(permille))

    return on


def _oracle(recordings: Sequence[Recording]) -> Requests:
    return lambda _: [oracle_requests(one) for one in recordings]


def raw_forest(data: DataSet, spec: StepSpec, seed: int) -> bytes:
    """The thesis' forest, trained on a set, as a step graph of its own."""
    task = main_task(data)
    # The rate of the model, of which that of the set may be off by some per cent.
    # Of no hand card: raw windows need no sides, and an axis that is 0.0 throughout harms none.
    of_no_hand = spec_for(replace(data, hand=None), RAW_BASELINE.groups)
    narrow = msgspec.structs.replace(of_no_hand, rate_hz=spec.rate_hz)
    alone = replace(data, tasks={task: data.tasks[task]})
    features = features_of(alone, narrow)[task]
    # On all rows: it is scored on other sets, so nothing has to be held out.
    every_row = np.arange(len(features))
    fitted = fit_learner(data, features, RAW_BASELINE, task, every_row, seed)

    # Uncalibrated: the votes of the trees are compared with a confidence as they are.
    classes = data.tasks[task].classes
    head = Head("situation", classes, fitted, uncalibrated(len(classes)))
    graph = GraphBuilder(narrow.n_sensors)
    add_heads(graph, add_features_alone(graph, narrow), [head])
    return bytes(graph.model().SerializeToString())


def held_until_let_go(
    recordings: Sequence[Recording], firing: Sequence[BoolArray], rules: DecisionRules
) -> list[BoolArray]:
    """[T] requests of a detector that fires [T]: while something is held, until it is let go."""
    answers = []
    for one, fires in zip(recordings, firing, strict=True):
        # A ratio of noises fires in the air: only a hand that holds something may act.
        normal = one.samples[:, NORMAL_AXIS::3].sum(axis=1)
        held = normal > NORMAL_FLOOR[one.unit]
        slips_or_not = np.where(fires, RISKY_SLIP, GRASP)
        situation = np.where(held, slips_or_not, NOTHING)
        # A detector has no probability: it is fully confident whenever it fires.
        certain = np.full(len(situation), 1000)
        answers.append(RecordingAnswers(one, situation, certain))

    # A detector has thresholds of its own against noise, and acts on its first sample.
    return requests_at(answers, replace(rules, act_samples=1), 0)


def oracle_requests(recording: Recording) -> BoolArray:
    """[T] an act is requested at the first whole sample after a load onset, and at no other."""
    requests = np.zeros(len(recording.samples), dtype=np.bool_)
    for event in recording.events:
        onset_row = event.onset_s * recording.rate_hz
        # Strictly after the onset: before it there is nothing to see.
        row = int(np.floor(onset_row)) + 1
        if row < len(requests):
            requests[row] = True
    return requests


def false_per_min(
    recordings: Sequence[Recording], requests: Sequence[BoolArray]
) -> float:
    """False alarms a minute on streams."""
    false = 0
    minutes = 0.0
    for recording, on in zip(recordings, requests, strict=True):
        match = match_alarms(recording, on)
        false += len(match.false_s)
        minutes += match.minutes

    # Without a stream there is no alarm either: a rate of 0.
    return false / max(minutes, 1e-9)


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

    def rate_at(setting: float) -> float:
        return false_per_min(recordings, requests(setting))

    *others, last = baseline.settings
    place = bisect_left(
        others, True, key=lambda setting: rate_at(setting) <= most_false_per_min
    )
    setting = [*others, last][place]
    # Also of the least sensitive setting, which may still be above what is allowed.
    rate = rate_at(setting)
    fits = rate <= most_false_per_min
    return MatchedBaseline(baseline.name, setting, rate, fits)


@dataclass(frozen=True)
class ChosenConfidence:
    """A confidence that was chosen on other streams: thousandths, and the allowed false alarms."""

    permille: int
    most_false_per_min: float


@dataclass(frozen=True)
class Thresholds:
    """Confidences of this model by stored name, the headline first, and its matched baselines.

    matched_on: names of the sets. chosen: None as deployed. false_per_min_there: the headline's
    rate on these sets, which the baselines may not exceed.
    """

    confidences: dict[str, int]
    baselines: list[MatchedBaseline]
    rules: DecisionRules
    matched_on: list[str]
    chosen: ChosenConfidence | None
    false_per_min_there: float

    @property
    def headline(self) -> str:
        """The method that everything else is compared with."""
        return next(iter(self.confidences))

    def how(self) -> str:
        """How the confidence and the settings came about, in a sentence."""
        if self.chosen is None:
            # This sentence stands in the report, next to the figures that it limits.
            return (
                "the model card's own rules; baselines matched on the very streams that are "
                "scored, which flatters them"
            )

        return (
            f"the lowest confidence with at most {self.chosen.most_false_per_min:g} false alarms "
            f"a minute on other streams ({', '.join(self.matched_on)}); baselines matched to this "
            f"model's rate there, {self.false_per_min_there:.3g} a minute"
        )

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        chosen = self.chosen
        lines = {}
        for name, permille in self.confidences.items():
            lines[name] = {"min_risky_permille": permille}

        # "lines" and "rivals" are keys of the file format, older than today's words.
        rivals = {}
        for one in self.baselines:
            rivals[one.name] = {
                "law": LAWS[one.name],
                "setting": one.setting,
                "false_per_min_there": one.false_per_min,
                "fits": one.fits,
            }

        return {
            "headline": self.headline,
            "lines": lines,
            "rules": self.rules.to_json(),
            "chosen_on": self.matched_on if chosen else None,
            "most_false_per_min": chosen.most_false_per_min if chosen else None,
            "false_per_min_there": self.false_per_min_there,
            "matched_on": self.matched_on,
            "how": self.how(),
            "rivals": rivals,
        }


def find_thresholds(
    card: ModelCard,
    recordings: Sequence[Recording],
    outputs: Sequence[ModelOutputs],
    baselines: Sequence[Baseline],
    names: list[str],
    chosen: ChosenConfidence | None = None,
    part: Part = ignored,
) -> Thresholds:
    """This model as deployed and, first, as chosen; baselines at the headline's own rate.

    outputs: of the model on these recordings. names: of their sets.
    """
    rules = card.decision
    # The first is the headline, which every baseline is compared with.
    confidences = {CHOSEN: chosen.permille} if chosen else {}
    # Also as deployed: that is what a hand runs, whatever was chosen here.
    confidences[DEPLOYED] = rules.min_risky_permille

    # A baseline may have as many false alarms as this model: their recalls then compare.
    permille = next(iter(confidences.values()))
    headline = requests_at(outputs, rules, permille)
    # Measured on the same streams that the baselines are matched on.
    rate = false_per_min(recordings, headline)

    found = []
    for number, one in enumerate(baselines, 1):
        found.append(matched(one, recordings, rate))
        # Each baseline takes seconds to minutes, since every setting is a pass over the streams.
        part(number / len(baselines))

    return Thresholds(confidences, found, rules, names, chosen, rate)
