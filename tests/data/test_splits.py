"""Splits: no person is on both sides, every window is tested once."""

from __future__ import annotations

import numpy as np
import pytest
from hard_marks import EMPTY
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.errors import TooFewGroups
from holdfast.data.recording import assign_groups, folds_of

GROUPS = st.lists(st.sampled_from("abcdefghij"), min_size=1, max_size=200)


@EMPTY.mark
@given(groups=GROUPS, n_folds=st.integers(2, 6), seed=st.integers(0, 9))
def test_no_group_is_on_both_sides_and_every_window_is_tested_once(
    groups: list[str], n_folds: int, seed: int
) -> None:
    if len(set(groups)) < n_folds:
        with pytest.raises(TooFewGroups):
            assign_groups(groups, n_folds, seed=seed)
        return
    names = np.array(groups)
    folds = folds_of(groups, assign_groups(groups, n_folds, seed=seed))
    assert len(folds) == n_folds
    for train, test in folds:
        assert set(names[train]).isdisjoint(names[test])
        assert len(train) + len(test) == len(groups)
        assert len(test) > 0
    assert sorted(np.concatenate([test for _, test in folds])) == list(
        range(len(groups))
    )


@given(groups=GROUPS, seed=st.integers(0, 9))
def test_folds_are_balanced(groups: list[str], seed: int) -> None:
    if len(set(groups)) < 3:
        return
    fold = assign_groups(groups, 3, seed=seed)
    people = np.bincount(list(fold.values()))
    windows = [len(test) for _, test in folds_of(groups, fold)]
    assert people.max() - people.min() <= 1
    assert max(windows) - min(windows) <= max(groups.count(name) for name in fold)


def test_two_tasks_hold_out_the_same_people() -> None:
    first, second = np.array(list("aabbccdd")), np.array(list("dcba"))
    fold = assign_groups(first, 2)
    for (_, one), (_, other) in zip(
        folds_of(first, fold), folds_of(second, fold), strict=True
    ):
        assert set(first[one]) == set(second[other])


@EMPTY.mark
def test_one_person_only_says_what_to_do() -> None:
    with pytest.raises(
        TooFewGroups, match=r"1 group .* next: add recordings of other people"
    ):
        assign_groups(["a"] * 10, 2)
    with pytest.raises(TooFewGroups, match="next: use 3 folds"):
        assign_groups(list("abc"), 6)
