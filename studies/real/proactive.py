"""proactive_slip_uskin: two replayed slips, one that recovers and one that fails. Pictures only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import RISKY_SLIP, FloatArray
from holdfast.export.heads import riskier_argmax
from holdfast.export.learner import reference_votes
from holdfast.export.network import IntArray
from holdfast.training.crossval import fit_learner
from holdfast.training.featurise import features_everywhere, features_of, spec_for
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet, Recording

UNLABELLED = -1
SHOWN = {
    "22-11-23-11": "a slip that recovers",
    "22-08-10-01": "a slip that ends in failure",
}
NAME_LENGTH = 11
"""Of the names above, with which a trial's own ends."""


@dataclass(frozen=True)
class ReplayPicture:
    """One trial as it went by: truth and answer [T] (-1: none), risky share of the votes [T]."""

    title: str
    recording: Recording
    truth: IntArray
    answer: IntArray
    risky_share: FloatArray
    settled_from: int


def study_proactive(
    data: DataSet, plan: TrainingPlan, seed: int = 0
) -> list[ReplayPicture]:
    """Each shown trial, answered by a forest trained on the other six (two of which slip)."""
    spec = spec_for(data, plan.groups)
    windows = features_of(data, spec)["situations"]
    everywhere = features_everywhere(data, spec)
    task = data.tasks["situations"]
    pictures = []
    for index, recording in enumerate(data.recordings):
        title = SHOWN.get(recording.trial_id[-NAME_LENGTH:])
        if title is None:
            continue
        mine = task.trial == index
        others = np.flatnonzero(~mine)
        forest = fit_learner(data, windows, plan, "situations", others, seed)
        votes = reference_votes(forest, everywhere[index], len(task.classes))
        answer = riskier_argmax(votes)
        answer[: spec.settle_samples] = UNLABELLED
        truth = np.full(len(votes), UNLABELLED, dtype=np.int64)
        truth[task.row[mine]] = task.label[mine]
        share = votes[:, RISKY_SLIP] / votes.sum(axis=1)
        pictures.append(
            ReplayPicture(title, recording, truth, answer, share, spec.settle_samples)
        )
    return pictures
