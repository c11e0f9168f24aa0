"""eflesh_slip: the pipeline runs on licensed real Hall data; how late an alarm comes.

One threshold does as well on this easy set, so its scores show no advantage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import GRASP, RISKY_SLIP, BoolArray
from holdfast.core.reading import Json
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.export.heads import riskier_argmax
from holdfast.export.learner import reference_votes
from holdfast.export.network import IntArray
from holdfast.training.crossval import fit_learner
from holdfast.training.datasets.eflesh_slip import ThresholdAccuracy
from holdfast.training.featurise import features_everywhere, features_of, spec_for
from holdfast.training.figures import Interval
from holdfast.training.metrics import situation_scores
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet, assign_groups, folds_of
from studies.real.one_threshold import amplitude, detection_delay_s, threshold_baseline

ACT_SAMPLES = DecisionRules().act_samples
"""An alarm is so many risky samples in a row, as the hand would act on it."""
AMPLITUDE_ALARM_UT = 300.0
"""The one-threshold alarm the delays stand beside (norm over 18 channels); a round number, not
tuned."""


@dataclass(frozen=True)
class DelaySpread:
    """Delay of n alarms after the field departs, s; None without an alarm."""

    n: int
    p5: float | None
    p50: float | None
    p95: float | None


@dataclass(frozen=True)
class EfleshFigures:
    """Figures with blocks of neighbouring trials held out. Accuracies and F1 are from 0 to 1.

    delay_s, held_trials_with_an_alarm: by the name of the detector.
    """

    n_trials: int
    n_groups: int
    window_accuracy: float
    f1: dict[str, float | None]
    f1_ci: dict[str, Interval | None]
    trial_vote_accuracy: float
    one_threshold: ThresholdAccuracy
    delay_s: dict[str, DelaySpread]
    held_trials_with_an_alarm: dict[str, str]
    caveat: str

    @staticmethod
    def from_json(written: Json) -> EfleshFigures:
        """Read what `asdict` gave. Raises KeyError or TypeError where a figure is missing."""
        delays = {}
        for name, one in written["delay_s"].items():
            delays[name] = DelaySpread(**one)
        threshold = ThresholdAccuracy(**written["one_threshold"])
        return EfleshFigures(
            **written | {"delay_s": delays, "one_threshold": threshold}
        )


@dataclass(frozen=True)
class EfleshStudy:
    """Figures for the table, and delays in s of the forest and of one threshold for the picture."""

    figures: EfleshFigures
    delays_s: dict[str, list[float]]


def study_eflesh(data: DataSet, plan: TrainingPlan, seed: int = 0) -> EfleshStudy:
    """Forests with blocks of neighbouring trials held out, streamed over whole held-out trials."""
    spec = spec_for(data, plan.groups)
    windows = features_of(data, spec)["situations"]
    everywhere = features_everywhere(data, spec)
    task = data.tasks["situations"]
    blocks = data.group_of("situations")
    folds = assign_groups(blocks, plan.folds, seed=seed)
    predicted = np.zeros(len(task), dtype=np.int64)
    alarms: list[BoolArray] = [np.zeros(0, dtype=np.bool_)] * len(data.recordings)
    for train, test in folds_of(blocks, folds):
        forest = fit_learner(data, windows, plan, "situations", train, seed)
        predicted[test] = riskier_argmax(
            reference_votes(forest, windows[test], len(task.classes))
        )
        for trial in np.unique(task.trial[test]):
            label = riskier_argmax(
                reference_votes(forest, everywhere[trial], len(task.classes))
            )
            label[: spec.settle_samples] = GRASP  # not settled: no alarm can be meant
            alarms[trial] = _in_a_row(label == RISKY_SLIP, ACT_SAMPLES)
    simple = [
        _in_a_row(amplitude(r.samples) > AMPLITUDE_ALARM_UT, ACT_SAMPLES)
        for r in data.recordings
    ]
    delays = {"forest": _delays(data, alarms), "one threshold": _delays(data, simple)}
    scores = situation_scores(task.label, predicted, blocks, seed=seed)
    slips = ("grasp", "risky_slip")
    figures = EfleshFigures(
        n_trials=len(data.recordings),
        n_groups=len(data.groups()),
        window_accuracy=float(np.mean(predicted == task.label)),
        f1={name: scores.f1[name] for name in slips},
        f1_ci={name: scores.f1_ci[name] for name in slips},
        trial_vote_accuracy=_trial_vote(task.trial, predicted, task.label),
        one_threshold=threshold_baseline(data, seed=seed),
        delay_s={name: _spread(values) for name, values in delays.items()},
        held_trials_with_an_alarm={
            "forest": _held(data, alarms),
            "one threshold": _held(data, simple),
        },
        caveat=data.caveat,
    )
    return EfleshStudy(figures, delays)


def _in_a_row(flags: BoolArray, length: int) -> BoolArray:
    """True where the last `length` flags were all true."""
    run = flags.copy()
    for back in range(1, length):
        run[back:] &= flags[:-back]
        run[:back] = False
    return run


def _delays(data: DataSet, alarms: list[BoolArray]) -> list[float]:
    """Delay of the first alarm in every tugged trial that has both a departure and an alarm."""
    tugged = [
        (r, alarm)
        for r, alarm in zip(data.recordings, alarms, strict=True)
        if r.action == "tug"
    ]
    found = [detection_delay_s(recording, alarm) for recording, alarm in tugged]
    return [delay for delay in found if delay is not None]


def _spread(delays_s: list[float]) -> DelaySpread:
    if not delays_s:
        return DelaySpread(0, None, None, None)
    return DelaySpread(
        len(delays_s), *(float(np.percentile(delays_s, p)) for p in (5, 50, 95))
    )


def _held(data: DataSet, alarms: list[BoolArray]) -> str:
    held = [
        bool(a.any())
        for r, a in zip(data.recordings, alarms, strict=True)
        if r.action == "hold"
    ]
    return f"{sum(held)} of {len(held)}"


def _trial_vote(
    trial: IntArray,
    predicted: IntArray,
    label: IntArray,
) -> float:
    """Share of trials whose windows' majority is right (half of them risky counts as risky)."""
    right = []
    for number in np.unique(trial):
        here = trial == number
        risky = 2 * np.sum(predicted[here] == RISKY_SLIP) >= here.sum()
        right.append(risky == (label[here][0] == RISKY_SLIP))
    return float(np.mean(right))
