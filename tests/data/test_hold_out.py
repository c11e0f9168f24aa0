"""Folders of people, and what is held out together."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from own_data import write_meta, write_people_folders

from holdfast.core.errors import DataNotFound, LabelError, TooFewGroups
from holdfast.core.trial_layout import truth_path
from holdfast.data.datasets import load
from holdfast.data.recording import DataSet, assign_groups, folds_of, regrouped

PULL = "soft-ball/pull/trial_1"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_people_folders(tmp_path_factory.mktemp("own") / "people")


@pytest.fixture(scope="module")
def data(made: Path) -> DataSet:
    return load(made, windows="natural")


@pytest.fixture
def small(made: Path, tmp_path: Path) -> Path:
    """Two people, a pull each."""
    for person in ("p01", "p02"):
        to = tmp_path / "small" / person / "soft-ball/pull"
        to.mkdir(parents=True)
        shutil.copy(made / person / f"{PULL}.csv", to)
    write_meta(tmp_path / "small", unit="N")
    return tmp_path / "small"


def test_folders_of_people_make_people_the_groups_of_every_split(data: DataSet) -> None:
    assert (data.groups(), data.group_kind) == (["p01", "p02"], "person")
    assert len(data.recordings) == 2 * 16
    people = np.array(data.group_of("classes"))
    for train, test in folds_of(people, assign_groups(people, 2)):
        assert set(people[train]).isdisjoint(people[test])
    of = {one.trial_id: one for one in data.recordings}
    trial = of[f"p02/{PULL}"]
    assert (trial.person, trial.object_name) == ("p02", "soft-ball")
    assert trial.action == "pull"


def test_one_person_alone_is_held_out_by_trial(small: Path) -> None:
    shutil.rmtree(small / "p02")
    data = load(small, windows="natural")
    assert (data.groups(), data.group_kind) == ([f"p01/{PULL}"], "trial")


def test_a_set_may_be_held_out_by_object_or_by_trial_instead(
    made: Path, data: DataSet
) -> None:
    by_object = load(made, windows="natural", hold_out="object")
    assert by_object.group_kind == "object"
    assert {"soft-ball", "full-bottle", "-"} <= set(by_object.groups())
    assert len(regrouped(data, "trial").groups()) == len(data.recordings)


def test_what_cannot_be_held_out_says_what_to_record(made: Path) -> None:
    one = load(made / "p01", windows="natural")
    with pytest.raises(
        TooFewGroups, match=r"held out by person.*next: sort trials into <person>/"
    ):
        regrouped(one, "person")
    pulls = one.of_groups([PULL])
    with pytest.raises(
        TooFewGroups, match=r"held out by object.*record another object"
    ):
        regrouped(pulls, "object")


def test_two_sets_in_one_folder_are_not_two_people(made: Path, tmp_path: Path) -> None:
    for name in ("monday", "tuesday"):
        shutil.copytree(made / "p01/soft-ball", tmp_path / name / "soft-ball")
        write_meta(tmp_path / name, unit="N", kind="recorded")
    with pytest.raises(DataNotFound, match="a level too high"):
        load(tmp_path)


@pytest.mark.parametrize("stray", ["soft-ball/pull/trial_1.csv", "nothing/trial_1.csv"])
def test_a_trial_without_a_person_is_refused_beside_people(
    small: Path, stray: str
) -> None:
    (small / stray).parent.mkdir(parents=True)
    shutil.copy(small / "p01" / f"{PULL}.csv", small / stray)
    with pytest.raises(
        LabelError, match=f"without a person.*next: move it to .*<person>/{stray}"
    ):
        load(small, windows="natural")


def test_a_person_whose_only_action_is_misspelt_is_not_passed_over(small: Path) -> None:
    (small / "p02/soft-ball/pull").rename(small / "p02/soft-ball/pulling")
    with pytest.raises(LabelError, match="'pulling' is not an action"):
        load(small, windows="natural")


def test_a_mass_for_all_people_stands_in_the_meta_of_the_set(small: Path) -> None:
    for person in ("p01", "p02"):
        (small / person / "soft-ball").rename(small / person / "mug")
    write_meta(small, unit="N", masses_g={"mug": 320.0})
    write_meta(small / "p02/mug", mass_g=90.0)
    task = load(small, windows="natural").tasks["classes"]
    heavy = [set((task.label[task.trial == trial] % 2).tolist()) for trial in (0, 1)]
    assert heavy == [{1}, {0}]


def starts_s(root: Path) -> list[float]:
    """When the action of each trial starts by its phases, s."""
    recordings = load(root, windows="natural").recordings
    return [one.phases[2].first / one.rate_hz for one in recordings]


def test_the_start_of_the_action_is_that_of_the_trial_then_of_the_set_then_the_script_s(
    small: Path,
) -> None:
    assert starts_s(small) == [7.0, 7.0]
    write_meta(small, unit="N", action_at_s=6.5)
    truth_path(small / "p02" / f"{PULL}.csv").write_text('{"action_at_s": 6.2}')
    assert starts_s(small) == [6.5, 6.2]
    assert "action from 6.5 s" in load(small, windows="natural").caveat
