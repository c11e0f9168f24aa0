"""Learners side by side on people held out: nested, of every learner, on a small made-up set."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
from joblib import parallel_config

from holdfast.core.contract import SITUATIONS
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.plan import ForestPlan, NetworkPlan
from holdfast.training.recording import DataSet, LabelledRows, Recording
from holdfast.training.tuning import candidates_of
from studies.real import learners

PEOPLE, SAMPLES, RATE_HZ = 4, 400, 50.0
NETWORK = NetworkPlan(hidden=(8,), members=2, epochs=2, batch=64)
TREES = ForestPlan(n_estimators=4, max_depth=5)
SMALL = replace(
    learners.PLAN,
    folds=2,
    groups=("now",),
    situation=TREES,
    prediction=TREES,
    network=NETWORK,
    prediction_network=NETWORK,
)


def made_up() -> DataSet:
    """Six sensors whose every channel says the situation, beneath noise; slips are rare."""
    rng = np.random.default_rng(0)
    recordings, labels = [], []
    for person in range(PEOPLE):
        label = np.repeat(rng.choice(4, SAMPLES // 20, p=[0.3, 0.4, 0.2, 0.1]), 20)
        label[:80] = np.repeat(np.arange(4), 20)
        values = rng.normal(2.0, 0.4, (SAMPLES, 18))
        values += 0.5 * label[:, None]
        valid = np.ones((SAMPLES, 6), np.bool_)
        name = f"p{person}"
        recordings.append(Recording(name, name, values, valid, RATE_HZ, "N"))
        labels.append(label)
    kept = np.arange(30, SAMPLES)
    trial, row = np.repeat(np.arange(PEOPLE), len(kept)), np.tile(kept, PEOPLE)
    label = np.concatenate([one[kept] for one in labels]).astype(np.int64)
    tasks = {
        "situations": LabelledRows(trial, row, label, SITUATIONS),
        "predict_250ms": LabelledRows(
            trial, row, (label == 3).astype(np.int64), ("no", "yes")
        ),
    }
    return DataSet(
        "made up", recordings, tasks, RATE_HZ, "N", Preparation(), "made up", True, ""
    )


def test_every_learner_is_reported_with_what_was_chosen_for_it():
    with parallel_config(backend="sequential"):
        figures = learners.study_learners(
            made_up(), 18, in_hand=False, seed=0, plan=SMALL
        )
    plain, weighted = (
        list(learners.LEARNERS),
        [f"{n}, label weights" for n in learners.LEARNERS],
    )
    assert list(figures.rows) == [*plain, *weighted, learners.UNQUANTISED]
    macro_f1 = {name: row.situations.macro_f1 for name, row in figures.rows.items()}
    assert macro_f1["forest"] > 0.4, "every channel says the situation"
    assert macro_f1["network, label weights"] >= macro_f1["network"] - 0.1
    forest = figures.rows["forest"].predict_250ms
    assert forest is not None
    assert forest.auc is not None
    assert forest.auc > 0.6
    assert set(figures.people) == {f"p{person}" for person in range(PEOPLE)}
    assert len(figures.networks) == SMALL.folds
    for fold in figures.networks:
        assert set(fold) == {"situations", "predict_250ms"}
        assert all(network in candidates_of(NETWORK) for network in fold.values())
    json.dumps(figures.to_json(), allow_nan=False)


def test_a_study_goes_on_only_where_one_of_the_same_plan_stopped(tmp_path):
    out, plan, studied = (
        tmp_path / "learners.json",
        {"folds": 6},
        [{"channels": 18, "in_hand": True}],
    )
    assert learners.kept_cases(out, plan, 0) == {}
    out.write_text(
        json.dumps({"plan": plan, "seed": 0, "studied": studied}), encoding="utf-8"
    )
    assert learners.kept_cases(out, plan, 0) == {(18, True): studied[0]}
    assert learners.kept_cases(out, {"folds": 3}, 0) == {}
    assert learners.kept_cases(out, plan, 1) == {}
