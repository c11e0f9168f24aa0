"""The study of what tells a fast hand-over from a pull: ideas, learners, the bound, and the whole
on a few trials."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.contract import FloatArray
from holdfast.evaluation.trials import Grasp
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import SceneFile, read_scene_file
from holdfast.simulation.script_times import Times
from holdfast.training.plan import ForestPlan, NetworkPlan, TrainingPlan
from holdfast.training.recording import Recording
from studies import learner_streams
from studies.fast_handover.ideas import VARIED, Idea
from studies.fast_handover.learners import Boosting, Forest, Learner, TwoStages
from studies.fast_handover.sets import (
    CHOOSE,
    EVALUATED,
    context,
    streams,
    training_part,
    without,
)
from studies.fast_handover.stream_scores import opens_at_s
from studies.fast_handover.study import study
from studies.fast_handover.timing import session_of
from studies.fast_handover.window_scores import bounds, macro_f1

SMALL = ForestPlan(n_estimators=8, max_depth=8)
CARDS = {
    "thesis": "thesis",
    "broad": "broad",
    CHOOSE: "daily",
    "author": "thesis",
    "p1": "p1",
    "p2": "p2",
    "asked-holds": "perturbed-hold",
    "asked-daily": "daily",
}
SLOW_EFFECTS = {"texture", "tremor"}
"""Of the card broad: they need fine steps from end to end."""
TRIALS = {
    "thesis": 30,
    "broad": 18,
    "p1": 30,
    "p2": 30,
    "daily": 6,
    "perturbed-hold": 9,
}


def coarse(name: str) -> SceneFile:
    """A card in long steps: the study asks for streams, not for slip times to the millisecond."""
    card = read_scene_file(name, rate_hz=50)
    kept = {
        name: parameters
        for name, parameters in card.effects.items()
        if name not in SLOW_EFFECTS
    }
    return replace(card, step_s=0.02, effects=kept)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("fast_handover")
    for number, (name, card) in enumerate(CARDS.items()):
        write_set(Scene(coarse(card), number), place / name, TRIALS[card])
    return place


# -- ideas and learners


LEARNERS = (Forest(SMALL), Forest(SMALL, classes=4), TwoStages(SMALL), Boosting(10, 8))


@pytest.mark.parametrize("learner", LEARNERS)
def test_every_learner_learns_what_is_plain_to_see(learner: Learner):
    label = np.repeat(np.arange(8), 60)
    features = np.random.default_rng(0).normal(0.0, 0.1, (480, 3)).astype(np.float32)
    features[:, 0] += label
    learner.fit(features, label, 0)
    situation, permille = learner.answer(features)
    assert np.mean(situation == label // 2) > 0.97
    assert permille[label >= 6].min() > 500 > permille[label < 4].max() >= 0
    assert learner.models


def test_what_is_timed_of_boosting_gives_its_scores():
    label = np.repeat(np.arange(8), 60)
    features = (
        np.random.default_rng(0).normal(0.0, 1.0, (480, 3)) + label[:, None] / 4
    ).astype(np.float32)
    learner = Boosting(10, 8)
    learner.fit(features, label, 0)
    session = session_of(learner.models[0], features)
    scores = (
        session.run(None, {"features": features})[0]
        + learner.models[0]._baseline_prediction
    )
    np.testing.assert_allclose(
        scores, learner.models[0].decision_function(features), atol=1e-5
    )


# -- what stands beside a sample


def standing(samples: FloatArray) -> Recording:
    return Recording(
        "one", "one", samples, np.ones((len(samples), 6), np.bool_), 50.0, "N"
    )


@given(st.integers(1, 199), st.floats(-5.0, 5.0))
def test_the_context_of_a_sample_knows_nothing_of_later_ones(row: int, change: float):
    samples = np.random.default_rng(0).normal(2.0, 1.0, (200, 18))
    later = samples.copy()
    later[row:] += change
    np.testing.assert_array_equal(
        context(standing(samples))[:row], context(standing(later))[:row]
    )


def test_an_object_left_out_is_in_no_window(folder):
    part = training_part(folder, VARIED, "thesis")
    name = str(part.held_object[part.held_object != ""][0])
    rest = without(part, name)
    assert name not in rest.held_object
    assert (
        len(rest.label)
        == len(rest.features)
        == len(part.label) - int((part.held_object == name).sum())
    )


# -- the bound, and the opening command


def test_who_knows_the_truth_at_once_is_always_right_and_who_is_late_is_worse(folder):
    evaluated = streams(folder / "author", "thesis", "default")
    late = [row["f1_author"] for row in bounds(evaluated)]
    assert late[0] == 1.0
    assert late == sorted(late, reverse=True)
    assert late[-1] < 0.98


def test_windows_just_past_a_change_can_be_left_out(folder):
    evaluated = streams(folder / "author", "thesis", "default")
    first = np.flatnonzero((evaluated.truth == 3) & (np.roll(evaluated.truth, 1) != 3))
    wrong = evaluated.truth.copy()
    wrong[first] = 1
    assert macro_f1(replace(evaluated, row=first), wrong) == 0.0
    both = replace(evaluated, row=np.sort([*first, *(first + 2)]))
    assert macro_f1(both, wrong) < 1.0
    assert macro_f1(both, wrong, past_s=1.5 / 50) == 1.0


@pytest.mark.parametrize("card", ["thesis", "p1"])
def test_the_opening_command_is_when_the_scene_opens_the_hand(card, tmp_path):
    scene = Scene(coarse(card), 0)
    write_set(scene, tmp_path / "set", 45)
    drawn = {trial.number: trial for trial in scene.trials(45)}
    content = [
        json.loads(path.read_text("utf-8"))
        for path in (tmp_path / "set").rglob("*.truth.json")
    ]
    opening = {one["number"]: opens_at_s(Grasp(one)) for one in content}
    for number, opens_s in opening.items():
        if opens_s is not None:
            assert opens_s == pytest.approx(Times.of(drawn[number]).open, abs=1e-4)
    assert {
        drawn[n].action for n, opens_s in opening.items() if opens_s is not None
    } == {
        "pass",
        "put-down",
    }


# -- the whole


def test_the_study_says_of_every_idea_what_it_finds_and_costs(folder):
    chosen = [
        Idea("forest", learner=lambda: Forest(SMALL), objects_left_out=True),
        Idea("veto", learner=lambda: Forest(SMALL), decision="veto"),
        Idea("personal", learner=lambda: Forest(SMALL), decision="personal"),
        Idea("boosting", learner=lambda: Boosting(10, 8, bins=8)),
        Idea("context", learner=lambda: Forest(SMALL), features="with context"),
    ]
    messages: list[str] = []
    figures: dict[str, Any] = study(folder, 0, messages.append, chosen)
    assert messages == [idea.name for idea in chosen]
    for row in figures["rows"]:
        assert 0.3 < row["f1_author"] <= 1.0
        assert row["learner_us"] > 0.0
        assert all(row[name]["events"] > 0 for name in ("author", "p1", "p2"))
        assert set(row["asked-holds"]["specificity"]) == {"dFn", "dFt", "dq"}
    forest, veto, personal, _, _ = figures["rows"]
    assert 0.0 < forest["worst_object"] <= 1.0
    assert all(
        personal["permille"][name] >= forest["permille"][name] for name in EVALUATED
    )
    assert veto["author"]["recall"] >= forest["author"]["recall"] - 0.2
    json.dumps(figures, allow_nan=False)


def test_every_learner_is_evaluated_on_styles_that_it_never_met(folder):
    tiny = NetworkPlan(hidden=(8,), members=1, balance=1.0)
    forest = TrainingPlan(situation=SMALL, network=tiny)
    plans = {"forest": forest, "committee": replace(forest, learner="committee")}
    rows = [
        asdict(row)
        for row in learner_streams.study(folder, 0, lambda line: None, plans)
    ]
    assert [row["learner"] for row in rows] == ["forest", "committee"]
    for row in rows:
        events = {name: one["events"] for name, one in row["sets"].items()}
        assert set(events) == set(learner_streams.EVALUATED)
        assert row["unseen"]["events"] == events["p1"] + events["p2"] > 0
        assert row["left_out"]["events"] == row["unseen"]["events"] + events["author"]
        assert 0.0 < row["learner_us"] < row["step_us"]
    assert rows[0]["sets"] != rows[1]["sets"]
    json.dumps(rows, allow_nan=False)


def test_a_style_left_out_is_in_no_set_that_is_trained_on():
    of_style = {"thesis": "author", "author": "author", "p1": "p1", "p2": "p2"}
    for style, kept in learner_streams.STYLES_KEPT.items():
        assert {of_style[name] for name in kept} == {"author", "p1", "p2"} - {style}
    assert set(learner_streams.UNSEEN).isdisjoint(VARIED)
