"""Training of networks and committees: repeatable, nested, near the real numbers they come from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from made_set import made_set, task_of

from holdfast.core.contract import SITUATIONS
from holdfast.data.recording import DataSet
from holdfast.step.network import network_votes
from holdfast.training.crossval import cross_validate, fit_learner
from holdfast.training.network_fit import fit_members, in_whole_numbers
from holdfast.training.plan import ForestPlan, NetworkPlan, TrainingPlan

SMALL = NetworkPlan(hidden=(8,), members=2, epochs=3, batch=16)
PLAN = TrainingPlan(
    situation=ForestPlan(n_estimators=3, max_depth=4),
    folds=3,
    network=SMALL,
    learner="committee",
)
PEOPLE, ROWS_EACH, WIDTH = 6, 40, 5
FloatRows = npt.NDArray[np.float32]


def people(seed: int = 0) -> tuple[DataSet, dict[str, FloatRows]]:
    """Six people whose windows a first feature tells apart; slips are rare."""
    rng = np.random.default_rng(seed)
    label = rng.choice(4, size=PEOPLE * ROWS_EACH, p=[0.5, 0.3, 0.15, 0.05])
    label[:4] = np.arange(4)
    rows = rng.normal(size=(len(label), WIDTH)).astype(np.float32)
    rows[:, 0] += label
    trial = np.repeat(np.arange(PEOPLE), ROWS_EACH)
    data = made_set(PEOPLE, {"situations": task_of(trial, label, SITUATIONS)})
    return data, {"situations": rows}


def relabelled(data: DataSet, first: int) -> DataSet:
    """The same set, where all windows from this one on show nothing."""
    task = data.tasks["situations"]
    label = task.label.copy()
    label[first:] = 0
    return replace(data, tasks={"situations": replace(task, label=label)})


@pytest.mark.parametrize("kind", ["network", "committee"])
def test_the_same_seed_makes_the_same_learner_and_another_seed_another_one(kind):
    data, features = people()
    rows, every = features["situations"], np.arange(PEOPLE * ROWS_EACH)
    plan = replace(PLAN, learner=kind)

    def votes(seed: int) -> npt.NDArray[np.int64]:
        learner = fit_learner(data, rows, plan, "situations", every, seed)
        assert learner.network is not None
        return network_votes(learner.network, rows)

    assert np.array_equal(votes(0), votes(0))
    assert not np.array_equal(votes(0), votes(1))


def test_whole_numbers_answer_nearly_what_the_real_ones_do():
    data, features = people()
    rows, label = features["situations"], data.tasks["situations"].label
    members = fit_members(replace(SMALL, epochs=20), rows, label, 0)
    network = in_whole_numbers(members, rows, 4)
    votes = network_votes(network, rows)
    seen = members.squash.standardised(rows)
    logits = [np.log(one.predict_proba(seen)) for one in members.networks]
    real = np.exp(np.mean(logits, axis=0))
    shares = real / real.sum(axis=1, keepdims=True)
    apart = np.abs(votes / network.votes_in_all - shares)
    assert apart.mean() < 0.005
    assert np.quantile(apart, 0.99) < 0.03


def test_a_fold_s_labels_do_not_depend_on_the_labels_of_its_own_people():
    data, features = people()
    before = cross_validate(data, features, PLAN, seed=0).situations()
    first = (PEOPLE - 1) * ROWS_EACH
    changed = relabelled(data, first)
    after = cross_validate(changed, features, PLAN, seed=0).situations()
    assert np.array_equal(before[first:], after[first:])
    assert not np.array_equal(before[:first], after[:first])
