"""A judged model in one command: what is held out, the headline, the learning curve."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from holdfast.core.contract import GRASP
from holdfast.data.datasets import load
from holdfast.data.fixture import write_fixture
from holdfast.data.recording import DataSet
from holdfast.evaluation.report import held_out_trial
from holdfast.training.judging import strictest_hold_out


@pytest.fixture(scope="module")
def by_trial(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    folder = tmp_path_factory.mktemp("judged") / "set"
    write_fixture(folder, trials_per_cell=2)
    return load(folder, windows="thesis")


def test_a_set_is_held_out_by_person_else_object_else_trial(
    by_trial: DataSet,
) -> None:
    assert strictest_hold_out(by_trial.without_weight(), 2, 0).kind == "object"
    # One light and one heavy object: a model without one of them knows one weight alone.
    objects = ("basket-ball", "hard-ball")
    of_two = {one.group for one in by_trial.recordings if one.object_name in objects}
    weighed = strictest_hold_out(by_trial.of_groups(of_two), 2, 0)
    assert weighed.kind == "trial"
    assert re.match(
        "not held out by object: without .* no nothing with a (light|heavy) object",
        weighed.lines()[1],
    )
    one_object = replace(
        by_trial,
        recordings=[replace(one, object_name="book") for one in by_trial.recordings],
    )
    assert strictest_hold_out(one_object, 2, 0).kind == "trial"
    named = []
    for k, one in enumerate(one_object.recordings):
        named.append(replace(one, person=f"p{k % 2}"))
    by_one = strictest_hold_out(one_object, 2, 0)
    assert by_one.lines() == [
        "not held out by person: the set names no people",
        "not held out by object: one object alone",
    ]
    people = strictest_hold_out(replace(one_object, recordings=named), 2, 0)
    assert people.kind == "person"


def test_the_answer_of_a_window_is_drawn_at_its_end_and_not_before(
    by_trial: DataSet,
) -> None:
    task = by_trial.tasks["classes"]
    answers = np.full(len(task), GRASP)
    held_out = SimpleNamespace(situations=lambda: answers)
    drawn = held_out_trial(by_trial, SimpleNamespace(held_out=held_out))  # type: ignore[arg-type]
    assert drawn is not None
    names = [one.trial_id for one in by_trial.recordings]
    ends = task.row[task.trial == names.index(drawn.trial.recording.trial_id)]
    answered = np.flatnonzero(drawn.situation == GRASP)
    assert answered[0] == ends.min()
    assert set(ends.tolist()) <= set(answered.tolist())
