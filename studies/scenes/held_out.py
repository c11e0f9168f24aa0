"""Pictures of unseen trials, from one forest trained without them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from holdfast.core.contract import RISKY_SLIP, SAFE_SLIP
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules
from holdfast.evaluation.alarms import Answers, requests_at
from holdfast.evaluation.stream_pictures import StreamPicture, picture_of
from holdfast.evaluation.window_scores import labels_at
from holdfast.export.heads import riskier_argmax, situation_votes
from holdfast.export.learner import reference_votes
from holdfast.export.network import IntArray
from holdfast.export.spec import StepSpec
from holdfast.training.crossval import fit_learner
from holdfast.training.featurise import FloatRows, features_everywhere, spec_for
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet, Recording

SLIP_OF = {"pull": RISKY_SLIP, "fall": RISKY_SLIP, "pass": SAFE_SLIP}
"""Action that is drawn -> the slip in it."""


def first_slips(data: DataSet) -> list[int]:
    """The first trial of each drawn action with a window of its slip, chosen before any answer."""
    task = data.tasks["classes"]
    situations = labels_at(task.label, "four")
    places = []
    for action, situation in SLIP_OF.items():
        with_slip = np.unique(task.trial[situations == situation])
        for k in with_slip.tolist():
            if data.recordings[k].action == action:
                places.append(k)
                break

    return places


def held_out_streams(
    folder: Path, data: DataSet, features: FloatRows, plan: TrainingPlan, seed: int
) -> list[StreamPicture]:
    """Pictures of the drawn trials of a folder, from one forest trained without them."""
    drawn = first_slips(data)
    task = data.tasks["classes"]
    # A forest that had seen these trials would draw them too well.
    others = np.flatnonzero(~np.isin(task.trial, drawn))
    # One forest for all drawn trials: none of them is in its training rows.
    forest = fit_learner(data, features, plan, "classes", others, seed)

    spec = spec_for(data, plan.groups)
    # Features are needed of the drawn trials only, at every sample instead of at windows.
    drawn_groups = {data.recordings[k].group for k in drawn}
    part = data.of_groups(drawn_groups)
    everywhere = features_everywhere(part, spec)

    pictures = []
    for recording, rows in zip(part.recordings, everywhere, strict=True):
        votes = reference_votes(forest, rows, len(task.classes))
        pictures.append(_picture(folder, recording, votes, spec))

    return pictures


def _picture(
    folder: Path, recording: Recording, votes: IntArray, spec: StepSpec
) -> StreamPicture:
    by_situation = situation_votes(votes)
    answer = riskier_argmax(by_situation)
    # As on the hand: no answer before the window is full.
    answer[: spec.settle_samples - 1] = UNKNOWN

    # Thousandths, as the decision counts them on the hand.
    share = by_situation[:, RISKY_SLIP] / by_situation.sum(axis=1)
    permille = (1000 * share).astype(np.int64)
    answers = Answers(recording, answer, permille)
    # The default rules: the forest of a picture has no model card with rules of its own.
    rules = DecisionRules()
    (acts,) = requests_at([answers], rules, rules.min_risky_permille)
    return picture_of(folder, recording, answer, acts)
