"""eflesh_slip: tugged or held, per trial, by a model of scenes in uT.

Both sets become the same thing: clips of 3 s that begin in the grip, without the median of their
first half second, with windows of six rows in their last second, and one label a clip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from holdfast.core.contract import (
    GRASP,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
    FloatArray,
    IntArray,
)
from holdfast.core.hand_card import read_hand_card
from holdfast.core.reading import Json
from holdfast.edge_runtime.graph import open_session, run_recordings
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import read_sealed
from holdfast.export.again import for_hand
from holdfast.export.learner import reference_votes
from holdfast.export.spec import StepSpec
from holdfast.training.crossval import cross_validate, fit_learner
from holdfast.training.datasets.eflesh_slip import (
    LAST_SECOND,
    PREPARATION,
    TRIAL_ROWS,
    WINDOW_ROWS,
)
from holdfast.training.featurise import features_of, spec_for
from holdfast.training.metrics import prediction_scores, share_scores
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet, LabelledRows, Recording
from studies.real.one_threshold import amplitude, threshold_baseline
from studies.transfer.levels import scaled
from studies.transfer.people import AS_RECORDED, OWN_LEVEL, TIMING

PLAN = TrainingPlan()
"""Of `make real`."""
DEPARTS_S = (0.5, 1.6)
"""When the load of a tug begins in a clip: the spread of the real set (README of eflesh_slip)."""
FREE_S = 0.3
"""A clip begins so long after contact, and a held one ends so long before anything else."""
LEVEL_PERCENTILE = 90.0
"""Of the clips' largest amplitudes: a tug's, whatever the share of tugs."""
ONE_THRESHOLD = "one threshold on the amplitude, blocks left out"
OF_FILE = "the model file, exported for the gripper"
HAND = "eflesh-gripper"
REAL_ONLY = "real trials alone, blocks left out"


def clips(data: DataSet, seed: int) -> DataSet:
    """Scenes as clips of the real set's shape: one from each slip, one from each long hold."""
    rng = np.random.default_rng(seed)
    recordings = []
    windows = []
    row = np.arange(LAST_SECOND.start + WINDOW_ROWS - 1, LAST_SECOND.stop, WINDOW_ROWS)
    for trial in data.recordings:
        for action, start in _starts(trial, rng):
            stop = start + TRIAL_ROWS
            recordings.append(
                replace(
                    trial,
                    trial_id=f"{trial.trial_id}/{action}",
                    group=trial.trial_id,
                    samples=PREPARATION.apply(trial.samples[start:stop]),
                    valid=trial.valid[start:stop],
                    action=action,
                    phases=(),
                    events=(),
                )
            )
            label = RISKY_SLIP if action == "tug" else GRASP
            number = np.full(len(row), len(recordings) - 1)
            windows.append(
                LabelledRows(number, row, np.full(len(row), label), SITUATIONS)
            )
    task = LabelledRows.concatenated(windows)
    return replace(
        data,
        recordings=recordings,
        tasks={"situations": task},
        preparation=PREPARATION,
    )


def _starts(trial: Recording, rng: np.random.Generator) -> Sequence[tuple[str, int]]:
    """What clips a trial gives, and the row at which each begins."""
    rate_hz, found = trial.rate_hz, []
    free = round(FREE_S * rate_hz)
    phases = trial.phases
    for before, phase in pairwise(phases):
        if before.situation != GRASP:
            continue
        begins = before.first + free
        if phase.situation == RISKY_SLIP:
            start = phase.first - round(rng.uniform(*DEPARTS_S) * rate_hz)
            if start >= begins and start + TRIAL_ROWS <= len(trial.samples):
                found.append(("tug", start))
        elif phase.situation == SAFE_SLIP:
            start = before.stop - free - TRIAL_ROWS
            if start >= begins:
                found.append(("hold", start))
    return found


def level_of(data: DataSet) -> float:
    """The set's own level, uT: the 90th percentile of its clips' largest amplitudes."""
    largest = [amplitude(one.samples).max() for one in data.recordings]
    return float(np.percentile(largest, LEVEL_PERCENTILE))


def real_rows(real: DataSet, seed: int) -> list[Json]:
    """Real-only with blocks left out, one threshold, and what a clock alone knows: nothing."""
    features = features_of(real, spec_for(real, PLAN.groups))
    held = cross_validate(real, features, PLAN, seed=seed)
    votes = held.votes["situations"]
    simple = threshold_baseline(real, seed=seed)
    always = np.ones(len(real.recordings))
    clock = _row(TIMING, AS_RECORDED, real, always, seed)
    note = "every trial lasts 3 s and no onset is stored: a clock can only always say tugged"
    return [
        _row(REAL_ONLY, AS_RECORDED, real, _risky_share(real, votes), seed),
        {
            "row": ONE_THRESHOLD,
            "scaling": AS_RECORDED,
            "accuracy": simple.trial_accuracy,
        },
        clock | {"note": note},
    ]


def scene_rows(name: str, scenes: DataSet, real: DataSet, seed: int) -> list[Json]:
    """A model of scenes on the real trials, in uT as they are and by the set's own level."""
    trained = clips(scenes, seed)
    spec = spec_for(real, PLAN.groups)
    features = features_of(trained, spec)["situations"]
    every = np.arange(len(features))
    learner = fit_learner(trained, features, PLAN, "situations", every, seed)
    level = level_of(trained)
    tugs = sum(one.action == "tug" for one in trained.recordings)
    about = {
        "clips": {"tug": tugs, "hold": len(trained.recordings) - tugs},
        "level_ut": level,
        "real_level_ut": level_of(real),
    }
    rows = []
    for scaling in (AS_RECORDED, OWN_LEVEL):
        data = real
        if scaling == OWN_LEVEL:
            factor = level / level_of(real)
            data = scaled(real, dict.fromkeys(real.groups(), factor))
        seen = features_of(data, spec)["situations"]
        votes = reference_votes(learner, seen, len(SITUATIONS))
        share = _risky_share(data, votes)
        rows.append(_row(name, scaling, data, share, seed) | about)
    return rows


def file_rows(path: Path, scenes: DataSet, real: DataSet, seed: int) -> list[Json]:
    """A model file in N, exported for the gripper and not trained again; none if it cannot be.

    scenes: in N; their tugs say what size a tug has there. The set's bias is taken in the grip, so
    the file sees the change of the load alone, and no grip.
    """
    hand = read_hand_card(HAND)
    card = Model(path).card
    spec = StepSpec.from_json(card.raw["spec"])
    if not spec.is_pooled:
        return []
    _, data = for_hand(read_sealed(path), hand)
    session = open_session(data)
    level = level_of(clips(scenes, seed))
    factor = level / level_of(real)
    values = [
        _at_rate(factor * one.samples, one.rate_hz, spec.rate_hz)
        for one in real.recordings
    ]
    valid = [np.ones((len(one), hand.n_sensors), np.bool_) for one in values]
    begin = round(LAST_SECOND.start * spec.rate_hz / real.rate_hz)
    rows = [np.arange(begin, len(one)) for one in values]
    answers = run_recordings(session, values, valid, ["p_situation"], rows)
    share = np.array([one["p_situation"][:, RISKY_SLIP].mean() for one in answers])
    row = _row(OF_FILE, OWN_LEVEL, real, share, seed)
    about = {"model": card.model_id, "level_n": level, "real_level_ut": level_of(real)}
    return [row | about]


def _at_rate(samples: FloatArray, rate_hz: float, wanted_hz: float) -> FloatArray:
    """Samples [T, C] at another rate, linear in between."""
    last_s = (len(samples) - 1) / rate_hz
    t_s = np.arange(0.0, last_s, 1.0 / wanted_hz)
    taken_s = np.arange(len(samples)) / rate_hz
    return np.column_stack([np.interp(t_s, taken_s, column) for column in samples.T])


def _risky_share(data: DataSet, votes: IntArray) -> FloatArray:
    """[trials] mean share of risky votes over the windows of a trial."""
    risky = votes[:, RISKY_SLIP] / votes.sum(axis=1)
    trial = data.tasks["situations"].trial
    n = len(data.recordings)
    total = np.bincount(trial, weights=risky, minlength=n)
    share: FloatArray = total / np.bincount(trial, minlength=n)
    return share


def tugged(data: DataSet) -> BoolArray:
    """[trials] the label."""
    return np.array([one.action == "tug" for one in data.recordings])


def _row(name: str, scaling: str, real: DataSet, share: FloatArray, seed: int) -> Json:
    """Accuracy, recall of both and AUC over trials, intervals over blocks."""
    truth = tugged(real)
    called = share >= 0.5
    blocks = np.array([one.group for one in real.recordings])
    ranked = prediction_scores(truth.astype(np.int64), share, blocks, seed=seed)
    recall = {
        word: asdict(share_scores((called == truth)[here], blocks[here], seed=seed))
        for word, here in (("tugged", truth), ("held", ~truth))
    }
    accuracy = share_scores(called == truth, blocks, seed=seed)
    return {
        "row": name,
        "scaling": scaling,
        "accuracy": accuracy.share,
        "accuracy_ci": accuracy.share_ci,
        "recall": recall,
        "auc": ranked.auc,
        "auc_ci": ranked.auc_ci,
    }
