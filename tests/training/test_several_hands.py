"""Sets of several hands in one training: parts, weights, what counts how much, who is locked."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from holdfast.cli.main import main
from holdfast.core.contract import CLASSES, GRASP, NOTHING, SITUATIONS
from holdfast.core.errors import ChannelError, SetLocked, UsageError
from holdfast.core.hand_card import read_hand_card
from holdfast.core.locked import require_open_people
from holdfast.core.progress import Stages, ignored
from holdfast.data.datasets.joining import join
from holdfast.data.recording import DataSet, LabelledRows, Recording
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.crossval import features_of_each_hand, fit_forest, window_counts
from holdfast.training.fitting import TrainingRequest, train, train_on_sets
from holdfast.training.plan import POOLED_GROUPS, ForestPlan, TrainingPlan, pooled_plan

SMALL = replace(
    pooled_plan("tiny", "forest"),
    situation=ForestPlan(n_estimators=3, min_samples_leaf=2, max_depth=3),
    folds=2,
)


def a_set(
    name: str, card: str, labels: list[int], classes: tuple[str, ...], people: int = 0
) -> DataSet:
    """Four recordings of random forces, with a window of each label in each."""
    hand = read_hand_card(card)
    rng = np.random.default_rng(hand.n_sensors)
    recordings = []
    for k in range(4):
        samples = rng.normal(size=(120, 3 * hand.n_sensors)) + 2.0
        person = f"p{k % people}" if people else None
        recordings.append(
            Recording(
                trial_id=f"trial_{k}",
                group=person or f"trial_{k}",
                samples=samples,
                valid=np.ones((120, hand.n_sensors), np.bool_),
                rate_hz=150.0,
                unit="N",
                person=person,
            )
        )
    trial = np.repeat(np.arange(4), len(labels))
    rows = LabelledRows(
        trial,
        np.tile(80 + np.arange(len(labels)), 4),
        np.tile(labels, 4),
        classes,
    )
    task = "classes" if classes == CLASSES else "situations"
    return DataSet(
        name=name,
        recordings=recordings,
        tasks={task: rows},
        rate_hz=150.0,
        unit="N",
        preparation=Preparation(),
        kind="made",
        redistributable=True,
        caveat="",
        hand=hand,
    )


def scenes() -> DataSet:
    return a_set("scenes", "six-fingertips", [2, 3, 6, 7], CLASSES)


def lifts() -> DataSet:
    return a_set(
        "lifts", "two-pad-gripper", [NOTHING, GRASP, GRASP, GRASP], SITUATIONS, people=2
    )


def test_sets_of_two_hands_are_learned_together_each_by_its_own_step() -> None:
    joined = join([scenes(), lifts()], several_hands=True)
    assert joined.n_sensors == 6
    assert [part.n_sensors for part in joined.parts] == [6, 2]
    assert set(joined.groups()) >= {"scenes/trial_0", "lifts/p1"}

    together = features_of_each_hand(joined, POOLED_GROUPS)["classes"]
    for part, rows in zip(joined.parts, np.split(together, [16]), strict=True):
        (alone,) = features_of_each_hand(part, POOLED_GROUPS).values()
        assert np.array_equal(rows, alone)


def test_without_pooled_features_sets_of_two_hands_are_refused() -> None:
    with pytest.raises(ChannelError, match=r"2, not 6.*--features pooled"):
        join([scenes(), lifts()])


def test_a_set_without_a_weight_says_nothing_of_it_and_takes_none_away() -> None:
    joined = join([scenes(), lifts()], several_hands=True)
    assert joined.tasks["classes"].classes == CLASSES
    counts = joined.tasks["classes"].class_counts()
    # twelve windows of a grasp in the lifts: as many light as heavy, beside those of the scenes
    assert counts["grasp_light"] == counts["grasp_heavy"] == 4 + 6
    assert counts["risky_slip_light"] == counts["risky_slip_heavy"] == 4


def test_where_no_weight_can_be_learned_four_situations_are() -> None:
    light_slips = a_set("scenes", "six-fingertips", [2, 3, 6, 6], CLASSES)
    joined = join([light_slips, lifts()], several_hands=True)
    assert joined.tasks["situations"].classes == SITUATIONS
    assert all("situations" in part.tasks for part in joined.parts)


def test_an_axis_that_one_hand_does_not_measure_makes_it_another_hand() -> None:
    six = scenes()
    assert six.hand is not None
    first, *others = six.hand.contacts
    first = msgspec.structs.replace(first, measures="yz")
    hand = replace(six.hand, contacts=(first, *others))
    other = replace(six, name="others", hand=hand)
    assert len(join([six, other], several_hands=True).parts) == 2
    with pytest.raises(ChannelError, match="axes that are not measured"):
        join([six, other])


def test_the_windows_of_a_set_count_in_all_as_a_share_of_the_others() -> None:
    plan = TrainingPlan(set_shares={"lifts": 0.3})
    label = np.array([0] * 10 + [1] * 20 + [1] * 50)
    names = np.array(["scenes"] * 30 + ["lifts"] * 50)
    counts_as = window_counts(plan, label, names)
    assert counts_as is not None
    assert counts_as[:30].tolist() == [1.0] * 30
    assert counts_as[30:].sum() == pytest.approx(0.3 * 20)
    assert window_counts(plan, label[:30], names[:30]) is None


def test_classes_weigh_the_same_whatever_a_set_adds_to_one_of_them() -> None:
    """One split on a number that says nothing: each leaf answers with the classes' weights."""
    label = np.array([0] * 40 + [1] * 10 + [1] * 200)
    counts_as = np.array([1.0] * 50 + [0.05] * 200)
    rows = np.zeros((250, 1), np.float32)
    plan = ForestPlan(n_estimators=1, min_samples_leaf=2)
    forest = fit_forest(plan, rows, label, counts_as, 0)
    share = forest.predict_proba(rows[:1])[0]
    # a bootstrap or not: extra trees see every window
    assert share == pytest.approx([0.5, 0.5])


def test_a_model_of_two_hands_is_the_first_ones_and_its_card_lists_the_sets(
    tmp_path: Path,
) -> None:
    joined = join([scenes(), lifts()], several_hands=True)
    train(joined, tmp_path / "made", SMALL)
    index = json.loads((tmp_path / "made" / "artifact.json").read_text("utf-8"))
    assert index["spec"]["n_sensors"] == 6
    listed = {one["name"]: one for one in index["training"]["sets"]}
    assert listed["lifts"]["people"] == ["p0", "p1"]
    assert listed["lifts"]["hand"] == "two-pad-gripper"
    assert listed["scenes"]["people"] == []


def test_a_set_alone_has_no_list_of_sets(tmp_path: Path) -> None:
    train(scenes(), tmp_path / "made", SMALL)
    index = json.loads((tmp_path / "made" / "artifact.json").read_text("utf-8"))
    assert "sets" not in index["training"]


def test_people_who_are_kept_back_are_not_learned_from() -> None:
    require_open_people("grip_lift_ati", ["p1547", "p1668"], "a model")
    with pytest.raises(SetLocked, match=r"may not see p1701 of grip_lift_ati"):
        require_open_people("grip_lift_ati", ["p1547", "p1701"], "a model")
    require_open_people("my_lifts", ["p1701"], "a model")


def test_a_hold_out_of_a_set_that_is_not_there_is_a_usage_error(tmp_path: Path) -> None:
    request = TrainingRequest((), tmp_path / "made", hold_out={"other": "person"})
    with pytest.raises(UsageError, match=r"--hold-out other="):
        train_on_sets(request, Stages(), ignored)


def test_what_is_held_out_is_given_for_each_set(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["train", "--hold-out", "lifts=window"]) == 2
    assert "'window'; allowed: person, object, trial, or SET=WHAT" in (
        capsys.readouterr().err
    )
