"""The outputs of a model file at every sample of a set, each recording from a fresh state.

Trials over time: forces, critical points, truth, and the answers of a held-out forest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import RISKY_SLIP, SAFE_SLIP, BoolArray, FloatArray
from holdfast.core.trial_layout import read_json, truth_path
from holdfast.edge_runtime.decision import (
    UNKNOWN,
    DecisionRules,
    DecisionState,
    decide,
    period_us,
)
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.graph import Outputs, Steps
from holdfast.evaluation.alarms import Answers
from holdfast.evaluation.scores import answers_at, labels_at
from holdfast.evaluation.window_scores import require_model_fits
from holdfast.export.heads import riskier_argmax, situation_votes
from holdfast.export.learner import reference_votes
from holdfast.export.network import IntArray
from holdfast.export.spec import StepSpec
from holdfast.training.critical_points import CriticalPoint, offline_critical_points
from holdfast.training.crossval import fit_learner
from holdfast.training.featurise import (
    FloatRows,
    features_everywhere,
    spec_for,
    stepped,
)
from holdfast.training.plan import TrainingPlan
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import DataSet, Recording
from holdfast.training.timeline import Phase, read_truth

OUTPUTS = ("situation", "votes", "unknown", "detectors", "p_situation")
NO_CLASS = -1


@dataclass(frozen=True)
class ModelOutputs:
    """The outputs of a model file on one recording.

    situation [T]: UNKNOWN or 0..3. risky_permille [T]: of the votes. p_situation [T, 4]. detectors
    [T, D]. eight, seven [T]: the class with most votes (the riskier on a tie); seven counts nothing
    once. NO_CLASS where the state is unknown, or the model has no weight output.
    """

    recording: Recording
    situation: npt.NDArray[np.int64]
    risky_permille: npt.NDArray[np.int64]
    p_situation: npt.NDArray[np.float32]
    eight: npt.NDArray[np.int64]
    seven: npt.NDArray[np.int64]
    detectors: BoolArray

    @property
    def answers(self) -> Answers:
        """What the decision is made from."""
        return Answers(self.recording, self.situation, self.risky_permille)


def run_model(model: OpenedModel, data: DataSet) -> list[ModelOutputs]:
    """The outputs of a model file on a set, each recording from a fresh state.

    Raises ChannelError, UnitError or RateError where the set does not fit the model.
    """
    require_model_fits(model, data)
    computed = everywhere(steps_with(model, OUTPUTS), data.recordings)
    return read_outputs(model, data.recordings, computed)


def steps_with(model: OpenedModel, outputs: Sequence[str]) -> Steps:
    """The step of any number of hands by the model's engine. outputs: those to compute."""
    return lambda hands: model.stepper(outputs, hands)


def everywhere(
    steps: Steps, recordings: Sequence[Recording], part: Part = ignored
) -> list[Outputs]:
    """Outputs [T, ..] of a step at every sample of every recording, in their order."""
    return stepped(
        steps, recordings, [np.arange(len(one.samples)) for one in recordings], part
    )


def read_outputs(
    model: OpenedModel, recordings: Sequence[Recording], computed: Sequence[Outputs]
) -> list[ModelOutputs]:
    """The outputs of `everywhere`, read as the monitor on the hand reads them."""
    return [
        _read(one, out, knows_weight=model.card.has_weight)
        for one, out in zip(recordings, computed, strict=True)
    ]


def _read(recording: Recording, out: Outputs, *, knows_weight: bool) -> ModelOutputs:
    votes, withheld = out["votes"].astype(np.int64), out["unknown"]
    eight = seven = np.full(len(votes), NO_CLASS)
    if knows_weight:
        eight, seven = (
            np.where(withheld, NO_CLASS, answers_at(votes, level))
            for level in ("eight", "seven")
        )
    return ModelOutputs(
        recording,
        np.where(withheld, UNKNOWN, out["situation"]),
        risky_permille(votes),
        out["p_situation"],
        eight,
        seven,
        out["detectors"],
    )


def risky_permille(votes: IntArray) -> npt.NDArray[np.int64]:
    """[T, K] votes for four or eight classes -> [T] thousandths of them for a risky slip."""
    risky: npt.NDArray[np.int64] = (
        1000
        * votes[:, votes.shape[1] * RISKY_SLIP // 4 :].sum(axis=1)
        // votes.sum(axis=1)
    )
    return risky


SHOWN = {"pull": RISKY_SLIP, "fall": RISKY_SLIP, "pass": SAFE_SLIP}
EVENTS = ("load_onset_s", "incipient_slip_s", "gross_slip_s", "contact_lost_s")


@dataclass(frozen=True)
class StreamPicture:
    """One held-out trial. answer [T]: a situation or UNKNOWN. acts [T]: what the decision asks for.

    events: times in s of the truth's events that happened, by name.
    """

    recording: Recording
    phases: tuple[Phase, ...]
    events: dict[str, float]
    points: list[CriticalPoint]
    answer: npt.NDArray[np.int64]
    acts: npt.NDArray[np.bool_]


def shown_trials(data: DataSet) -> list[int]:
    """The first trial of each shown action with a window of its slip, chosen before any answer."""
    task = data.tasks["classes"]
    situations = labels_at(task.label, "four")
    found = []
    for action, situation in SHOWN.items():
        slips = set(task.trial[situations == situation].tolist())
        these = (
            k
            for k, r in enumerate(data.recordings)
            if r.action == action and k in slips
        )
        found += [k for k in these][:1]
    return found


def held_out_streams(
    folder: Path, data: DataSet, features: FloatRows, plan: TrainingPlan, seed: int
) -> list[StreamPicture]:
    """Pictures of the shown trials of a folder, from one forest trained without them."""
    shown, task = shown_trials(data), data.tasks["classes"]
    forest = fit_learner(
        data,
        features,
        plan,
        "classes",
        np.flatnonzero(~np.isin(task.trial, shown)),
        seed,
    )
    spec = spec_for(data, plan.groups)
    part = data.of_groups({data.recordings[k].group for k in shown})
    streams = zip(part.recordings, features_everywhere(part, spec), strict=True)
    return [
        _picture(folder, one, reference_votes(forest, rows, len(task.classes)), spec)
        for one, rows in streams
    ]


def _picture(
    folder: Path, recording: Recording, votes: IntArray, spec: StepSpec
) -> StreamPicture:
    by_situation = situation_votes(votes)
    answer = riskier_argmax(by_situation)
    answer[: spec.settle_samples - 1] = UNKNOWN
    share = by_situation[:, RISKY_SLIP] / by_situation.sum(axis=1)
    return picture_of(
        folder, recording, answer, decided(answer, share, recording.rate_hz)
    )


def picture_of(
    folder: Path,
    recording: Recording,
    answer: npt.NDArray[np.int64],
    acts: npt.NDArray[np.bool_],
) -> StreamPicture:
    """The answers on a trial of a folder, with its truth. answer, acts: [T]."""
    truth = truth_path(folder / f"{recording.trial_id}.csv")
    times = read_json(truth)
    return StreamPicture(
        recording,
        read_truth(truth, np.arange(len(recording.samples)) / recording.rate_hz),
        {name: float(times[name]) for name in EVENTS if times.get(name) is not None},
        offline_critical_points(recording),
        answer,
        acts,
    )


def decided(
    answer: npt.NDArray[np.int64], risky_share: FloatArray, rate_hz: float
) -> npt.NDArray[np.bool_]:
    """[T] whether an act is requested, by the decision's default rules."""
    period = period_us(rate_hz)
    rules, state, acts = (
        DecisionRules(),
        DecisionState(),
        np.zeros(len(answer), dtype=np.bool_),
    )
    for t, (situation, share) in enumerate(
        zip(answer.tolist(), risky_share.tolist(), strict=True)
    ):
        state = decide(rules, state, situation, int(1000 * share), period_us=period)
        acts[t] = state.act
    return acts
