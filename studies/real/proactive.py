"""proactive_slip_uskin: two replayed slips, one that recovers and one that fails. Pictures only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import RISKY_SLIP, FloatArray
from holdfast.export.heads import riskier_argmax
from holdfast.export.learner import reference_votes
from holdfast.training.crossval import fit_learner
from holdfast.training.featurise import features_everywhere, features_of, spec_for
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet, Recording

UNLABELLED = -1
SHOWN = {
    "22-11-23-11": "a slip that recovers",
    "22-08-10-01": "a slip that ends in failure",
}


@dataclass(frozen=True)
class ReplayPicture:
    """One trial as it went by: truth and answer [T] (-1: none), risky share of the votes [T]."""

    title: str
    recording: Recording
    truth: npt.NDArray[np.int64]
    answer: npt.NDArray[np.int64]
    risky_share: FloatArray
    settled_from: int


def study_proactive(
    data: DataSet, plan: TrainingPlan, seed: int = 0
) -> list[ReplayPicture]:
    """Each shown trial, answered by a forest trained on the other six (two of which slip)."""
    spec = spec_for(data, plan.groups)
    windows, everywhere = (
        features_of(data, spec)["situations"],
        features_everywhere(data, spec),
    )
    return [
        _picture(
            data,
            plan,
            windows,
            everywhere[index],
            index,
            SHOWN[name],
            spec.settle_samples,
            seed,
        )
        for index, recording in enumerate(data.recordings)
        for name in SHOWN
        if recording.trial_id.endswith(name)
    ]


def _picture(
    data: DataSet,
    plan: TrainingPlan,
    windows: npt.NDArray[np.float32],
    stream: npt.NDArray[np.float32],
    index: int,
    title: str,
    settled_from: int,
    seed: int,
) -> ReplayPicture:
    task = data.tasks["situations"]
    forest = fit_learner(
        data, windows, plan, "situations", np.flatnonzero(task.trial != index), seed
    )
    votes = reference_votes(forest, stream, len(task.classes))
    answer = riskier_argmax(votes)
    answer[:settled_from] = UNLABELLED
    truth = np.full(len(stream), UNLABELLED, dtype=np.int64)
    mine = task.trial == index
    truth[task.row[mine]] = task.label[mine]
    share = votes[:, RISKY_SLIP] / votes.sum(axis=1)
    return ReplayPicture(
        title, data.recordings[index], truth, answer, share, settled_from
    )
