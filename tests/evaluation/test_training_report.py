"""A judged model in one command: what is held out, the headline, the learning curve."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import Run

from holdfast.core.contract import GRASP
from holdfast.evaluation.report import held_out_trial
from holdfast.training.datasets import load
from holdfast.training.fixture import write_fixture
from holdfast.training.judging import CurvePoint, per_doubling, strictest_hold_out
from holdfast.training.recording import DataSet


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


def test_a_gain_is_read_off_three_points_at_least() -> None:
    points = [CurvePoint(k, 10.0 * k, 0.1 * k, None) for k in (1.0, 2.0, 4.0)]
    assert per_doubling(points[:2]) is None
    assert per_doubling(points) == pytest.approx(0.15)


def test_the_headline_is_the_held_out_figure_and_a_curve_shows_fewer_trials(
    run: Run, tmp_path: Path
) -> None:
    write_fixture(tmp_path / "set", trials_per_cell=2)
    words = ["train", "--data", tmp_path / "set", "--out", tmp_path / "model"]
    words += ["--size", "tiny", "--learner", "forest", "--windows", "thesis"]
    words += ["--report", tmp_path / "r.html", "--json", tmp_path / "f.json"]
    code, _, err = run(*words)
    assert code == 0, err
    figures = json.loads((tmp_path / "f.json").read_text("utf-8"))
    held_out = figures["held_out"]
    page = (tmp_path / "r.html").read_text("utf-8")
    value = f"{held_out['situations']['macro_f1']:.3f}"
    by = held_out["group_kind"]
    assert f"<h1>Held out by {by}: macro F1 {value}</h1>" in page
    curve = figures["learning_curve"]
    assert curve[-1]["macro_f1"] == held_out["situations"]["macro_f1"]
    groups = [point["n_groups"] for point in curve]
    assert groups == sorted(set(groups)), "no share of the groups comes twice"
    trials = [point["n_trials"] for point in figures["learning_curve"]]
    assert trials == sorted(trials)
    assert ("<svg" in page) == bool(trials)


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
